"""Calibration: numbers of a scene by what was measured while its robot rested.

At a pose that rests, the model predicts the measured points and efforts y(θ), with derivatives by
`Sensitivities`. Numbers are scaled by what is known of them before, θ = θ₀ + s z, or θ₀ exp(s z) of
what is above zero by its nature, and

    min Σ ρ((y(θ) - m) / σ) + ‖z‖²

is solved by trust-region steps within |z| ≤ 4, with the soft absolute value ρ, which bounds the pull
of outliers. The noise σ of each kind of measurement follows from its residuals. With the scaled
Jacobian J of the measurements, a direction of z whose singular value is small is one that the data
cannot tell; (JᵀJ + 1)⁻¹ is the covariance of z, and also tells what further poses would bring.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from scipy.special import stdtrit

from softrobot_twin.analysis.sensitivities import Loads
from softrobot_twin.calibration.residual_analysis import (
    Hysteresis,
    Linear,
    Reach,
    Step,
    faulty,
    hysteresis,
    reach_of,
    selected,
    spread_between,
)
from softrobot_twin.control.rest_watch import RestPose
from softrobot_twin.errors import NamedError, SceneError
from softrobot_twin.harness.equilibrium import WAY, FollowedPoses, bring_to_rest
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_parameters import (
    COPIES,
    JointParameter,
    Parameter,
    changed_scene,
    joint_changes,
    parameters,
    tied,
)
from softrobot_twin.scene.schema import MarkerFrame
from softrobot_twin.simulation import Simulation, Touched
from softrobot_twin.simulation.build import build_terms

RELATIVE = {"Pa": 0.3, "kg/m³": 0.3, "N": 0.7, "N/m": 0.7, "N m/rad": 0.7}
"""What is known before of what is above zero, by its unit: a standard deviation as a share."""
KNOWN = {"rad": 0.1, "": 0.1}
"""The same of other numbers, in their unit."""
KNOWN_LENGTHS, KNOWN_PLACE = 0.02, 0.1
"""Of lengths, and of the place of the cameras, as shares of the robot's size."""
KNOWN_SCALE = 0.01
"""Of what cameras measure of a unit length."""
KNOWN_PRESSURE = 0.02
"""Of the zero of a pressure, as a share of a large one."""
UNUSUAL = 2.0
"""A number that is further from what is known before stands for another error of the model."""
MOST = 4.0
"""A number stays within so many standard deviations of what is known before."""
SOFT = 3.0
"""Residuals of more standard deviations than this pull less than in proportion."""
TOLD = 3.0
"""A direction is told by the data where they tell it so much better than what is known before."""
IN_DIRECTION = 0.1
"""Numbers that change together along directions that are not told, by more than this share."""
LEAST_NOISE = 1.0e-4
"""Least noise, as a share of the spread of what is measured: models are not more exact."""
LEAST_POSES = 3
OTHER_SHAPE, OTHER_SHAPE_SIZE = 3.0, 0.1
"""At a pose whose points are further off than so many times the median, and than this share of the robot's
size, the model rests in another shape."""
MOST_CANDIDATES, NEW_CANDIDATES = 6, 16
"""Poses of the fit that are tried again, and new ones among which some are chosen."""
LIGHT, HEAVY, HUNG_SHARE = 1.0e-3, 0.1, 0.03
"""Least and greatest weight that is hung on a robot [kg], and the share of the robot's size by which it may move
a point."""
WEIGHTS = tuple(LIGHT * one * ten for ten in (1, 10, 100) for one in (1.0, 2.0, 5.0))
EFFORT_NOISE = 0.01
"""Noise of efforts that were not measured yet, as a share of the largest."""
MEASUREMENTS_A_NUMBER = 3
"""Candidates are as many numbers as have so many measurements each."""
_FAULT_ROUNDS = 3
EACH_HELD_BACK = 4
"""One of so many poses is held back."""
_ROUNDS, _REWEIGHTED = 40, 50
_LEAST_GAIN, _GOOD_GAIN, _NEARER = 0.1, 0.7, 0.4
"""A step is refused where its gain is less than this share of what the linear model promised, and a longer one
is tried where it is more than that share; after a refusal steps are shorter by this factor."""
_NO_GAIN, _LARGE_GAIN = 0.1, 1.0
"""Numbers whose cost is to fall by less than the first are found: it moves them by less than a third of a standard
deviation. Derivatives are taken again where it falls by more than the second, and otherwise than promised."""
_INLIERS, _SPREAD_OF_INLIERS = 3.0, 0.98658
"""Residuals within so many standard deviations, and the standard deviation of a normal distribution that is
cut off there."""
NO_ROBOT = ("control", "effectors", "observer", "solver")
"""Sections without numbers of the robot: where the model looks, and how it is used."""
_PLACE = re.compile(r"markers\[(\d+)\]\.point\[(\d)\]")
FRAME_NUMBERS = ("position", "rotation", "scale")
_FRAME = re.compile(rf"marker_frame\.({'|'.join(FRAME_NUMBERS)})\[(\d)\]")
_ZERO = re.compile(r"(cables|hinge_motors)\[(\d+)\]\.offset")
_LINE, _SOURCE = re.compile(r"(.*), line (\d+)"), re.compile(r"(.*)(?:, line| at) [\d.]+(?: s)?")
_REGULATOR = re.compile(r"cavities\[(\d+)\]\.pressure_(gain|offset)")
_SPECIAL = re.compile("|".join(re.sub(r"\((?!\?)", "(?:", one.pattern)
                               for one in (_PLACE, _FRAME, _ZERO, _REGULATOR)))  # fmt: skip
POINTS = MARKERS, EFFECTORS = "markers", "effectors"
OBSERVED = 1.5
"""By so much more than markers are off do deviations of forces cover the model's own error; see
`docs/observer.md`."""


class CalibrationError(NamedError):
    """A calibration cannot be made; its name is a key of the scene, or the data."""


class Unknown(NamedTuple):
    """A number that is fitted.

    Attributes:
        parameter: Its handle; of equal moduli that change together that of all.
        start: Its value before, or what was measured otherwise.
        known: Standard deviation of what is known before, in its unit; as a share where relative.
        is_relative: Whether its logarithm is fitted, because it is above zero by its nature.
        is_given: Whether it was measured otherwise: then the data need not tell it.
    """

    parameter: Parameter | JointParameter
    start: float
    known: float
    is_relative: bool
    is_given: bool = False

    def value(self, z: float) -> float:
        """The number by its scaled distance from the start.

        Args:
            z: The distance, in standard deviations of what is known before.
        """
        return self.start * np.exp(self.known * z) if self.is_relative else self.start + self.known * z

    def slope(self, z: float) -> float:
        """Derivative of the number by its scaled distance.

        Args:
            z: See `value`.
        """
        return self.known * (self.value(z) if self.is_relative else 1.0)


class Measurements(NamedTuple):
    """Numbers that were measured, of all poses.

    Attributes:
        values: [m], [N], ..., shape (n,).
        kinds: What each is, such as ``markers`` or ``tension``, shape (n,).
        poses: Index of the pose of each, shape (n,).
        axes: What each measures within its kind: the axis of points; None for none, shape (n,).
    """

    values: np.ndarray
    kinds: np.ndarray
    poses: np.ndarray
    axes: np.ndarray | None = None

    @property
    def by_kind(self) -> dict[str, np.ndarray]:
        """Masks of the measurements of each kind, shape (n,)."""
        return {kind: self.kinds == kind for kind in dict.fromkeys(self.kinds.tolist())}

    def alike(self, residuals: np.ndarray) -> float:
        """How many points of a pose count as one: the variance of sums of their residuals over that of
        independent ones. Points of a body that a camera sees displaced as a whole are one.

        Args:
            residuals: Over their noise, shape (n,).
        """
        own = np.isin(self.kinds, POINTS)
        if self.axes is None or not own.any():
            return 1.0
        sums = np.bincount(3 * self.poses[own] + self.axes[own], residuals[own])
        return max(1.0, float(np.sum(sums**2) / max(np.sum(residuals[own] ** 2), 1.0e-12)))


class Prediction(NamedTuple):
    """What a model predicts of measurements.

    Attributes:
        values: Shape (n,).
        jacobian: By the numbers, each per its unit, shape (n, number_count); None where not asked.
    """

    values: np.ndarray
    jacobian: np.ndarray | None


class Model(Protocol):
    """What predicts measurements."""

    def predict(self, numbers: np.ndarray, with_jacobian: bool) -> Prediction:
        """Measurements by the unknown numbers.

        Args:
            numbers: Their values, each in its unit, shape (number_count,).
            with_jacobian: Whether derivatives are asked for.
        """


# --- the model at rest ---------------------------------------------------------------------------


def scene_of_points(scene: Scene) -> Scene:
    """The scene in statics, with an effector in place of each marker, before its own effectors.

    Args:
        scene: The scene.

    Raises:
        SceneError: The robot has no statics, for example because a body is free.
    """
    taken: list[dict[str, Any]] = [
        {"name": f"marker_{one.id}_", "body": one.body, "points": [one.point]} for one in scene.markers]
    taken += [{"name": one.name, "body": one.body, "points": one.points} for one in scene.effectors]
    changes: dict[str, Any] = {"effectors": taken, "markers": [], "observer": None}
    if scene.integration != "quasi_static":
        changes |= {"integration": "quasi_static", "time_scheme": "backward_euler", "spectral_radius": None}
    return changed_scene(scene, changes)


class RestModel:
    """Predicts what is measured at poses at rest, and its derivatives by numbers of the scene.

    Attributes:
        measured: What was measured at the poses, in the order of predictions.
        lost: Poses at which the model did not come to rest in the last prediction.
        distances: Root mean square distances of the points from the measured ones in the last
            prediction [m], NaN where the model did not come to rest, shape (pose_count,).
        size: Of the robot [m].
        begin: The scene that it was built with.
    """

    def __init__(self, scene: Scene, keys: Sequence[Parameter | JointParameter], poses: Sequence[RestPose]):
        """Build the simulation.

        Args:
            scene: The scene.
            keys: Handles of the numbers.
            poses: The poses.

        Raises:
            SceneError: The robot has no statics.
        """
        self._keys, self._scene, self.begin = list(keys), scene, scene
        self._numbers, self._shares = _apart_where_special(self._keys)
        self._followed = FollowedPoses(scene, self._keys, scene_of_points)
        self.size = self.simulation.model.nodes.finite_size
        self._misfits: dict[int, float] = {}
        self._layout = None
        if any(_PLACE.fullmatch(one.key) for one in self._numbers):
            mounted = self.simulation.mounted
            self._layout = build_terms(self.simulation.scene, mounted and mounted.positions).layout
        self._take_poses(poses)

    def _take_poses(self, poses: Sequence[RestPose]) -> None:
        self.poses = list(poses)
        self.lost: list[int] = []
        self.distances = np.full(len(self.poses), np.nan)
        parts = [_stacked(pose.markers, pose.effectors, pose.efforts) for pose in self.poses]
        kinds, usable = self._kinds()
        self._masks = [np.isfinite(values) & usable for values in parts]
        self.measured = Measurements(
            np.concatenate([np.empty(0), *(v[m] for v, m in zip(parts, self._masks, strict=True))]),
            np.concatenate([kinds[:0], *(kinds[mask] for mask in self._masks)]),
            np.repeat(np.arange(len(parts)), [mask.sum() for mask in self._masks]),
            np.concatenate([np.empty(0, int), *(np.arange(len(mask))[mask] % 3 for mask in self._masks)]))

    def of(self, poses: Sequence[RestPose]) -> RestModel:
        """The model at other poses, which knows where this one rested at those that both have.

        Args:
            poses: The poses.
        """
        found = copy(self)
        found._take_poses(poses)
        return found

    @property
    def at(self) -> np.ndarray:
        """The present numbers, shape (number_count,)."""
        return self._followed.values

    @property
    def simulation(self) -> Simulation:
        """That of the scene with the present numbers; an effector stands for each marker."""
        return self._followed.simulation

    def _kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """What each number of a pose is, and whether it follows: given efforts are none that do."""
        actuators, scene = self.simulation.actuators, self._scene
        points = [MARKERS] * (3 * len(scene.markers)) + [EFFECTORS] * (3 * len(scene.effectors))
        follows = ~actuators.is_effort_driven & ~actuators.is_moved
        return (np.array([*points, *(kind.effort.word for kind in actuators.kinds)]),
                np.concatenate([np.ones(len(points), bool), follows]))

    def point_errors(self, off: np.ndarray) -> np.ndarray:
        """Errors of the points, NaN of those that were not measured, shape (pose_count, point_count, 3).

        Args:
            off: Predicted less measured, in the order of `measured`.
        """
        count = len(self._scene.markers) + len(self._scene.effectors)
        found = np.full((len(self.poses), len(self._kinds()[0])), np.nan)
        if len(self._masks):
            found[np.array(self._masks)] = off
        return found[:, : 3 * count].reshape(-1, count, 3)

    def predict(self, numbers: np.ndarray, with_jacobian: bool) -> Prediction:
        """What is measured at the poses, NaN at those where the model does not come to rest, and at all where
        the scene does not take the numbers, such as a cable that would be tied beside its body.

        Args:
            numbers: Values of the numbers, each in its unit, shape (number_count,).
            with_jacobian: Whether derivatives are asked for.
        """
        self.lost, values, parts = [], [], []
        self.distances = np.full(len(self.poses), np.nan)
        try:
            self._followed.take(np.asarray(numbers, float))
        except SceneError:
            count, self.lost = len(self.measured.values), list(range(len(self.poses)))
            return Prediction(np.full(count, np.nan), np.zeros((count, len(self._keys))))
        self._scene = self._followed.scene
        for index, pose in enumerate(self.poses):
            mask = self._masks[index]
            if not self._rests(index, pose):
                self.lost.append(index)
                values.append(np.full(mask.sum(), np.nan))
                parts.append(np.zeros((mask.sum(), len(self._keys))))
                continue
            values.append(self._outputs()[mask])
            if with_jacobian:
                parts.append(self._jacobian(index, pose)[mask])
        empty = np.empty((0, len(self._keys)))
        jacobian = np.concatenate([empty, *parts]) if with_jacobian else None
        return Prediction(np.concatenate([np.empty(0), *values]), jacobian)

    def _rests(self, index: int, pose: RestPose) -> bool:
        """Brings the simulation to rest at a pose: from where it rested there before, or from rest."""
        followed, setpoints, touched, name = self._followed, np.array(pose.setpoints), None, id(pose)
        if len(pose.forces):
            touched = Touched(np.array(pose.forces), np.full(np.shape(pose.forces), np.nan))
        is_known = followed.knows(name)
        rest = followed.settle(name, setpoints, None, touched)
        if not rest.is_reached and is_known:
            self.simulation.reset()
            rest = bring_to_rest(self.simulation, setpoints, WAY, None, touched)
        if not rest.is_reached:
            return False
        followed.stay(name)
        # Of several shapes at one pose that nearest to the measured one is followed.
        self.distances[index] = now = self._misfit(index)
        if now <= self._misfits.get(name, np.inf):
            self._misfits[name] = now
            followed.keep(name, self.simulation.state)
        return True

    def _misfit(self, index: int) -> float:
        """Root mean square distance of the points from the measured ones [m]; 0 without any."""
        pose, points = self.poses[index], 3 * len(self.simulation.effector_names)
        seen = self._masks[index][:points]
        apart = self._outputs()[:points] - _stacked(pose.markers, pose.effectors, pose.efforts)[:points]
        return float(np.sqrt(3.0 * np.mean(apart[seen] ** 2))) if seen.any() else 0.0

    def _outputs(self) -> np.ndarray:
        points, count = self.simulation.effector_positions(), len(self._scene.markers)
        markers = self._scene.marker_frame.of_cameras(points[:count])
        efforts = self.simulation.actuators.told_efforts(self.simulation.state.efforts)
        return _stacked(markers, points[count:], efforts)

    def _jacobian(self, index: int, pose: RestPose) -> np.ndarray:
        """Derivatives of all numbers of a pose, where the simulation rests."""
        place_of = [_PLACE.fullmatch(one.key) for one in self._numbers]
        loads = [self._loads(one, pose) for one in self._numbers]
        found = self._followed.tangent.of_loads(self._numbers, loads)
        if self.distances[index] == self._misfits[id(pose)]:
            self._followed.keep(id(pose), self.simulation.state, found._replace(
                parameters=tuple(self._keys), effectors=found.effectors @ self._shares,
                efforts=found.efforts @ self._shares, moves=found.moves @ self._shares))  # fmt: skip
        points, count = found.effectors, len(self._scene.markers)
        if any(place_of):
            gradients = self._gradients()
            for column, match in enumerate(place_of):
                if match:
                    marker, axis = map(int, match.groups())
                    points[marker, :, column] += gradients[marker, :, axis]
        frame = self._scene.marker_frame
        places = self.simulation.effector_positions()[:count]
        markers = np.einsum("ij,kip->kjp", frame.to_cameras, points[:count])
        by_frame = frame_derivative(frame, places)
        for column, one in enumerate(self._numbers):
            if match := _FRAME.fullmatch(one.key):
                first = FRAME_NUMBERS.index(match[1]) * 3
                markers[:, :, column] += by_frame[:, :, first + int(match[2])]
        width = len(self._numbers)
        return np.concatenate([markers.reshape(-1, width), points[count:].reshape(-1, width),
                               self._told(found.efforts)]) @ self._shares  # fmt: skip

    def _told(self, efforts: np.ndarray) -> np.ndarray:
        """Derivatives of what is told of the efforts, by those of the efforts, same shape."""
        actuators, state = self.simulation.actuators, self.simulation.state
        told = efforts / actuators.effort_gains[:, None]
        for column, one in enumerate(self._numbers):
            if match := _REGULATOR.fullmatch(one.key):
                place = actuators.of_section("cavities").start + int(match[1])
                gain = actuators.effort_gains[place]
                told[place, column] += (1.0 if match[2] == "offset" else -state.efforts[place] / gain**2)
        return told

    def _loads(self, one: Parameter, pose: RestPose) -> Loads:
        """What a number changes while unknowns and efforts stay."""
        model, simulation = self.simulation.model, self.simulation
        a = model.rows.groups.actuators.stop
        none = Loads(np.zeros((model.nodes.free_node_count, 3)), np.zeros(a),
                     np.zeros((len(simulation.effector_names), 3)))  # fmt: skip
        if _PLACE.fullmatch(one.key) or _FRAME.fullmatch(one.key):
            return none
        if match := _ZERO.fullmatch(one.key):
            place = simulation.actuators.of_section(match[1]).start + int(match[2])
            none.displacements[place] = -simulation.actuators.kinds[place].sign
            return none
        if match := _REGULATOR.fullmatch(one.key):
            place = simulation.actuators.of_section("cavities").start + int(match[1])
            if not simulation.actuators.is_effort_driven[place]:
                return none  # What is commanded is the volume; the pressure is only measured.
            entry, effort = self._scene.cavities[int(match[1])], np.zeros(simulation.actuators.count)
            effort[place] = (pose.setpoints[place] - entry.pressure_offset if match[2] == "gain"
                             else -entry.pressure_gain)  # fmt: skip
            model.rows.evaluate(simulation.state.positions)
            model.rows.add_forces(model.rows.multipliers(effort), none.forces)
            return none
        return self._followed.tangent.loads(one)

    def _gradients(self) -> np.ndarray:
        """∂x/∂X of the bodies at the markers, shape (marker_count, 3, 3)."""
        markers, step = self._scene.markers, 1.0e-6 * self.size
        positions, found = self.simulation.state.positions, np.empty((len(markers), 3, 3))
        for index, marker in enumerate(markers):
            shifts = np.concatenate([np.eye(3), -np.eye(3)]) * step
            mapping = self._layout.carried(marker.body, np.array(marker.point) + shifts, "markers", [])
            moved = mapping.positions(positions)
            found[index] = ((moved[:3] - moved[3:]) / (2.0 * step)).T
        return found


def _apart_where_special(
    keys: Sequence[Parameter | JointParameter],
) -> tuple[list[Parameter | JointParameter], np.ndarray]:
    """Numbers whose derivatives are taken, and the share of each in each key, shape (n, key_count).

    Numbers that are no term of the model have derivatives of their own, also where they are tied.
    """
    found, parts = dict[str, Parameter | JointParameter](), []
    for one in keys:
        own: list[tuple[Parameter | JointParameter, float]] = [(one, 1.0)]
        if isinstance(one, JointParameter) and any(_SPECIAL.fullmatch(number.key) for number in one.numbers):
            own = list(zip(one.numbers, one.shares, strict=True))
        found |= {number.key: number for number, _ in own}
        parts.append({number.key: share for number, share in own})
    shares = np.array([[own.get(key, 0.0) for own in parts] for key in found]).reshape(len(found), len(parts))
    return list(found.values()), shares


def _stacked(markers: np.ndarray, effectors: np.ndarray, efforts: np.ndarray) -> np.ndarray:
    return np.concatenate([np.ravel(markers), np.ravel(effectors), efforts])


def frame_derivative(frame: MarkerFrame, points: np.ndarray) -> np.ndarray:
    """Derivatives of points in the frame of the cameras by position, angles and scales of that frame.

    Args:
        frame: The frame.
        points: In the frame of the robot [m], shape (n, 3).

    Returns:
        Shape (n, 3, 9); by the position first, by the scales last.
    """
    # R turns about x, then y, then z: each angle turns about its axis as those after it have turned it.
    x, y, z = (MarkerFrame(rotation=(axis * frame.rotation).tolist()).to_cameras for axis in np.eye(3))
    R, from_origin = z @ y @ x, points - np.array(frame.position)
    axes = (z @ y @ np.eye(3)[0], z @ np.eye(3)[1], np.eye(3)[2])
    found = np.zeros((len(points), 3, 9))
    found[:, :, :3] = -R.T
    for k, axis in enumerate(axes):
        found[:, :, 3 + k] = -np.cross(axis, from_origin) @ R
        found[:, k, 6 + k] = from_origin @ R[:, k]
    found[:, :, :6] *= np.array(frame.scale)[:, None]
    return found


# --- the estimate --------------------------------------------------------------------------------


class Estimate(NamedTuple):
    """Numbers of a scene that explain measurements.

    Attributes:
        unknowns: The numbers, p of them.
        z: Their scaled distances from the start, shape (p,).
        covariance: Of z, shape (p, p).
        noise: Standard deviation of each kind of measurement, in its unit.
        jacobian: Of the measurements over their noise (`scale_of`), by z, shape (n, p).
        residuals: Predicted less measured, over the same, shape (n,).
        freedom: Degrees of freedom of the variances of z, shape (p,).
        alike: How many points of a pose count as one; see `Measurements.alike`.
    """

    unknowns: tuple[Unknown, ...]
    z: np.ndarray
    covariance: np.ndarray
    noise: dict[str, float]
    jacobian: np.ndarray
    residuals: np.ndarray
    freedom: np.ndarray
    alike: float = 1.0

    @property
    def values(self) -> np.ndarray:
        """The numbers, each in its unit, shape (p,)."""
        return np.array([one.value(z) for one, z in zip(self.unknowns, self.z, strict=True)])

    def changes(self, scene: Scene) -> dict[str, float]:
        """The numbers by the keys of a scene, each in its unit.

        Args:
            scene: The scene.
        """
        return joint_changes(scene, [one.parameter for one in self.unknowns], self.values)

    @property
    def intervals(self) -> np.ndarray:
        """Ends of the 95 % intervals of the numbers, shape (p, 2)."""
        wide = stdtrit(self.freedom, 0.975) * np.sqrt(np.diag(self.covariance))
        return np.array([[one.value(z - w), one.value(z + w)]
                         for one, z, w in zip(self.unknowns, self.z, wide, strict=True)])  # fmt: skip

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of the numbers, in their units; shares of relative ones, shape (p,)."""
        return np.sqrt(np.diag(self.covariance)) * [one.known for one in self.unknowns]

    def without(self, places: Sequence[int]) -> Estimate:
        """The estimate with some numbers back at their start, to which the others adapt.

        The intervals of the others stay as wide as they are with these numbers unknown.

        Args:
            places: Indices of these numbers.
        """
        kept = np.delete(np.arange(len(self.z)), places)
        J, others = self.jacobian[:, kept], self.jacobian[:, places] @ self.z[places]
        moved = np.linalg.solve(J.T @ J + np.eye(len(kept)), J.T @ others)
        return Estimate(
            tuple(self.unknowns[i] for i in kept), self.z[kept] + moved,
            self.covariance[np.ix_(kept, kept)], self.noise, J, self.residuals - others + J @ moved,
            self.freedom[kept], self.alike)

    def scale_of(self, kinds: np.ndarray) -> np.ndarray:
        """Noise of measurements that weighs the points of a pose as what they tell together.

        Args:
            kinds: Shape (n,).
        """
        return _scales(kinds, self.noise, self.alike)

    def linear(self, poses: np.ndarray) -> Linear:
        """The fit as a linear model, in which residuals of outliers weigh less.

        Args:
            poses: Of the measurements, see `Measurements`.
        """
        root = (1.0 + (self.residuals / SOFT) ** 2) ** -0.25
        return Linear(root * self.residuals, root[:, None] * self.jacobian, self.z, poses)

    def of(self, places: Sequence[int], wide: Estimate) -> Estimate:
        """The estimate with the variances that its numbers have where others are not known either.

        Args:
            places: Indices of its numbers among those of the other estimate.
            wide: An estimate with more numbers.
        """
        return self._replace(covariance=wide.covariance[np.ix_(places, places)], freedom=wide.freedom[list(places)])

    def at_bounds(self) -> list[str]:
        """Keys of the numbers that went as far as they may."""
        return [one.parameter.key for one, z in zip(self.unknowns, self.z, strict=True)
                if abs(z) > 0.99 * MOST]  # fmt: skip


def estimate(model: Model, measured: Measurements, unknowns: Sequence[Unknown]) -> Estimate:
    """Fits the numbers to measurements.

    Args:
        model: Predicts the measurements.
        measured: They.
        unknowns: The numbers.

    Raises:
        CalibrationError: There are fewer measurements than numbers, or the model does not come to
            rest at its start.
    """
    count = len(unknowns)
    if len(measured.values) <= count:
        raise CalibrationError("data", f"{len(measured.values)} measured numbers are too few for "
                               f"{count} unknown ones")
    scaled, z = _Scaled(model, unknowns), np.zeros(count)
    here, radius, is_here = scaled.at(z, True), 1.0, True
    if not np.isfinite(here.values).all():
        raise CalibrationError("data", "the model does not come to rest at a pose")
    noise, alike = _noise(here.values - measured.values, measured, count), 1.0
    for _ in range(_ROUNDS):
        to, after, alike_there = _polished(z, here, measured, noise, radius)
        per, told = _scales(measured.kinds, after, alike_there), here.values + here.jacobian @ (to - z)
        now, promised = (_cost((values - measured.values) / per, at) for values, at in
                         ((here.values, z), (told, to)))  # fmt: skip
        if now - promised < _NO_GAIN:
            break
        there, step = scaled.at(to, False).values, to - z
        # Where a pose is lost the gain is no number.
        gain = (now - _cost((there - measured.values) / per, to)) / (now - promised)
        if not gain > _LEAST_GAIN:
            radius = _NEARER * np.abs(step).max()
            if not is_here:
                here, is_here = scaled.at(z, True), True
            continue
        z, noise, alike = to, after, alike_there
        if gain > _GOOD_GAIN:
            radius = max(radius, 2.0 * np.abs(step).max())
        here, is_here = here._replace(values=there), False
        if gain < _GOOD_GAIN and now - promised > _LARGE_GAIN:
            here, is_here = scaled.at(z, True), True
    per = _scales(measured.kinds, noise, alike)
    residuals, J = (here.values - measured.values) / per, here.jacobian / per[:, None]
    soft = 1.0 + (residuals / SOFT) ** 2
    # Information of an estimate with pulls ψ: (Σ ψ')² / Σ ψ², by which normal noise loses 1 %.
    share = np.mean(soft**-1.5) ** 2 / max(np.mean(residuals**2 / soft), 1.0e-12)
    covariance = np.linalg.inv(min(share, 1.0) * J.T @ J + np.eye(count))
    # By Satterthwaite: a variance is the sum of one of the data, whose noise is known from residuals,
    # and one of what is known before.
    variances = np.diag(covariance)
    of_data = np.maximum(variances - np.sum(covariance**2, axis=1), 1.0e-12 * variances)
    freedom = max(1.0, len(residuals) / alike - count + variances.sum()) * (variances / of_data) ** 2
    return Estimate(tuple(unknowns), z, covariance, noise, J, residuals, freedom, alike)


def _cost(residuals: np.ndarray, z: np.ndarray) -> float:
    """What is minimised, of residuals over their noise, at z."""
    return float(np.sum(2.0 * SOFT**2 * (np.sqrt(1.0 + (residuals / SOFT) ** 2) - 1.0)) + z @ z)


def _scales(kinds: np.ndarray, noise: Mapping[str, float], alike: float) -> np.ndarray:
    """Noise of measurements of these kinds, that of points as if as many as are alike were one."""
    return np.array([noise[kind] for kind in kinds]) * np.where(np.isin(kinds, POINTS), np.sqrt(alike), 1.0)


def _polished(
    z: np.ndarray, here: Prediction, measured: Measurements, noise: dict[str, float], radius: float
) -> tuple[np.ndarray, dict[str, float], float]:
    """The minimum of a model near z that is linear with what is predicted there, with the noise that follows
    from its residuals, and how many points are alike."""
    count, taken, origin = len(z), float(len(z)), here.values - here.jacobian @ z - measured.values
    low, high = np.maximum(z - radius, -MOST), np.minimum(z + radius, MOST)
    for _ in range(_REWEIGHTED):
        off = origin + here.jacobian @ z
        before, noise = noise, _noise(off, measured, taken)
        alike = measured.alike(np.clip(off / _scales(measured.kinds, noise, 1.0), -SOFT, SOFT))
        per = _scales(measured.kinds, noise, alike)
        root = (1.0 + (off / per / SOFT) ** 2) ** -0.25
        A = np.concatenate([here.jacobian * (root / per)[:, None], np.eye(count)])
        b = A @ z - np.concatenate([root * off / per, z])
        # Of points that are alike a number takes up several; what is known of it may take its place.
        taken = max(float(count), alike * (count - np.trace(np.linalg.inv(A.T @ A))))
        moved, z = z, np.linalg.lstsq(A, b, rcond=None)[0]
        if np.any((z < low) | (z > high)):
            from scipy.optimize import lsq_linear  # it loads slowly

            z = lsq_linear(A, b, (low, high)).x
        if np.abs(z - moved).max(initial=0.0) < 1.0e-6 and all(
                abs(noise[kind] / before[kind] - 1.0) < 1.0e-3 for kind in noise):  # fmt: skip
            break
    return z, noise, alike


class _Scaled:
    """A model by scaled numbers."""

    def __init__(self, model: Model, unknowns: Sequence[Unknown]):
        self._model, self._unknowns = model, unknowns
        self._known: dict[bytes, Prediction] = {}

    def at(self, z: np.ndarray, with_jacobian: bool) -> Prediction:
        """The prediction at z, with the derivative by z."""
        key = z.tobytes()
        found = self._known.get(key)
        if found is None or (with_jacobian and found.jacobian is None):
            pairs = list(zip(self._unknowns, z, strict=True))
            found = self._model.predict(np.array([one.value(at) for one, at in pairs]), with_jacobian)
            slopes = np.array([one.slope(at) for one, at in pairs])
            found = found._replace(jacobian=found.jacobian * slopes if with_jacobian else None)
            self._known[key] = found
        return found


def _noise(residuals: np.ndarray, measured: Measurements, taken: float) -> dict[str, float]:
    """Standard deviation of the residuals of each kind, of which some may be outliers and a fit took up some."""
    freedom = np.sqrt(len(residuals) / max(1.0, len(residuals) - taken))
    found = {}
    for kind, is_own in measured.by_kind.items():
        own = residuals[is_own]
        typical = 1.4826 * np.median(np.abs(own))
        inside = own[np.abs(own) <= _INLIERS * typical]
        spread = np.sqrt(np.mean(inside**2)) / _SPREAD_OF_INLIERS if len(inside) else typical
        least = LEAST_NOISE * np.std(measured.values[is_own])
        found[kind] = max(float(freedom * spread), float(least), 1.0e-12)
    return found


# --- what the data tell --------------------------------------------------------------------------


def not_told(jacobian: np.ndarray, least: float = TOLD, given: Sequence[int] = ()) -> list[tuple[int, ...]]:
    """Numbers that the data cannot tell, in groups that they cannot tell apart.

    Args:
        jacobian: See `Estimate`.
        least: See `TOLD`.
        given: Indices of numbers that were measured otherwise, which are in no group.

    Returns:
        Indices of the numbers of each group.
    """
    if len(given):
        others = np.delete(np.arange(jacobian.shape[1]), given)
        # What is left of each column where the given numbers take, within what is known of them, their part.
        J = np.vstack([jacobian, np.eye(jacobian.shape[1])[list(given)]])
        left = J[:, others] - J[:, given] @ np.linalg.lstsq(J[:, given], J[:, others], rcond=None)[0]
        return [tuple(int(others[i]) for i in group) for group in not_told(left, least)]
    _, singular, V = np.linalg.svd(jacobian, full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(V) - len(singular))])
    weak = V[singular < least]
    shares = np.abs(weak.T @ weak) > IN_DIRECTION
    left, groups = set(np.flatnonzero(shares.diagonal()).tolist()), []
    while left:
        group, new = set[int](), {min(left)}
        while new:
            group |= new
            new = {int(j) for i in new for j in np.flatnonzero(shares[i])} & left - group
        groups.append(tuple(sorted(group)))
        left -= group
    return groups


def deviations_with(jacobian: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """Standard deviations of z by measurements with these Jacobians, shape (p,).

    Args:
        jacobian: See `Estimate`.
        *others: Those of further measurements.
    """
    return np.sqrt(np.diag(np.linalg.inv(np.eye(jacobian.shape[1]) + sum(J.T @ J for J in (jacobian, *others)))))


# --- the whole -----------------------------------------------------------------------------------


class Validation(NamedTuple):
    """How far predictions are from what was measured at poses that were held back.

    Attributes:
        before: Root mean square of each kind of measurement, before; of points that of distances [m].
        after: The same with the fitted numbers.
        inside: Share of the measurements of each kind that are within their 95 % intervals of
            prediction; see `forecast`.
        by_pose: Root mean square distance of the points at each pose [m], before and after, shape
            (2, pose_count).
        origins: Of the poses.
    """

    before: dict[str, float]
    after: dict[str, float]
    inside: dict[str, float]
    by_pose: np.ndarray
    origins: tuple[str, ...]

    @property
    def is_better(self) -> bool:
        """Whether the points, or without any the efforts, are nearer than before."""
        points = [kind for kind in self.before if kind in POINTS]
        return all(self.after[kind] < self.before[kind] for kind in points or self.before)


class Calibration(NamedTuple):
    """What a calibration found.

    Attributes:
        scene: With the fitted numbers, also where they shall not be used.
        estimate: The numbers.
        validation: On poses that were held back.
        not_told: Keys of the numbers that the data cannot tell, in groups that they cannot tell apart.
            A number that is alone in its group stays as it was, and is not among those of `estimate`.
        pose_count: Poses of the fit.
        set_aside: Poses that were left out, each with the reason.
        start: The scene before.
        poses: The poses of the fit.
        joint: The estimate with the numbers that are not told.
        steps: What each number brought that was chosen without keys, the first first.
        reach: How errors grow outside of the poses of the fit.
        hysteresis: See there; None where there is none.
        size: Of the robot [m].
    """

    scene: Scene
    estimate: Estimate
    validation: Validation
    not_told: tuple[tuple[str, ...], ...]
    pose_count: int
    set_aside: tuple[str, ...]
    start: Scene
    poses: tuple[RestPose, ...]
    joint: Estimate
    steps: tuple[tuple[str, Step], ...]
    reach: Reach
    hysteresis: Hysteresis | None
    size: float

    @property
    def values(self) -> dict[str, float]:
        """The fitted numbers by their keys, each in its unit."""
        return self.estimate.changes(self.start)

    @property
    def systematic_error(self) -> float:
        """What an observer shall take the model to be off at the markers [m]; 0 without markers.

        The root mean square distance at poses that were held back, or that of the fit where it is larger
        (few poses are held back, which may be good ones by luck), less the noise of the markers where the
        observer of the scene knows it, `OBSERVED` times.
        """
        noise = (self.scene.observer and self.scene.observer.marker_noise) or 0.0
        after = self.validation.after.get(MARKERS, 0.0)
        after = max(after, np.sqrt(3.0) * self.estimate.noise.get(MARKERS, 0.0))
        return OBSERVED * float(np.sqrt(max(0.0, after**2 - 3.0 * noise**2)))

    @property
    def unusual(self) -> list[Unknown]:
        """Numbers that are further from what is known before than `UNUSUAL` deviations."""
        return [one for one, z in zip(self.estimate.unknowns, self.estimate.z, strict=True) if abs(z) > UNUSUAL]

    @property
    def is_accepted(self) -> bool:
        """Whether there are numbers that the data tell apart, and they are better than those before."""
        are_apart = all(len(group) == 1 for group in self.not_told)
        return are_apart and bool(self.estimate.unknowns) and self.validation.is_better and not self.is_elsewhere

    @property
    def is_elsewhere(self) -> bool:
        """Whether the robot is so far from the model at most poses that it must rest in another place."""
        return bool(np.median(self.validation.by_pose[1]) > OTHER_SHAPE_SIZE * self.size)


def usual_keys(scene: Scene) -> list[list[str]]:
    """Keys of what differs most often between a robot and its scene, the first first, in groups.

    Moduli, gains and zeros of regulators, zeros of motors, where cables, beams and what is mounted are,
    zeros of winches, where markers are glued, and the cameras.

    Args:
        scene: The scene.
    """
    known = [one.key for one in parameters(scene)]
    kinds = [r".*\.young_modulus"]
    kinds += [rf"cavities\[{index}\]\.pressure_(gain|offset)" for index, cavity in
              enumerate(scene.cavities) if cavity.control == "pressure"]  # fmt: skip
    found = [[key for key in known if re.fullmatch(kind, key)] for kind in kinds]
    for kind in (r"hinge_motors.*\.(offset|stiffness)", r"beams.*\.arcs\[\d+\]\.angle",
                 r"beams\[\d+\]\.points\[0\]\[\d\]", r"beams.*\.through\[\d\]",
                 r"mounting.*\.translation\[\d\]"):  # fmt: skip
        found += _by_copies(scene, [key for key in known if re.fullmatch(kind, key)])
    found.append([key for key in known if re.fullmatch(r"hinge_motors.*\.offset", key)])
    for index, cable in enumerate(scene.cables):
        # A cable through several points runs beside its place as a whole.
        places = [f"cables[{index}].points.*"]
        if len(cable.points) > 1 and cable.pull_point is not None:
            places.append(f"cables[{index}].pull_point")
        found += [["+".join(f"{place}[{axis}]" for place in places)] for axis in range(3)]
    found.append([key for key in known if re.fullmatch(r"cables.*\.offset", key)])
    if scene.markers:
        found += [[f"+markers.*.point[{axis}]"] for axis in range(3)]
        # Scales would take up what the model is off: they are fitted where somebody asks for them.
        found.append([key for key in known if _FRAME.fullmatch(key) and ".scale" not in key])
    return [keys for keys in found if keys]


def _by_copies(scene: Scene, keys: list[str]) -> list[list[str]]:
    """Keys of the numbers of repeated entries, each with its copies; the others are left out."""
    found = {one.key: len(one.numbers) for key in keys for one in tied(scene, f"{key}{COPIES}")
             if isinstance(one, JointParameter)}  # fmt: skip
    return [[key] for key, count in found.items() if count > 1]


Given: TypeAlias = float | tuple[float, float]
"""What is known of a number: its standard deviation, or what was measured otherwise with its deviation."""


def unknowns_of(
    scene: Scene, keys: Sequence[str], known: Mapping[str, Given] | None = None
) -> tuple[Unknown, ...]:
    """Numbers of a scene that shall be fitted, with what is known of them before.

    Young's moduli that one key names and that are equal change together: they are of one material.

    Args:
        scene: The scene.
        keys: See `softrobot_twin.scene.scene_parameters.tied`; none for `usual_keys`, beside those of
            `known` that were measured.
        known: What is known by keys: deviations in the unit of the number, as shares of numbers above
            zero by nature; or a value and its deviation, both in the unit.

    Raises:
        SceneError: No number has such a key.
        CalibrationError: A number cannot be fitted.
    """
    simulation = Simulation(scene, with_warnings=False)
    size = simulation.model.nodes.finite_size
    given, measured = dict[str, tuple[str, Given]](), list[list[str]]()
    for key, value in (known or {}).items():
        given |= {one.key: (key, value) for one in _together(scene, [key])}
        measured += [[key]] if isinstance(value, tuple) else []
    efforts = simulation.actuators.effort_scale[simulation.actuators.of_section("cavities")]
    found = dict[str, Parameter | JointParameter]()
    for own in [[key] for key in keys] or measured + usual_keys(scene):
        found |= {one.key: one for one in _together(scene, own)}
    for one, (key, _) in given.items():
        if keys and one not in found:
            raise CalibrationError(key, "is known, but is none of the numbers that are fitted")
    return tuple(_unknown(scene, one, size, efforts, given.get(one.key, ("", None))[1])
                 for one in found.values())  # fmt: skip


def _together(scene: Scene, keys: Sequence[str]) -> Iterator[Parameter | JointParameter]:
    """Numbers, of which equal moduli are one, and those that are tied."""
    if "+" in keys[0] or keys[0].endswith(COPIES):
        yield from tied(scene, keys[0])
        return
    alike: dict[object, list[Parameter]] = {}
    for one in parameters(scene, *keys):
        if one.key.startswith("marker_frame.scale") and keys[0] == "marker_frame":
            continue  # A camera is scaled by its maker: a scale is asked for by name.
        is_modulus = one.key.endswith("young_modulus")
        alike.setdefault(one.read(scene) if is_modulus else one.key, []).append(one)
    for own in alike.values():
        others = len(own) - 1
        yield own[0] if not others else JointParameter(
            f"{own[0].key} and {others} more", own[0].unit, tuple(own), (0.0,) * len(own),
            (1.0,) * len(own))  # fmt: skip


def _unknown(
    scene: Scene, one: Parameter | JointParameter, size: float, efforts: np.ndarray, given: Given | None
) -> Unknown:
    """A number with what is known of it before."""
    start, unit, match = one.read(scene), one.unit, _REGULATOR.fullmatch(one.key)
    if any(section in NO_ROBOT for section in one.sections):
        raise CalibrationError(one.key, "says how the model is used, and is no number of the robot")
    if not np.isfinite(start):
        raise CalibrationError(one.key, f"is {start:g}: give it a first value in the scene")
    is_relative = unit in RELATIVE and match is None
    if is_relative and start <= 0.0:
        raise CalibrationError(one.key, f"is {start:g} {unit}: give it a first value above zero")
    if isinstance(given, tuple):
        value, deviation = given
        if is_relative and value <= 0.0:
            raise CalibrationError(one.key, f"is known as {value:g} {unit}, but is above zero")
        return Unknown(one, value, deviation / value if is_relative else deviation, is_relative, True)
    length = KNOWN_PLACE if one.key.startswith("marker_frame") else KNOWN_LENGTHS
    if is_relative:
        usual = RELATIVE[unit]
    elif match is not None and unit:
        usual = KNOWN_PRESSURE * float(efforts[int(match[1])])
    elif one.key.startswith("marker_frame.scale"):
        usual = KNOWN_SCALE
    else:
        usual = length * size if unit == "m" else KNOWN.get(unit, 0.1 * abs(start) or 1.0)
    return Unknown(one, start, usual if given is None else float(given), is_relative)


def calibrate(
    scene: Scene, poses: Sequence[RestPose], keys: Sequence[str],
    known: Mapping[str, Given] | None = None, check: Sequence[RestPose] = (),
) -> Calibration:  # fmt: skip
    """Fits numbers of a scene to what was measured at rest, and tries them at poses held back.

    Args:
        scene: The scene.
        poses: The poses.
        keys: Keys of the numbers, see `unknowns_of`. Without any, those are fitted that lower the error of
            poses held back.
        known: See `unknowns_of`.
        check: Poses that judge, in place of every fourth one.

    Raises:
        SceneError: No number has such a key, or the robot has no statics.
        CalibrationError: The poses are too few, or a number cannot be fitted.
    """
    unknowns = unknowns_of(scene, keys, known)
    handles = [one.parameter for one in unknowns]
    model = RestModel(scene, handles, poses)
    (used, aside), (judges, more) = _usable(model), _usable(model.of(check))
    aside, total = _Aside(aside + more, []), len(used) + len(judges)
    if total < LEAST_POSES or (check and not judges) or not used:
        raise CalibrationError("data", f"{total} poses at rest can be used, {LEAST_POSES} are "
                               f"needed: {'; '.join(aside.words) or 'no more were recorded'}")
    held = judges or used[EACH_HELD_BACK - 1 :: EACH_HELD_BACK] or used[-1:]
    own = [pose for pose in used if not any(pose is one for one in held)]
    if not keys:
        # The first ones are known from elsewhere, or differ most often.
        unknowns = unknowns[: max(1, len(model.of(own).measured.values) // MEASUREMENTS_A_NUMBER)]
        model = RestModel(scene, [one.parameter for one in unknowns], [*used, *judges])
    fit = _fitted(model, own, unknowns, bool(keys), aside)
    kept = fit.found.without(fit.unused)
    fitted = changed_scene(scene, kept.changes(scene))
    told = dict(zip((one.parameter.key for one in kept.unknowns), kept.values, strict=True))
    # What was not told stays as the scene has it.
    values = np.array([told.get(one.parameter.key, one.parameter.read(scene)) for one in fit.wide.unknowns])
    reach = reach_of(fit.found.linear(fit.model.measured.poses), np.array([one.setpoints for one in fit.poses]))
    sessions, off = _sessions(fit.poses), [_mean(one) for one in fit.errors]
    reach = reach._replace(sessions=tuple(np.unique(sessions)), between=spread_between(np.array(off), sessions))
    held, off = _judged(model, fit, values, held, aside)
    return Calibration(
        fitted, kept, validated(model.of(held), fit.wide, values, reach), fit.not_told, len(fit.poses),
        tuple(aside.words + _rows_in_words(aside.rows)), scene, tuple(fit.poses), fit.found, fit.steps, reach,
        hysteresis(*_in_order(used, off)), model.size)  # fmt: skip


class _Aside(NamedTuple):
    """What was left out.

    Attributes:
        words: Sentences on poses and points.
        rows: Poses of which all points are faulty, and how far these are off [m], shape (3,) each.
    """

    words: list[str]
    rows: list[tuple[RestPose, np.ndarray]]


class _Fit(NamedTuple):
    """A fit, before it is judged.

    Attributes:
        found: The estimate.
        wide: That of all candidates, by which predictions vary; the estimate where keys are given.
        unused: Indices of the numbers of the estimate that stay as they were.
        not_told: See `Calibration`.
        steps: See there.
        poses: The poses without faulty points.
        model: Of these.
    """

    found: Estimate
    wide: Estimate
    unused: list[int]
    not_told: tuple[tuple[str, ...], ...]
    steps: tuple[tuple[str, Step], ...]
    poses: list[RestPose]
    model: RestModel

    @property
    def errors(self) -> np.ndarray:
        """Those of its points; see `RestModel.point_errors`."""
        return self.model.point_errors(self.found.residuals * self.found.scale_of(self.model.measured.kinds))


def _fitted(
    model: RestModel, own: list[RestPose], unknowns: tuple[Unknown, ...], has_keys: bool, aside: _Aside
) -> _Fit:
    """Fits all numbers, or those of them that lower the error of poses that are held back."""
    found, own, at = _without_faults(model, own, unknowns, aside)
    keys, given = [one.parameter.key for one in unknowns], [i for i, one in enumerate(unknowns) if one.is_given]
    if has_keys:
        groups = not_told(found.jacobian, given=given)
        unused = [group[0] for group in groups if len(group) == 1]
        return _Fit(found, found, unused, tuple(tuple(keys[i] for i in one) for one in groups), (), own, at)
    points = np.isin(at.measured.kinds, POINTS)
    steps = selected(found.linear(at.measured.poses), given, points if points.any() else None)
    chosen, wide = sorted(one.number for one in steps), found
    left = tuple((key,) for i, key in enumerate(keys) if i not in chosen)
    told = tuple((keys[one.number], one) for one in steps)
    if not chosen:
        return _Fit(found, wide, list(range(len(keys))), left, told, own, at)
    if left:
        some = tuple(unknowns[i] for i in chosen)
        small = RestModel(model.begin, [one.parameter for one in some], own)
        found = estimate(small, small.measured, some).of(chosen, wide)
    return _Fit(found, wide, [], left, told, own, at)


def _without_faults(
    model: RestModel, poses: list[RestPose], unknowns: tuple[Unknown, ...], aside: _Aside
) -> tuple[Estimate, list[RestPose], RestModel]:
    """The estimate by the poses without faulty points, these poses, and their model."""
    for cleaned_times in range(_FAULT_ROUNDS + 1):
        found = estimate(at := model.of(poses), at.measured, unknowns)
        left, out = _cleaned(at, poses, found.residuals * found.scale_of(at.measured.kinds))
        if not any(out) or cleaned_times == _FAULT_ROUNDS:
            break
        aside.words.extend(out.words)
        aside.rows.extend(out.rows)
        poses = left
    return found, poses, at


def _cleaned(
    model: RestModel, poses: list[RestPose], off: np.ndarray, least: float = 0.0
) -> tuple[list[RestPose], _Aside]:
    """Poses without their faulty points, and what was left out."""
    errors = model.point_errors(off)
    found = faulty(errors, least)
    kept, out = list[RestPose](), _Aside([], [])
    for pose, bad, error in zip(poses, found, errors, strict=True):
        if not bad.any():
            kept.append(pose)
            continue
        mean = -np.mean(error[bad], axis=0)
        if bad[np.isfinite(error[:, 0])].all():
            out.rows.append((pose, mean))
            continue
        names = ", ".join(model.simulation.effector_names[i].strip("_").replace("_", " ") for i in np.flatnonzero(bad))
        out.words.append(f"{pose.origin}: {names} {_off_in_words(mean)}")
        markers, effectors = pose.markers.copy(), pose.effectors.copy()
        markers[bad[: len(markers)]], effectors[bad[len(markers) :]] = np.nan, np.nan
        kept.append(pose._replace(markers=markers, effectors=effectors))
    return kept, out


def _rows_in_words(rows: Sequence[tuple[RestPose, np.ndarray]]) -> list[str]:
    """Faulty rows; those that follow one another in one file are one, of the fit or held back."""
    files = list(dict.fromkeys(_line(pose)[0] for pose, _ in rows))
    blocks: list[list[tuple[RestPose, np.ndarray]]] = []
    for pose, off in sorted(rows, key=lambda row: (files.index(_line(row[0])[0]), _line(row[0])[1])):
        name, line = _line(pose)
        if blocks and line:
            before, its_off = blocks[-1][-1]
            if _line(before) == (name, line - 1) and np.linalg.norm(off - its_off) < 0.5 * np.linalg.norm(off):
                blocks[-1].append((pose, off))
                continue
        blocks.append([(pose, off)])
    words = []
    for block in blocks:
        name, last = block[0][0].origin, _line(block[-1][0])[1]
        lines = name if len(block) == 1 else f"{name.replace('line', 'lines')} to {last}"
        words.append(f"{lines}: {_off_in_words(np.mean([off for _, off in block], axis=0))}")
    return words


def _sessions(poses: Sequence[RestPose]) -> np.ndarray:
    """Files that poses are from; empty for others, shape (pose_count,)."""
    found = [_SOURCE.fullmatch(pose.origin) for pose in poses]
    return np.array([match[1] if match else "" for match in found])


def _line(pose: RestPose) -> tuple[str, int]:
    """File and line that a pose is from; 0 without one."""
    match = _LINE.fullmatch(pose.origin)
    return (match[1], int(match[2])) if match else (pose.origin, 0)


def _off_in_words(off: np.ndarray) -> str:
    """How far a measurement is from where the model is."""
    x, y, z = 1e3 * off
    return f"measured {1e3 * np.linalg.norm(off):.1f} mm off (x {x:+.1f}, y {y:+.1f}, z {z:+.1f})"


def _judged(
    model: RestModel, fit: _Fit, values: np.ndarray, held: list[RestPose], aside: _Aside
) -> tuple[list[RestPose], dict[int, tuple[np.ndarray, np.ndarray]]]:
    """The poses that judge without faulty points; and mean error and mean place of the points of all poses."""
    judge = model.of(held)
    off = judge.predict(values, False).values - judge.measured.values
    usual = np.linalg.norm(fit.errors, axis=2)
    least = float(np.nanmedian(usual)) if np.isfinite(usual).any() else 0.0
    both = [*zip(fit.poses, fit.errors, strict=True), *zip(held, judge.point_errors(off), strict=True)]
    means = {id(pose.setpoints): (_mean(error), _mean(np.concatenate([pose.markers, pose.effectors])))
             for pose, error in both}  # fmt: skip
    left, out = _cleaned(judge, held, off, least)
    aside.words.extend(out.words)
    aside.rows.extend(out.rows)
    return left or held, means


def _mean(points: np.ndarray) -> np.ndarray:
    seen = points[np.isfinite(points).all(axis=1)]
    return seen.mean(axis=0) if len(seen) else np.full(3, np.nan)


def _in_order(
    used: list[RestPose], means: Mapping[int, tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Errors and places of the poses that were not left out, in the order in which they were driven."""
    own = [means[id(pose.setpoints)] for pose in used if id(pose.setpoints) in means]
    errors, places = np.array(own).reshape(-1, 2, 3).swapaxes(0, 1)
    return errors, places


def _usable(model: RestModel) -> tuple[list[RestPose], list[str]]:
    """Poses at which the model rests in the measured shape, and why others are set aside."""
    model.predict(model.at, False)
    apart = model.distances
    typical = np.nanmedian(apart) if np.isfinite(apart).any() else np.nan
    far = apart > max(OTHER_SHAPE * typical, OTHER_SHAPE_SIZE * model.size)
    used, aside = [], []
    for pose, distance, is_far in zip(model.poses, apart, far, strict=True):
        if np.isnan(distance):
            aside.append(f"{pose.origin}: the model does not come to rest there")
        elif is_far:
            aside.append(f"{pose.origin}: the model rests {1e3 * distance:.1f} mm from what was measured, "
                         "in another shape")
        else:
            used.append(pose)
    return used, aside


class Forecast(NamedTuple):
    """What a scene predicts of measurements.

    Attributes:
        off: Predicted less measured, shape (n,).
        reach: By how much a measurement may be off in 95 of 100 cases, shape (n,): by the covariance
            of the numbers, and by the noise of the fit; NaN of kinds that the fit did not have.
        distances: See `RestModel`.
    """

    off: np.ndarray
    reach: np.ndarray
    distances: np.ndarray


def forecast(model: RestModel, joint: Estimate, at: np.ndarray, reach: Reach | None = None) -> Forecast:
    """Predicts what is measured at poses, with 95 % intervals.

    Args:
        model: Of these poses and of the numbers of the estimate; it begins where it rested before.
        joint: The estimate, with the numbers that were not told.
        at: Values of its numbers to predict with, each in its unit, shape (p,).
        reach: How errors grow outside of the poses of the fit; None where they do not.
    """
    found = model.predict(at, True)
    # NaN of kinds that the fit did not have.
    noise = np.array([joint.noise.get(kind, np.nan) for kind in model.measured.kinds])
    if reach is not None and len(model.poses):
        noise *= reach.factors(np.array([pose.setpoints for pose in model.poses]))[model.measured.poses]
        is_seen = np.isin(_sessions(model.poses), reach.sessions)[model.measured.poses]
        noise = np.hypot(noise, reach.further * (np.isin(model.measured.kinds, POINTS) & ~is_seen))
    by_known = found.jacobian * [
        one.known * (value if one.is_relative else 1.0) for one, value in zip(joint.unknowns, at)]
    spread = np.einsum("ki,ij,kj->k", by_known, joint.covariance, by_known)
    return Forecast(found.values - model.measured.values, 1.96 * np.sqrt(spread + noise**2), model.distances)


def validated(model: RestModel, joint: Estimate, after: np.ndarray, reach: Reach | None = None) -> Validation:
    """Compares numbers with those that a scene begins with by what was measured at poses.

    Where a pose has several shapes the robot is in that of the scene before.

    Args:
        model: Of the poses, the scene and the numbers of the estimate.
        joint: See `forecast`.
        after: See `forecast`.
        reach: See `forecast`.
    """
    start = np.array([one.parameter.read(model.begin) for one in joint.unknowns])
    off, distances = model.predict(start, False).values - model.measured.values, model.distances
    told, kinds = forecast(model, joint, after, reach), model.measured.by_kind
    errors = [{kind: float(np.sqrt(np.mean(one[own] ** 2) * (3 if kind in POINTS else 1)))
               for kind, own in kinds.items()} for one in (off, told.off)]  # fmt: skip
    inside = {kind: float(np.mean(np.abs(told.off[own]) <= told.reach[own]))
              for kind, own in kinds.items() if kind in joint.noise}  # fmt: skip
    return Validation(*errors, inside, np.array([distances, told.distances]),
                      tuple(pose.origin for pose in model.poses))  # fmt: skip


# --- what would tell more ------------------------------------------------------------------------


class Suggestion(NamedTuple):
    """Something to measure.

    Attributes:
        words: What to do.
        deviations: Standard deviations of the numbers after it, as in `Estimate`, shape (p,).
        information: By how much the logarithm of the determinant of the information grows.
        poses: The poses.
    """

    words: str
    deviations: np.ndarray
    information: float
    poses: tuple[RestPose, ...]


def suggestions(found: Calibration, count: int = 3) -> tuple[Suggestion, ...]:
    """What would tell most of the numbers, by expected information (D-optimal), the best first.

    Candidates are the poses of the fit again with weights hung on effectors or with measured efforts,
    and new poses, of which as many as `count` are chosen one after the other.

    Args:
        found: A calibration.
        count: Poses of a suggestion of new ones.
    """
    asked, J = _Candidates(found), found.joint.jacobian
    known, base = [one.known for one in found.joint.unknowns], _information(J)
    made = [*asked.again(), asked.new_poses(count)]
    return tuple(sorted(
        (Suggestion(words, deviations_with(J, *blocks) * known, _information(J, *blocks) - base,
                    tuple(poses)) for words, poses, blocks in made if blocks),
        key=lambda one: -one.information))  # fmt: skip


def _information(*jacobians: np.ndarray) -> float:
    """Logarithm of the determinant of the information of measurements, with what is known before."""
    return float(np.linalg.slogdet(np.eye(jacobians[0].shape[1]) + sum(J.T @ J for J in jacobians))[1])


class _Candidates:
    """Poses that may be measured, and what they would tell."""

    def __init__(self, found: Calibration):
        self._found, scene = found, found.scene
        soft = {None, *(body.name for body in scene.deformables)}  # What touches are built for.
        points: tuple[Any, ...] = scene.effectors or scene.markers[-1:]
        points = tuple(one for one in points if one.body in soft)
        self._hung = [getattr(one, "name", f"marker {getattr(one, 'id', '')}") for one in points]
        touches = [{"name": f"weight_{index}_", "body": one.body,
                    "points": getattr(one, "points", None) or [one.point]}
                   for index, one in enumerate(points)]  # fmt: skip
        self._scene = changed_scene(scene, {"touches": [*scene.touches, *touches]})
        self._own = len(scene.touches)
        self._poses = found.poses[:MOST_CANDIDATES]
        self._has_efforts = any(np.isfinite(pose.efforts).any() for pose in found.poses)
        self._down = np.array(scene.gravity) if any(scene.gravity) else np.array([0.0, 0.0, -9.81])

    def again(self) -> Iterator[tuple[str, list[RestPose], list[np.ndarray]]]:
        """The poses of the fit again, with weights and with efforts."""
        for index, name in enumerate(self._hung):
            mass = self._mass(index)
            poses = [self._full(pose, self._has_efforts, index, mass) for pose in self._poses]
            blocks = self._jacobians(poses)
            yield (f"hang {1e3 * mass:.3g} g on {name} at {len(blocks)} recorded poses", poses, blocks)
        follows = RestModel(self._scene, [], []).simulation.actuators
        words = {kind.effort.word for kind in follows.kinds if not kind.is_effort_driven}
        if not self._has_efforts and words:
            poses = [self._full(pose, True) for pose in self._poses]
            blocks = [J[-len(pose.efforts) :] for J, pose in zip(self._jacobians(poses), poses)]
            yield f"measure each {' and '.join(sorted(words))} to {EFFORT_NOISE:.0%}", poses, blocks

    def new_poses(self, count: int) -> tuple[str, list[RestPose], list[np.ndarray]]:
        """New poses within the range of the recorded ones, chosen one after the other."""
        from scipy.stats import qmc  # it loads slowly

        setpoints = np.array([pose.setpoints for pose in self._found.poses])
        low, high = setpoints.min(axis=0), setpoints.max(axis=0)
        drawn = qmc.Sobol(len(low), seed=0).random(NEW_CANDIDATES) * (high - low) + low
        poses = [self._full(self._poses[0]._replace(setpoints=one, forces=0 * self._poses[0].forces),
                            self._has_efforts) for one in drawn]  # fmt: skip
        blocks, J, chosen = self._jacobians(poses), [self._found.joint.jacobian], []
        for _ in range(min(count, len(blocks))):
            left = [i for i in range(len(blocks)) if i not in chosen]
            chosen.append(max(left, key=lambda i: _information(*J, blocks[i])))
            J.append(blocks[chosen[-1]])
        return f"measure {len(chosen)} new poses", [poses[i] for i in chosen], J[1:]

    def _full(
        self, pose: RestPose, with_efforts: bool, hung: int | None = None, mass: float = 0.0
    ) -> RestPose:
        """A pose at which all is measured, perhaps with a weight."""
        forces = np.zeros((self._own + len(self._hung), 3))
        forces[: self._own] = pose.forces
        if hung is not None:
            forces[self._own + hung] = mass * self._down
        efforts = np.full(len(pose.efforts), 0.0 if with_efforts else np.nan)
        return RestPose(pose.setpoints, 0.0 * np.nan_to_num(pose.markers), pose.effectors, efforts,
                        forces, pose.origin)  # fmt: skip

    def _mass(self, index: int) -> float:
        """A weight that moves a point by some percent of the robot's size at most [kg]."""
        poses = [self._full(self._poses[0], False, index, mass) for mass in (0.0, LIGHT)]
        points = RestModel(self._scene, [], poses)
        apart = np.diff(points.predict(np.empty(0), False).values.reshape(2, -1), axis=0)
        moved = float(np.abs(apart).max(initial=0.0)) or 1.0
        most = min(HEAVY, LIGHT * HUNG_SHARE * points.size / moved)
        return max(one for one in WEIGHTS if one <= most or one == WEIGHTS[0])

    def _jacobians(self, poses: list[RestPose]) -> list[np.ndarray]:
        """Derivatives of what is measured over its noise, by z, of poses that the model reaches."""
        found = self._found.joint
        model = RestModel(self._scene, [one.parameter for one in found.unknowns], poses)
        slopes = [one.slope(z) for one, z in zip(found.unknowns, found.z, strict=True)]
        got = model.predict(found.values, True)
        noise = np.empty(len(got.values))
        for kind, own in model.measured.by_kind.items():
            largest = np.nanmax(np.abs(got.values[own]), initial=0.0) or 1.0
            noise[own] = found.noise.get(kind, EFFORT_NOISE * largest)
        J = got.jacobian * slopes / noise[:, None]
        return [J[model.measured.poses == k] for k in range(len(poses)) if k not in model.lost]
