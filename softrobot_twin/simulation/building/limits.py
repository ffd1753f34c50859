"""Limits of the actuators, the bounds of one step, and the names of active limits.

Pulleys that wind cables have angles [rad] beside the lengths [m] that the simulation uses. At rest the angle θ is 0. A pulley of radius r that winds its cable up by turning in the sense s = ±1
has the angle θ = s (L_rest - L) / r when L of the cable is unwound, and holds it by the torque
s r λ [N m]. The pulley of a motor winds all its cables, each by the same length; its angle is that of
its first cable, as a motor's length is.

Limits that are out of scale are warned of: a wrong unit is a factor of a thousand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.scene import Scene
from softrobot_twin.scene.actuator_entries import Pulley
from softrobot_twin.simulation.building.actuator_kinds import Quantity
from softrobot_twin.solvers.inverse_problem import Bounds

ANGLE = Quantity("angle", "rad")
TORQUE = Quantity("torque", "Nm")
# A displacement this near to its limit, as a share of the actuator's scale, is at the limit.
DISPLACEMENT_MARGIN = 1.0e-6
# An effort this near to its limit, as a share of the limit, is at the limit.
EFFORT_MARGIN = 1.0e-4
# Nearer to it than this share of the actuator's scale, an effort does not hold a displacement.
HOLDING_MARGIN = 1.0e-9


def pulley_of_cable(scene: Scene) -> dict[str, Pulley]:
    """Pulley that winds each cable, by the cable's name; its own or that of its motor.

    Args:
        scene: The scene.
    """
    pulleys = {cable.name: cable.pulley for cable in scene.cables if cable.pulley}
    for motor in scene.motors:
        if motor.pulley:
            pulleys.update(dict.fromkeys(motor.cables, motor.pulley))
    return pulleys


def shortenings_of_angles(pulley: Pulley) -> np.ndarray:
    """Shortenings at the least and the greatest angle, in ascending order [m], shape (2,).

    Args:
        pulley: The pulley, with its radius and limits of its angle.
    """
    return np.sort(np.array(pulley.angle) * pulley.wound)


class Pulleys:
    """The pulleys of a scene.

    Attributes:
        names: Their names: those of cables, then those of motors.
        driven: Indices among the actuators of the cables that each winds.
        is_wound: Whether each actuator is wound by a pulley, shape (actuator_count,).
        wound: Length that one radian winds up, negative where that takes a negative angle [m/rad],
            shape (count,).
    """

    def __init__(self, scene: Scene | None, actuator_names: Sequence[str], zeros: np.ndarray):
        """Find what each pulley winds.

        Args:
            scene: The scene; None for no pulleys.
            actuator_names: Names of its actuators.
            zeros: Their setpoints where the angle is 0, of cables lengths [m], shape
                (actuator_count,).
        """
        places = {name: index for index, name in enumerate(actuator_names)}
        cables, motors = (scene.cables, scene.motors) if scene else ((), ())
        own = [(cable.name, cable.pulley, (cable.name,)) for cable in cables]
        own += [(motor.name, motor.pulley, motor.cables) for motor in motors]
        own = [one for one in own if one[1]]
        self.names = tuple(name for name, _, _ in own)
        self.driven = tuple(np.array([places[cable] for cable in cables]) for _, _, cables in own)
        self.is_wound = np.zeros(len(places), bool)
        for driven in self.driven:
            self.is_wound[driven] = True
        self.wound = np.array([pulley.wound for _, pulley, _ in own])
        self._first = np.array([driven[0] for driven in self.driven], np.int64)
        self._rest = np.array(zeros, float)

    @property
    def count(self) -> int:
        """Number of pulleys."""
        return len(self.names)

    def angles(self, setpoints: np.ndarray) -> np.ndarray:
        """Angle of each pulley [rad], shape (count,).

        Args:
            setpoints: Of all actuators, of cables lengths [m], shape (actuator_count,).
        """
        return (self._rest - setpoints)[self._first] / self.wound

    def torques(self, efforts: np.ndarray) -> np.ndarray:
        """Torque with which each pulley holds its cables, about its axis [N m], shape (count,).

        Args:
            efforts: Of all actuators, of cables tensions [N], shape (actuator_count,).
        """
        loads = np.array([efforts[driven].sum() for driven in self.driven])
        return loads * self.wound

    def lengths(self, pulley: int, angle: float) -> np.ndarray:
        """Length of each cable that a pulley winds, at an angle [m], shape (driven_count,).

        Args:
            pulley: Index of the pulley.
            angle: Its angle [rad].
        """
        return self._rest[self.driven[pulley]] - self.wound[pulley] * angle

    def tensions(self, pulley: int, torque: float) -> np.ndarray:
        """Tension of each cable, if all share the torque of their pulley alike [N].

        Args:
            pulley: Index of the pulley.
            torque: Torque about its axis [N m].

        Returns:
            Shape (driven_count,).
        """
        count = len(self.driven[pulley])
        return np.full(count, torque / self.wound[pulley] / count)


def unlikely(
    key: str, value: float, unit: str, whole: float, usual: tuple[float, float], hint: str
) -> Iterator[str]:
    """Warn of a limit that is far from its natural scale.

    Args:
        key: Key of the limit.
        value: The limit, in its unit. Zero and infinity are limits in any unit.
        unit: Its unit.
        whole: The natural scale, in the same unit.
        usual: Least and greatest usual share of the scale.
        hint: What the scale is, and a question about the unit.

    Yields:
        A sentence, if the limit is unlikely.
    """
    if value == 0.0 or not np.isfinite(value) or usual[0] * whole <= value <= usual[1] * whole:
        return
    size = "large" if value > whole else "small"
    yield f"{key} = {value:g} {unit} is very {size}: {hint}"


def efforts_at_scale(model, term) -> np.ndarray | None:
    """Effort that would displace each actuator by its natural scale, by the stiffness at rest.

    Args:
        model: The built scene; its factorization is left undefined.
        term: Constraint term of the actuators.

    Returns:
        Efforts in the unit of their kind, shape (row_count,); None where bodies are not held, or
        move with rigid ones.
    """
    nodes, factorization = model.nodes, model.factorization
    if model.is_dynamic or model.nodes.carried:
        return None
    forces = np.zeros((nodes.free_node_count, 3))
    factorization.clear()
    for force in model.forces:
        force.add(nodes.rest_positions, forces, factorization.storage, True)
    if not all(body.is_held for body in model.bodies) or not factorization.factor():
        return None
    blocks, _ = term.rows_at(nodes.rest_positions)
    efforts = np.empty(term.row_count)
    for index in range(term.row_count):
        own = term.entry_rows == index
        load = np.zeros_like(forces)
        np.add.at(load, term.entry_nodes[own], blocks[own])
        efforts[index] = term.scales[index] / float(np.sum(load * factorization.solve(load)))
    return efforts


@njit(**KERNEL)
def write_bounds(drives, rate, time_step, is_effort_driven, limits, bounds):
    """Bounds within a reach of what setpoints hold now; those outside are led back at their rate.

    Args:
        drives: Displacements, efforts of what is effort-driven, shape (actuator_count,).
        rate: Greatest change of each in a second, infinite without a limit, same shape.
        time_step: Duration of the step [s].
        is_effort_driven: Whether each is effort-driven, same shape.
        limits: Least and greatest displacements, least and greatest efforts,
            shape (4, actuator_count).
        bounds: Takes the same of this step, same shape.
    """
    for i in range(len(drives)):
        # Without a rate limit, the product with a time of 0 would be NaN.
        reach = rate[i] * time_step if time_step > 0.0 else 0.0
        least, most = drives[i] - reach, drives[i] + reach
        first = 2 if is_effort_driven[i] else 0
        for k in range(4):
            bounds[k, i] = limits[k, i]
        bounds[first, i] = min(max(limits[first, i], least), most)
        bounds[first + 1, i] = max(min(limits[first + 1, i], most), least)


@njit(**KERNEL)
def find_limits(displacements, efforts, lower, upper, margins, least_efforts, most_efforts, found):
    """Write which limits bind each actuator, see `ActuatorLimits.binding`; whether any does.

    Args:
        displacements: Displacements, shape (actuator_count,), as all but `found`.
        efforts: Efforts.
        lower: Least displacements of the step.
        upper: Greatest ones.
        margins: Distance from these that counts as zero.
        least_efforts: Efforts up to which the least one counts as reached.
        most_efforts: Efforts from which on the greatest one counts as reached.
        found: -1 at the least, 1 at the greatest, else 0, of the displacement and of the effort;
            written, shape (actuator_count, 2).
    """
    any_binds = False
    for i in range(len(displacements)):
        found[i, 0] = found[i, 1] = 0
        if displacements[i] >= upper[i] - margins[i]:
            found[i, 0] = 1
        elif displacements[i] <= lower[i] + margins[i]:
            found[i, 0] = -1
        if efforts[i] >= most_efforts[i]:
            found[i, 1] = 1
        elif efforts[i] <= least_efforts[i]:
            found[i, 1] = -1
        any_binds = any_binds or found[i, 0] != 0 or found[i, 1] != 0
    return any_binds


@dataclass(frozen=True)
class ActuatorLimits:
    """Limits of the actuators; each array in the units of their kinds, shape (actuator_count,).

    Attributes:
        names: Names of the actuators.
        displacement_min: Least displacement from rest, of a cable its shortening [m].
        displacement_max: Greatest displacement from rest.
        rate: Greatest change of the setpoint in a second [m/s]; infinite without a limit.
        effort_min: Least effort, of a cable its tension [N].
        effort_max: Greatest effort.
        displacement_scale: A large displacement, of a cable its length at rest [m]; tolerances are
            shares of it.
        effort_scale: A large effort; tolerances are shares of it.
        slopes: Change of the setpoint with what it holds: -1 for cables, 1 for others; for
            regulators 1 by their gain.
        is_effort_driven: Whether the setpoint is an effort.
        limit_names: Names of the least and the greatest displacement, such as ``shortening_min``
            and ``angle_max``, shape (actuator_count, 2).
        effort_words: Name of the effort in names of limits.
        flow: Greatest change in a second of the displacement of what is effort-driven; None:
            no limits.
    """

    names: tuple[str, ...]
    displacement_min: np.ndarray
    displacement_max: np.ndarray
    rate: np.ndarray
    effort_min: np.ndarray
    effort_max: np.ndarray
    displacement_scale: np.ndarray
    effort_scale: np.ndarray
    slopes: np.ndarray
    is_effort_driven: np.ndarray
    limit_names: tuple[tuple[str, str], ...]
    effort_words: tuple[str, ...]
    flow: np.ndarray | None = None

    @cached_property
    def has_effort_driven(self) -> bool:
        """Whether the setpoint of an actuator is an effort."""
        return bool(self.is_effort_driven.any())

    @cached_property
    def are_all_effort_driven(self) -> bool:
        """Whether the setpoint of each actuator is an effort."""
        return bool(self.is_effort_driven.all())

    @cached_property
    def drive_min(self) -> np.ndarray:
        """Least displacement, or least effort of what is effort-driven, shape (actuator_count,)."""
        return np.where(self.is_effort_driven, self.effort_min, self.displacement_min)

    @cached_property
    def drive_max(self) -> np.ndarray:
        """Greatest displacement, or greatest effort of what is effort-driven, same shape."""
        return np.where(self.is_effort_driven, self.effort_max, self.displacement_max)

    @cached_property
    def drive_scale(self) -> np.ndarray:
        """A large displacement, or a large effort of what is effort-driven, same shape."""
        return np.where(self.is_effort_driven, self.effort_scale, self.displacement_scale)

    @cached_property
    def drive_rate(self) -> np.ndarray:
        """Greatest change of what the setpoint holds in a second, same shape."""
        return self.rate / np.abs(self.slopes)

    def travel(self, otherwise: np.ndarray | float) -> np.ndarray:
        """Range of each setpoint, another one where it has none, same shape.

        Args:
            otherwise: Range of what the setpoint of each actuator without one holds, in its unit,
                shape (actuator_count,) or one for all.
        """
        travel = self.drive_max - self.drive_min
        travel = np.where(np.isfinite(travel) & (travel > 0.0), travel, otherwise)
        return np.abs(self.slopes) * travel

    @cached_property
    def drive_names(self) -> tuple[tuple[str, str], ...]:
        """Names of the least and the greatest of what the setpoint of each holds, same shape."""
        names = zip(self.is_effort_driven, self.effort_names, self.limit_names, strict=True)
        return tuple(effort if by_effort else moved for by_effort, effort, moved in names)

    @cached_property
    def effort_names(self) -> tuple[tuple[str, str], ...]:
        """Names of the least and the greatest effort of each, shape (actuator_count, 2)."""
        return tuple((f"{word}_min", f"{word}_max") for word in self.effort_words)

    @cached_property
    def _all(self) -> np.ndarray:
        """Limits of displacements, then of efforts, shape (4, actuator_count)."""
        return np.array(
            [self.displacement_min, self.displacement_max, self.effort_min, self.effort_max]
        )

    @cached_property
    def _margins(self) -> np.ndarray:
        return DISPLACEMENT_MARGIN * self.displacement_scale

    @cached_property
    def _most_efforts(self) -> np.ndarray:
        """Efforts from which on the greatest one counts as reached, shape (actuator_count,)."""
        return self.effort_max * (1.0 - EFFORT_MARGIN)

    @cached_property
    def _least_efforts(self) -> np.ndarray:
        """Efforts up to which the least one counts as reached, shape (actuator_count,).

        At an effort of 0 a cable hangs slack; that limit is its nature and not told.
        """
        least = self.effort_min * (1.0 - EFFORT_MARGIN)
        return np.where(self.effort_min < 0.0, least, -np.inf)

    def can_hold(self, efforts: np.ndarray) -> np.ndarray:
        """Whether efforts are between their limits, where they hold a displacement, shape (n,).

        A slack cable holds nothing, nor does a motor that stalls.

        Args:
            efforts: λ of the first n actuators, shape (n,).
        """
        a = slice(0, len(efforts))
        margin = HOLDING_MARGIN * self.effort_scale[a]
        return (efforts > self.effort_min[a] + margin) & (efforts < self.effort_max[a] - margin)

    def setpoint_range(self, rest_setpoints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest setpoints, each of shape (actuator_count,).

        Args:
            rest_setpoints: Setpoints at rest, shape (actuator_count,).
        """
        ends = (rest_setpoints + self.slopes * self.drive_min,
                rest_setpoints + self.slopes * self.drive_max)  # fmt: skip
        return np.minimum(*ends), np.maximum(*ends)

    def reach(self, time_step: float) -> np.ndarray:
        """Greatest move of each setpoint in a time, shape (actuator_count,).

        Args:
            time_step: The time [s].
        """
        # Without a rate limit, the product with a time of 0 would be NaN.
        return self.rate * time_step if time_step > 0.0 else np.zeros_like(self.rate)

    def bounds(self, drives: np.ndarray, time_step: float) -> Bounds:
        """Bounds of one time step.

        Args:
            drives: Displacements at its beginning, efforts of what is effort-driven,
                shape (actuator_count,).
            time_step: Its length [s].

        Returns:
            Bounds on displacements and efforts. For an actuator outside its limits they lead back
            at its rate.
        """
        bounds = np.empty((4, len(self.rate)))
        write_bounds(drives, self.drive_rate, time_step, self.is_effort_driven, self._all, bounds)
        return Bounds(*bounds)

    @cached_property
    def has_flow(self) -> bool:
        """Whether the change of a displacement is limited beside that of the setpoint."""
        return self.flow is not None and bool(np.isfinite(self.flow).any())

    def with_flow(self, bounds: Bounds, displacements: np.ndarray, time_step: float) -> Bounds:
        """Bounds of one time step in which displacements change no faster than their flow.

        Args:
            bounds: Bounds without that.
            displacements: Displacements at the beginning of the step, shape (actuator_count,).
            time_step: Its length [s].
        """
        reach = np.where(np.isfinite(self.flow), self.flow * time_step, np.inf)
        return bounds._replace(
            displacement_min=np.maximum(bounds.displacement_min, displacements - reach),
            displacement_max=np.minimum(bounds.displacement_max, displacements + reach),
        )

    def drives_within(self, drives: np.ndarray, bounds: Bounds) -> np.ndarray:
        """The nearest displacements, or efforts of what is effort-driven, that bounds allow.

        Args:
            drives: Displacements or efforts, NaN remains, shape (actuator_count,).
            bounds: The bounds.
        """
        least, most = self.drive_bounds(bounds)
        return np.minimum(np.maximum(drives, least), most)

    def drive_bounds(self, bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on what the setpoints hold: displacements, or efforts of what is effort-driven.

        Args:
            bounds: Bounds of a step.
        """
        by_effort = self.is_effort_driven
        if self.are_all_effort_driven:
            return bounds.effort_min, bounds.effort_max
        if not self.has_effort_driven:
            return bounds.displacement_min, bounds.displacement_max
        return (np.where(by_effort, bounds.effort_min, bounds.displacement_min),
                np.where(by_effort, bounds.effort_max, bounds.displacement_max))  # fmt: skip

    def binding(
        self, displacements: np.ndarray, efforts: np.ndarray, bounds: Bounds,
        is_slack: Callable[[], np.ndarray] | None = None,
    ) -> list[str]:  # fmt: skip
        """Names of the active limits.

        Args:
            displacements: Displacements, shape (actuator_count,).
            efforts: Efforts, shape (actuator_count,).
            bounds: Bounds of this step.
            is_slack: Tells which displacements hold nothing back, shape (actuator_count,); asked where a
                limit is active.

        Returns:
            Such as ``north.shortening_max``, ``east.rate``; empty if none is active.
        """
        found = np.empty((len(self.names), 2), np.int64)
        if not find_limits(
            displacements, efforts, bounds.displacement_min, bounds.displacement_max, self._margins,
            self._low_efforts(bounds), self._high_efforts(bounds), found,
        ):  # fmt: skip
            return []
        if is_slack and found[:, 0].any():
            found[is_slack(), 0] = 0
        return [f"{self.names[i]}.{self._word(i, k, side > 0, bounds)}"
                for i, sides in enumerate(found.tolist()) for k, side in enumerate(sides) if side]

    def _word(self, i: int, k: int, is_high: bool, bounds: Bounds) -> str:
        """The name of an active limit of an actuator's displacement (k = 0) or effort (k = 1)."""
        if k == 0:
            words, margin = self.limit_names[i], self._margins[i]
            is_own = (bounds.displacement_max[i] >= self.displacement_max[i] - margin if is_high
                      else bounds.displacement_min[i] <= self.displacement_min[i] + margin)
        else:
            words, is_own = self.effort_names[i], not self.is_effort_driven[i] or (
                bounds.effort_max[i] >= self._most_efforts[i] if is_high
                else bounds.effort_min[i] <= self.effort_min[i])
        return words[is_high] if is_own else "rate"

    def _high_efforts(self, bounds: Bounds) -> np.ndarray:
        """Efforts from which on the greatest one of this step counts as reached."""
        own = self._most_efforts
        return np.minimum(own, bounds.effort_max) if self.has_effort_driven else own

    def _low_efforts(self, bounds: Bounds) -> np.ndarray:
        """Efforts up to which the least one of this step counts as reached."""
        if not self.has_effort_driven:
            return self._least_efforts
        if self.are_all_effort_driven:
            return bounds.effort_min
        return np.where(self.is_effort_driven, bounds.effort_min, self._least_efforts)
