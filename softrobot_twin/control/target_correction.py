"""From targets to the aims of a step: measured effectors, correction by integration, approach.

Effectors are measured by markers. In closed loop an integrator adds the model's error, measured
minus predicted effector, to each target. A far target is approached on a straight line.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.control.inputs import Misfit
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.simulation import Simulation, Status

GREATEST_SHARE = 0.4
"""One measurement adds at most this share of the error to the correction, even if measurements are
rare. The markers show the effect of a command that was sent about one measurement earlier. With
this delay an integrator oscillates when a measurement adds the whole error, and it settles fastest
when a measurement adds a quarter of it."""


def approach(positions: np.ndarray, aims: np.ndarray, reach: float) -> np.ndarray:
    """The points nearest to the aims that are within reach of the positions.

    If a step aimed at a far target itself, every actuator would move at its own rate limit, and the
    effector would leave the straight line to the target. The line starts at the effector's
    position, not at the last aim, so that no error accumulates when the target cannot be reached.

    Args:
        positions: Positions of the effectors [m], shape (effector_count, 3).
        aims: Positions to reach [m], same shape; NaN rows stay NaN.
        reach: Greatest distance of one tick [m]; infinite returns the aims.

    Returns:
        Points on the lines to the aims [m], same shape.
    """
    differences = aims - positions
    distances = np.sqrt((differences * differences).sum(axis=1, keepdims=True))
    far = distances > reach
    if not far.any():
        return aims
    shares = np.divide(reach, distances, out=np.ones_like(distances), where=far)
    return np.where(far, positions + shares * differences, aims)


def approach_poses(
    positions: np.ndarray, aims: np.ndarray, quaternions: np.ndarray, turns: np.ndarray,
    lengths: np.ndarray, reach: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """The same for effectors with orientations: position and rotation keep pace.

    Args:
        positions: Positions of the effectors [m], shape (effector_count, 3).
        aims: Positions to reach [m], same shape; NaN rows stay NaN.
        quaternions: Turns of the effectors from rest (x, y, z, w), shape (effector_count, 4).
        turns: Turns to reach, NaN where free, same shape.
        lengths: Displacement that counts as much as one radian [m/rad], shape (effector_count,).
        reach: Greatest distance of one tick, over both [m]; infinite returns the aims.

    Returns:
        Points on the lines to the aims [m], and turns on the shortest way to those that are wanted.
    """
    near, nearer = aims.copy(), turns.copy()
    for effector in np.flatnonzero(np.isfinite(turns).all(axis=1)):
        way = aims[effector] - positions[effector]
        before, after = Rotation.from_quat([quaternions[effector], turns[effector]])
        turn = (after * before.inv()).as_rotvec()
        distance = np.hypot(np.linalg.norm(way), lengths[effector] * np.linalg.norm(turn))
        if not distance <= reach:
            share = reach / distance
            near[effector] = positions[effector] + share * way
            nearer[effector] = (Rotation.from_rotvec(share * turn) * before).as_quat()
    plain = ~np.isfinite(turns).all(axis=1)
    near[plain] = approach(positions[plain], aims[plain], reach)
    return near, nearer


class EffectorMeasurement:
    """Moves each predicted effector by the mean misfit of its markers.

    Markers measure positions. Orientations are not measured: they are led by the model alone.

    Args:
        simulation: Has the markers of each effector and its controlled directions.
    """

    def __init__(self, simulation: Simulation):
        self._markers = simulation.effector_markers
        self._controlled = np.array(
            [axis in effector.directions for effector in simulation.scene.effectors for axis in "xyz"],
            bool,
        ).reshape(-1, 3)

    def is_complete(self, measured: np.ndarray) -> bool:
        """True when at least one marker of every effector that has markers is visible.

        Args:
            measured: Measured markers [m], shape (marker_count, 3); NaN for hidden markers.
        """
        return all(np.isfinite(measured[indices]).all(axis=1).any()
                   for indices in self._markers if len(indices))  # fmt: skip

    def effectors(self, predicted: np.ndarray, misfit: Misfit) -> np.ndarray:
        """Measured effectors [m], shape (effector_count, 3); NaN where no marker is visible.

        Args:
            predicted: Effectors of the model [m], shape (effector_count, 3).
            misfit: Measured minus predicted markers, at the same state of the model.
        """
        measured = np.full_like(predicted, np.nan)
        for effector, indices in enumerate(self._markers if misfit.visible else ()):
            vectors = misfit.vectors[indices]
            vectors = vectors[np.isfinite(vectors).all(axis=1)]
            if len(vectors):
                measured[effector] = predicted[effector] + vectors.mean(axis=0)
        return measured

    def controlled(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Targets in the controlled directions, positions in the others [m], same shape.

        Args:
            targets: Targets [m], shape (effector_count, 3).
            positions: Positions [m], same shape.
        """
        return np.where(self._controlled, targets, positions)

    def differences(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Target minus position, 0 in directions that are not controlled [m], same shape.

        Args:
            targets: Targets [m], shape (effector_count, 3).
            positions: Positions [m], same shape.
        """
        return np.where(self._controlled, targets - positions, 0.0)

    def errors(
        self, targets: np.ndarray, predicted: np.ndarray, measured: np.ndarray
    ) -> np.ndarray:
        """Distances from the targets [m], shape (effector_count,), measured where possible.

        Args:
            targets: Targets [m], shape (effector_count, 3); NaN rows give NaN.
            predicted: Effectors of the model [m], same shape.
            measured: Measured effectors [m], same shape; for NaN rows the model's are used.
        """
        seen = np.isfinite(measured).all(axis=1, keepdims=True)
        differences = self.differences(targets, np.where(seen, measured, predicted))
        return np.sqrt((differences * differences).sum(axis=1))


class TargetCorrection:
    """A discrete integrator with anti-windup: c ← c + k_i Δt (target − measured effector).

    It integrates once per measurement, not once per tick, so that each measurement counts once. The
    length of the correction is limited. While an actuator cannot follow, only changes that make the
    correction shorter are accepted. Without a measurement the correction does not change: the last
    one is the best estimate of the model's error.

    Args:
        effector_count: Number of effectors of the simulation.

    Attributes:
        offsets: Correction c of each target [m], shape (effector_count, 3).
    """

    def __init__(self, effector_count: int):
        self.offsets = np.zeros((effector_count, 3))
        self._stamp = 0

    def tick(
        self, settings: LoopSettings, stamp: int, errors: np.ndarray | None, status: Status
    ) -> None:
        """Integrates each new measurement in closed loop; in open loop the correction decays.

        Args:
            settings: Whether the loop is closed, gain and limit.
            stamp: Time of the newest measurement [ns]; an old one is not integrated again.
            errors: See `update`; None while the effectors do not follow targets.
            status: Status of the last step.
        """
        since, self._stamp = (stamp - self._stamp) / NANOSECONDS, stamp
        if not settings.closed_loop:
            self.fade(settings.period, settings.correction_gain)
        elif errors is not None and since != 0.0:
            self.update(
                errors, abs(since), status, settings.correction_gain, settings.correction_limit
            )

    def update(
        self, errors: np.ndarray, time_step: float, status: Status, gain: float, limit: float
    ) -> None:
        """Integrates one measurement.

        Args:
            errors: Target minus measured effector [m], shape (effector_count, 3); NaN in a row
                without a measurement, 0 in directions that are not controlled.
            time_step: Time since the last measurement [s].
            status: Status of the last step.
            gain: k_i [1/s].
            limit: Greatest length of a correction [m].
        """
        for offset, error in zip(self.offsets, errors, strict=True):
            if not np.isfinite(error).all():
                continue
            candidate = offset + min(gain * time_step, GREATEST_SHARE) * error
            length = float(np.linalg.norm(candidate))
            if length > limit:
                candidate *= limit / length
            # During a limited move, at a limit or after a failure, the remaining distance is not
            # the model's error: its integral would have to decrease again later (anti-windup).
            grows = np.linalg.norm(candidate) >= np.linalg.norm(offset)
            if grows and not status.is_success:
                continue
            offset[:] = candidate

    def fade(self, time_step: float, gain: float) -> None:
        """Decreases the correction with the time constant of its growth, in open loop.

        Args:
            time_step: Time that has passed [s].
            gain: Inverse of the time constant [1/s].
        """
        self.offsets *= math.exp(-gain * time_step)

    def reset(self) -> None:
        """Sets the correction to zero."""
        self.offsets[:] = 0.0
