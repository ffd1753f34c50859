"""From targets to the aims of a step: measured effectors, correction by the misfit, approach.

Effectors are measured by markers. In closed loop each target is moved against the model's error. The
error is the misfit: measured minus predicted effector, where the actuators of the model were as those
of the robot were measured. Where setpoints are not measured, this moment is not known, and an
integrator of the distance from the target stands in. A far target is approached on a straight line.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.control.inputs import Misfit
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.model_history import Moment
from softrobot_twin.geometry.shortened_vectors import shortened
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation import Simulation, Status

GREATEST_SHARE = 0.4
"""One measurement adds at most this share of the error to the correction, even if measurements are
rare. The markers show the effect of a command that was sent about one measurement earlier. With
this delay an integrator oscillates when a measurement adds the whole error, and it settles fastest
when a measurement adds a quarter of it."""
MISFIT_SHARE, SURE_SHARE = 0.35, 0.8
"""The correction follows at most this share of a change of the misfit per measurement, the greater one
where the change cannot be noise. It is stable so, for delays of any length, where the robot moves up
to twice as far as the model."""
CALM_FACTOR, CALM_LEAST = 0.9, 0.1
"""At a target that stands, each change that may be noise makes this share smaller by a factor, down to
a least one, so that noise moves a resting robot little."""
NOISE_FACTOR = 4.0
"""A change up to so many standard deviations may be noise."""
UNALIGNED_TIME = 1.0
"""The integrator takes over when no measurement fitted to a moment of the model for this time [s]."""
LEAST_SPREAD = 0.01
"""Markers determine a rotation when they are spread in two directions by this share of the robot's
size, as standard deviation."""


class Law(Enum):
    """How the correction of the targets is found. The value is the word that diagnostics show."""

    NONE = "none"
    """The loop is open, or nothing was measured yet."""
    MISFIT = "misfit"
    """It follows the misfit of the moment that was measured."""
    INTEGRATOR = "integrator"
    """It integrates the distance from the target: measured setpoints do not tell the moment."""


class EffectorMisfit(NamedTuple):
    """Measured minus predicted pose of each effector at one moment.

    Attributes:
        positions: Difference of positions [m], NaN where no marker is visible, shape
            (effector_count, 3).
        seen: How many markers tell it, shape (effector_count,).
        turns: Rotation vector from the predicted to the measured orientation [rad], NaN where the
            markers do not determine it, shape (effector_count, 3); None where no effector asks for
            an orientation.
    """

    positions: np.ndarray
    seen: np.ndarray
    turns: np.ndarray | None = None


@njit(**KERNEL)
def shorten_ways(positions, aims, reach, near):
    """Write points on the lines from positions to aims that are within reach; see `approach`.

    Args:
        positions: Positions [m], shape (effector_count, 3).
        aims: Positions to reach [m], same shape; NaN rows stay NaN.
        reach: Greatest distance [m].
        near: Takes the points [m], same shape.

    Returns:
        Whether any aim is out of reach.
    """
    is_any_far = False
    for e in range(len(aims)):
        squared = 0.0
        for axis in range(3):
            squared += (aims[e, axis] - positions[e, axis]) ** 2
        distance = np.sqrt(squared)
        is_far = distance > reach
        is_any_far |= is_far
        for axis in range(3):
            start, end = positions[e, axis], aims[e, axis]
            near[e, axis] = start + reach / distance * (end - start) if is_far else end
    return is_any_far


@njit(**KERNEL)
def write_distances(is_controlled, targets, predicted, measured, distances):
    """Write the distances of effectors from their targets; see `EffectorMeasurement.errors`.

    Args:
        is_controlled: Whether each direction is controlled, shape (effector_count, 3).
        targets, predicted, measured: Positions [m], same shape.
        distances: Takes the distances [m], shape (effector_count,).
    """
    for e in range(len(targets)):
        is_seen, squared = True, 0.0
        for axis in range(3):
            is_seen &= np.isfinite(measured[e, axis])
        for axis in range(3):
            if is_controlled[e, axis]:
                place = measured[e, axis] if is_seen else predicted[e, axis]
                squared += (targets[e, axis] - place) ** 2
        distances[e] = np.sqrt(squared)


class SensorCorrection:
    """Follows how far measured sensors are from the model, for targets that the robot shall reach.

    The robot shows its target where the model shows the target less this misfit.

    Attributes:
        offsets: The misfit, measured less shown, each in its unit, shape (sensor_count,).
    """

    def __init__(self, lengths: np.ndarray):
        """Begin without a misfit.

        Args:
            lengths: Metres per unit of each sensor, shape (sensor_count,).
        """
        self._lengths, self.offsets = lengths, np.zeros(len(lengths))

    def reset(self) -> None:
        """Forget the misfit."""
        self.offsets = np.zeros(len(self._lengths))

    def follow(
        self, measured: np.ndarray, shown: np.ndarray, limit: float, loaded: np.ndarray | float = 0.0
    ) -> None:
        """Take a share of what the misfit has changed by.

        Args:
            measured: What was measured last, NaN where it is too old, shape (sensor_count,).
            shown: What the model shows, same shape.
            limit: No misfit counts as more, together with `loaded` [m].
            loaded: How much of what the model shows is by forces of an observer, same shape.
        """
        change = MISFIT_SHARE * np.nan_to_num(measured - shown - self.offsets)
        most = limit / self._lengths
        low, high = np.minimum(-most - loaded, 0.0), np.maximum(most - loaded, 0.0)
        self.offsets = np.clip(self.offsets + change, low, high)


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
    near = np.empty(aims.shape)
    return near if shorten_ways(positions, aims, reach, near) else aims


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

    The orientation of an effector that asks for one is measured too, where three markers or more
    stand apart.

    Args:
        simulation: Has the markers of each effector and its controlled directions.
    """

    def __init__(self, simulation: Simulation):
        self._markers = simulation.effector_markers
        self._oriented = simulation.oriented_effectors
        self._least_spread = LEAST_SPREAD * simulation.model.nodes.finite_size
        self._controlled = np.array(
            [axis in effector.directions for effector in simulation.scene.effectors for axis in "xyz"],
            bool,
        ).reshape(-1, 3)
        self._is_all_controlled = bool(self._controlled.all())
        self._nowhere = nowhere = np.full(self._controlled.shape, np.nan)
        # The kernels are loaded before the first tick.
        self.errors(nowhere, nowhere, approach(nowhere, nowhere, math.inf))

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
        if not misfit.visible:
            return self._nowhere
        measured = np.full_like(predicted, np.nan)
        for effector, indices in enumerate(self._markers):
            vectors = misfit.vectors[indices]
            vectors = vectors[np.isfinite(vectors).all(axis=1)]
            if len(vectors):
                measured[effector] = predicted[effector] + vectors.mean(axis=0)
        return measured

    def misfit(self, measured: np.ndarray, model: Moment) -> EffectorMisfit:
        """What the measured markers tell of the effectors.

        Args:
            measured: Measured markers [m], shape (marker_count, 3); NaN for hidden markers.
            model: The model at the moment of the measurement.
        """
        count = len(self._markers)
        found, counts = np.full((2, count, 3), np.nan), np.zeros(count, np.int64)
        for effector, indices in enumerate(self._markers):
            seen = indices[np.isfinite(measured[indices]).all(axis=1)]
            counts[effector] = len(seen)
            if not len(seen):
                continue
            before, after = model.markers[seen], measured[seen]
            shift = after.mean(axis=0) - before.mean(axis=0)
            found[0, effector] = shift
            if not self._oriented[effector]:
                continue
            turn = _rotation(before, after, self._least_spread)
            if turn is not None:
                arm = model.effectors[effector] - before.mean(axis=0)
                found[0, effector] = shift + turn.apply(arm) - arm
                found[1, effector] = turn.as_rotvec()
        return EffectorMisfit(found[0], counts, found[1] if any(self._oriented) else None)

    def moved(self, shifts: np.ndarray) -> np.ndarray:
        """How far effectors move with their markers [m], shape (effector_count, 3); 0 without markers.

        Args:
            shifts: Motion of the markers [m], shape (marker_count, 3).
        """
        return np.array([shifts[own].mean(axis=0) if len(own) else np.zeros(3)
                         for own in self._markers]).reshape(-1, 3)  # fmt: skip

    def controlled(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Targets in the controlled directions, positions in the others [m], same shape.

        Args:
            targets: Targets [m], shape (effector_count, 3).
            positions: Positions [m], same shape.
        """
        return targets if self._is_all_controlled else np.where(self._controlled, targets, positions)

    def differences(self, targets: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Target minus position, 0 in directions that are not controlled [m], same shape.

        Args:
            targets: Targets [m], shape (effector_count, 3).
            positions: Positions [m], same shape.
        """
        return np.where(self._controlled, targets - positions, 0.0)

    def errors(self, targets: np.ndarray, predicted: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Distances from the targets [m], shape (effector_count,), measured where possible.

        Args:
            targets: Targets [m], shape (effector_count, 3); NaN rows give NaN.
            predicted: Effectors of the model [m], same shape.
            measured: Measured effectors [m], same shape; for NaN rows the model's are used.
        """
        distances = np.empty(len(targets))
        write_distances(self._controlled, targets, predicted, measured, distances)
        return distances


def _rotation(before: np.ndarray, after: np.ndarray, least_spread: float) -> Rotation | None:
    """The rotation that turns points best (Kabsch 1976); None where they do not determine it.

    Args:
        before: The points [m], shape (n, 3).
        after: Where they are after it [m], same shape.
        least_spread: Standard deviation of the points along the second of their main axes that they
            must have, before and after [m].
    """
    before, after = before - before.mean(axis=0), after - after.mean(axis=0)
    if len(before) < 3:
        return None
    spread = min(np.linalg.svd(points, compute_uv=False)[1] for points in (before, after))
    spread /= math.sqrt(len(before))
    return Rotation.align_vectors(after, before)[0] if spread >= least_spread else None


class TargetCorrection:
    """What is added to each target, so that the robot and not the model reaches it.

    Where the moment of a measurement is known, the correction c follows the misfit m, which is the
    model's error: c ← c + a (−m − c). The model's own motion is no part of m, so a delay does not
    let it overshoot. Otherwise it is a discrete integrator with anti-windup:
    c ← c + k_i Δt (target − measured effector). While an actuator cannot follow, only changes that
    make the correction shorter are accepted.

    It changes once per measurement, not once per tick, so that each measurement counts once. The
    length of the correction is limited. Without a measurement the correction does not change: the
    last one is the best estimate of the model's error.

    Args:
        effector_count: Number of effectors of the simulation.
        lengths_per_radian: Displacement that counts as much as one radian [m/rad], shape
            (effector_count,); None where no effector asks for an orientation.

    Attributes:
        offsets: Correction c of each target [m], shape (effector_count, 3).
        turns: Rotation vector by which each wanted orientation is turned [rad], same shape.
        law: How they were found last.
    """

    def __init__(self, effector_count: int, lengths_per_radian: np.ndarray | None = None):
        self._both = np.zeros((2, effector_count, 3))
        self.offsets, self.turns = self._both
        self._lengths_per_radian = lengths_per_radian
        self.law = Law.NONE
        self._stamp = self._aligned = 0
        self._calm = 1.0

    @property
    def is_any(self) -> bool:
        """Whether any target is moved or turned."""
        return bool(self._both.any())

    def turned(self, wanted: np.ndarray) -> np.ndarray:
        """Wanted orientations, each turned by its correction.

        Args:
            wanted: Quaternions (x, y, z, w), NaN where free, shape (effector_count, 4).
        """
        turned = wanted.copy()
        for effector in np.flatnonzero(self.turns.any(axis=1) & np.isfinite(wanted).all(axis=1)):
            correction = Rotation.from_rotvec(self.turns[effector])
            turned[effector] = (correction * Rotation.from_quat(wanted[effector])).as_quat()
        return turned

    def is_new(self, stamp: int) -> bool:
        """Whether a measurement has not been used yet.

        Args:
            stamp: Its time [ns].
        """
        return stamp != self._stamp

    def tick(
        self, settings: LoopSettings, stamp: int, errors: np.ndarray | None,
        misfit: EffectorMisfit | None, status: Status, noise: float = 0.0, stands: bool = False,
        loaded: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Uses each new measurement in closed loop; in open loop the correction decays.

        Args:
            settings: Whether the loop is closed, gains and limit.
            stamp: Time of the newest measurement [ns]; an old one is not used again.
            errors: See `update`; None while the effectors do not follow targets.
            misfit: That of the moment that was measured; None where this moment is not known.
            status: Status of the last step.
            noise: Standard deviation of each coordinate of a marker [m]; 0 where it is not known.
            stands: Whether the targets stand and are reached.
            loaded: How far the forces of an observer move the effectors [m], same shape as `offsets`;
                None without an observer.
        """
        self._use(settings, stamp, errors, misfit, status, noise, stands)
        if loaded is not None:
            self.share_limit(loaded, settings.correction_limit)

    def _use(
        self, settings: LoopSettings, stamp: int, errors: np.ndarray | None,
        misfit: EffectorMisfit | None, status: Status, noise: float, stands: bool,
    ) -> None:  # fmt: skip
        since, self._stamp = (stamp - self._stamp) / NANOSECONDS, stamp
        if not settings.closed_loop:
            self.law = Law.NONE
            self.fade(settings.period, settings.correction_gain)
        elif errors is None or since == 0.0:
            return
        elif misfit is not None:
            self.law, self._aligned = Law.MISFIT, stamp
            share = -math.expm1(-settings.misfit_rate * abs(since))
            self.follow(misfit, share, settings.correction_limit, noise, stands)
        elif abs(stamp - self._aligned) > UNALIGNED_TIME * NANOSECONDS:
            self.law = Law.INTEGRATOR
            self.update(
                errors, abs(since), status, settings.correction_gain, settings.correction_limit
            )

    def share_limit(self, loaded: np.ndarray, limit: float) -> None:
        """Makes corrections so short that they and the forces of an observer together keep the limit.

        With a force the model reaches a target as if the target were moved against what the force does.
        Where a force that is certain moves an effector further than the limit, no correction adds to it.

        Args:
            loaded: How far the forces move the effectors [m], shape (effector_count, 3).
            limit: Greatest length of both together [m].
        """
        for offset, moved in zip(self.offsets, loaded, strict=True):
            radius, along = max(limit**2, moved @ moved), offset @ moved
            square = offset @ offset
            if square - 2.0 * along + moved @ moved > radius:
                # The greatest t with |t offset - moved| = radius.
                root = math.sqrt(max(along**2 + square * (radius - moved @ moved), 0.0))
                offset *= (along + root) / square

    def follow(
        self, misfit: EffectorMisfit, share: float, limit: float, noise: float = 0.0,
        stands: bool = False,
    ) -> None:  # fmt: skip
        """Follows the misfit of one measurement.

        Args:
            misfit: The misfit.
            share: The share a of the change that is made at most.
            limit: Greatest length of a correction [m].
            noise: See `tick`.
            stands: See `tick`.
        """
        changes = np.linalg.norm(misfit.positions + self.offsets, axis=1)
        most = NOISE_FACTOR * noise * np.sqrt(3.0 / np.maximum(misfit.seen, 1))
        may_be_noise = bool((changes <= most)[misfit.seen > 0].all())
        is_calm = stands and noise > 0.0 and may_be_noise
        self._calm = max(CALM_FACTOR * self._calm, CALM_LEAST) if is_calm else 1.0
        share = min(share, MISFIT_SHARE if may_be_noise or noise == 0.0 else SURE_SHARE)
        pairs = [(self.offsets, misfit.positions)]
        if misfit.turns is not None:
            pairs.append((self.turns, misfit.turns))
        for corrections, misfits in pairs:
            seen = np.isfinite(misfits).all(axis=1)
            corrections[seen] += self._calm * share * (-misfits[seen] - corrections[seen])
        self.offsets[:] = shortened(self.offsets, limit)
        if misfit.turns is not None and self._lengths_per_radian is not None:
            self.turns[:] = shortened(self.turns, limit, self._lengths_per_radian)

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
        self._both *= math.exp(-gain * time_step)

    def reset(self) -> None:
        """Sets the correction to zero."""
        self._both[:] = 0.0
