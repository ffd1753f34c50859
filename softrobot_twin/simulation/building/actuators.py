"""The actuators of a scene, of all kinds, in one order for all arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from softrobot_twin.constraints.constraint_term import rows_that_move_nothing
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    actuator_kinds,
    register_actuator,
)
from softrobot_twin.simulation.building.cable_actuator import CableActuator
from softrobot_twin.simulation.building.cavity_actuator import CavityActuator
from softrobot_twin.simulation.building.force_actuator import ForceActuator
from softrobot_twin.simulation.building.hinge_motor_actuator import HingeMotorActuator
from softrobot_twin.simulation.building.limits import ActuatorLimits, Pulleys
from softrobot_twin.simulation.building.muscle_actuator import MuscleActuator
from softrobot_twin.simulation.building.rest_shape_actuator import RestShapeActuator
from softrobot_twin.simulation.building.scene_layout import Layout
from softrobot_twin.simulation.building.slide_actuator import SlideActuator
from softrobot_twin.simulation.building.stiffener_actuator import StiffenerActuator

register_actuator(CableActuator())
register_actuator(CavityActuator())
register_actuator(SlideActuator())
register_actuator(HingeMotorActuator())
register_actuator(ForceActuator())
register_actuator(MuscleActuator())
register_actuator(RestShapeActuator())
register_actuator(StiffenerActuator())


class Actuators:
    """The actuators of a scene. Those with rows come first, those that prescribe moves last.

    Attributes:
        groups: The actuators of each kind.
        kinds: Kind of each actuator, shape (count,).
        names: Their names, shape (count,).
        row_count: Number of actuators with a row of H, which come first.
        is_moved: Whether the unknown of each is its displacement and not its effort, shape (count,).
        moves: Object that prescribes the displacements of the others, or None without any.
        rest_setpoints: Setpoints at rest, each in the unit of its kind, shape (count,).
        effort_gains: Effort by what is told of it, less its zero, shape (count,).
        limits: Their limits.
        takes_efforts: Whether each can be commanded by an effort, shape (count,).
        one_sided: Whether the effort of each has one sign only, shape (count,).
        is_effort_driven: Whether the setpoint of each is an effort, shape (count,).
        stalls: Whether each is where the bodies are at a limit of its effort, shape (count,).
        pulleys: Pulleys that wind cables.
    """

    def __init__(self, groups: Sequence[ActuatorGroup], work: float, scene: Scene | None = None):
        """Put the groups one after the other.

        Args:
            groups: The actuators of each kind that the scene names.
            work: Work that strains the bodies of the scene by one [J]: the scale of efforts.
            scene: The scene, whose cables may be wound by pulleys; None without pulleys.

        Raises:
            ValueError: Two kinds prescribe moves.
        """
        self.groups = tuple(sorted(groups, key=lambda group: not group.term))
        prescribing = [group.moves for group in self.groups if group.moves]
        if len(prescribing) > 1:
            raise ValueError("only one kind of actuator may prescribe moves without multipliers")
        self.moves = prescribing[0] if prescribing else None
        self.kinds: tuple[ActuatorKind, ...] = tuple(k for g in self.groups for k in g.kinds)
        self.names = tuple(name for group in self.groups for name in group.names)
        self.row_count = sum(len(g.names) for g in self.groups if g.term)
        self.is_moved = np.arange(len(self.names)) >= self.row_count
        self.rest_setpoints = self._joined("rest_setpoints")
        self.rest_setpoints.setflags(write=False)
        self.is_effort_driven = np.array([kind.is_effort_driven for kind in self.kinds], bool)
        self._rest_extents = self._joined("rest_extents")
        self._force_per_effort = self._joined("force_per_effort")
        scale = self._joined("displacement_scale")
        displacements, efforts = self._joined("displacement_bounds"), self._joined("effort_bounds")
        self._signs = np.array([kind.sign for kind in self.kinds], float)
        self._effort_zeros, self.effort_gains = self._joined("effort_zeros"), self._joined("effort_gains")
        self._tells_efforts = bool((self.effort_gains == 1.0).all() and not self._effort_zeros.any())
        # What a setpoint holds changes by so much with the setpoint.
        self._gains = np.where(self.is_effort_driven, self.effort_gains, self._signs)
        self._slopes, self._scaled_rest = 1.0 / self._gains, self._gains * self.rest_setpoints
        # Contiguous: kernels are compiled again for arrays with strides.
        least, greatest = displacements.T.copy()
        effort_min, effort_max = efforts.T.copy()
        self.limits = ActuatorLimits(
            self.names, least, greatest, self._joined("rates"), effort_min, effort_max, scale,
            _effort_scale(efforts, work / scale), self._slopes,
            self.is_effort_driven,
            tuple(names for group in self.groups for names in group.limit_names),
            tuple(kind.effort.word for kind in self.kinds),
            np.where(self.is_effort_driven, self._joined("flows"), np.inf),
        )  # fmt: skip
        self.takes_efforts = np.array([kind.takes_efforts for kind in self.kinds], bool)
        self.one_sided = np.array([kind.one_sided for kind in self.kinds], bool)
        self.stalls = np.array([kind.stalls for kind in self.kinds], bool)
        self.pulleys = Pulleys(scene, self.names, self._rest_extents)

    def _joined(self, field: str) -> np.ndarray:
        width = (0, 2) if field.endswith("bounds") else (0,)
        parts = [np.asarray(getattr(group, field), float) for group in self.groups]
        return np.concatenate([np.empty(width), *parts])

    @property
    def conserves(self) -> bool:
        """Whether equilibria at held displacements are minima of an energy."""
        return all(term.conserves for term in self.terms)

    @property
    def losses(self) -> str:
        """What conserves no energy, in words; empty where all do."""
        return " and ".join(term.loss for term in self.terms if not term.conserves)

    def stalled(self, efforts: np.ndarray) -> np.ndarray:
        """Whether each of the first actuators stalls, shape (n,).

        Args:
            efforts: λ of the first n actuators, in the unit of their kinds, shape (n,).
        """
        own, limits = slice(0, len(efforts)), self.limits
        at_limit = (efforts <= limits.effort_min[own]) | (efforts >= limits.effort_max[own])
        return self.stalls[own] & at_limit

    @property
    def count(self) -> int:
        """Number of actuators."""
        return len(self.names)

    @property
    def kind_of(self) -> dict[str, ActuatorKind]:
        """Kind of each actuator, by name, in their order."""
        return dict(zip(self.names, self.kinds, strict=True))

    def driven_quantities(self, is_by_effort: np.ndarray) -> tuple[Quantity, ...]:
        """What drives each actuator: its displacement or its effort, such as a pressure.

        Args:
            is_by_effort: Whether each is driven by its effort, shape (count,).
        """
        return tuple(
            kind.effort if by_effort else kind.displacement
            for kind, by_effort in zip(self.kinds, is_by_effort, strict=True)
        )

    @property
    def terms(self) -> tuple:
        """Constraint terms of those with rows, in the order of the rows."""
        return tuple(group.term for group in self.groups if group.term)

    @property
    def held_forces(self) -> tuple:
        """Force terms of actuators whose forces are not linear in their efforts."""
        terms = (getattr(term, "held_forces", None) for term in self.terms)
        return tuple(term for term in terms if term is not None)

    @property
    def displacement_scale(self) -> np.ndarray:
        """A large displacement of each, in its unit, shape (count,)."""
        return self.limits.displacement_scale

    @property
    def effort_scale(self) -> np.ndarray:
        """A large effort of each, in its unit, shape (count,)."""
        return self.limits.effort_scale

    def of_section(self, section: str) -> slice:
        """Places of the actuators of a kind.

        Args:
            section: Key of the kind in a scene, such as ``cables``.
        """
        first = 0
        for group in self.groups:
            if group.kind.section == section:
                return slice(first, first + len(group.names))
            first += len(group.names)
        return slice(first, first)

    def drives(self, setpoints: np.ndarray) -> np.ndarray:
        """What setpoints hold: a displacement from rest, or an effort of what is effort-driven.

        Args:
            setpoints: Each in the unit of its kind, shape (count,).

        Returns:
            Displacements δ, each in the direction in which the effort does work, or efforts λ,
            shape (count,).
        """
        return self._gains * setpoints - self._scaled_rest

    def displacements(self, setpoints: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Displacements from rest: as they are set, of what is effort-driven as they are.

        Args:
            setpoints: Each in the unit of its kind, shape (count,).
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            δ, shape (count,).
        """
        if not self.limits.has_effort_driven:
            return self.drives(setpoints)
        reached = [term.rows_at(positions)[1] for term in self.terms]
        return self.displacements_at(setpoints, np.concatenate([np.empty(0), *reached]))

    def displacements_at(self, setpoints: np.ndarray, reached: np.ndarray) -> np.ndarray:
        """The same, with the displacements of all rows known.

        Args:
            setpoints: Each in the unit of its kind, shape (count,).
            reached: δ of the actuators with rows, shape (row_count,).
        """
        if self.limits.are_all_effort_driven and self.row_count == self.count:
            return reached.copy()
        displacements = self.drives(setpoints)
        if self.limits.has_effort_driven:
            np.copyto(displacements[: self.row_count], reached, where=self.is_effort_driven[: self.row_count])
        return displacements

    def setpoints(self, drives: np.ndarray) -> np.ndarray:
        """Setpoints that hold displacements or efforts; see `drives`."""
        return self.rest_setpoints + self._slopes * drives

    def told_efforts(self, efforts: np.ndarray) -> np.ndarray:
        """Efforts as commands and measurements tell them, with the zeros and gains of their sensors.

        Args:
            efforts: λ, each in the unit of its kind, shape (..., count).
        """
        return efforts if self._tells_efforts else self._effort_zeros + efforts / self.effort_gains

    def efforts(self, told: np.ndarray) -> np.ndarray:
        """Efforts λ of which commands or measurements tell; see `told_efforts`."""
        return told if self._tells_efforts else self.effort_gains * (told - self._effort_zeros)

    def extents(self, displacements: np.ndarray) -> np.ndarray:
        """Lengths of cables, volumes of cavities: values at rest, changed by displacements.

        Args:
            displacements: From rest, each in the unit of its kind, shape (count,).

        Returns:
            Each in the unit of its displacement, shape (count,).
        """
        return self._rest_extents + self._signs * displacements

    def load(self, efforts: np.ndarray) -> float:
        """Sum of the forces on the bodies [N], by magnitude.

        Args:
            efforts: λ of each actuator, in the unit of its kind, shape (count,).
        """
        return float((self._force_per_effort * np.abs(efforts)).sum())

    def paths(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Lines by which actuators are drawn, by their names; those without a line are omitted.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Points [m], each of shape (point_count, 3).
        """
        return {
            name: path
            for group in self.groups
            for name, path in zip(group.names, group.kind.paths(group, positions))
        }

    def path_lengths(self, positions: np.ndarray) -> dict[str, float]:
        """Lengths of the paths of what only pulls, by names [m].

        The path of a slack cable is shorter than the length that its winch is set to.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return {
            name: float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
            for group in self.groups if group.kind.one_sided
            for name, path in zip(group.names, group.kind.paths(group, positions), strict=True)
        }  # fmt: skip

    def doubts(self, model) -> Iterator[str]:
        """Warnings of unlikely values; see `ActuatorKind.doubts`."""
        for group in self.groups:
            yield from group.kind.doubts(model, group)


def _effort_scale(bounds: np.ndarray, straining: np.ndarray) -> np.ndarray:
    """The greatest effort within limits, or that which strains the bodies by one if it is less."""
    allowed = np.abs(np.where(np.isfinite(bounds), bounds, 0.0)).max(axis=1, initial=0.0)
    return np.where(allowed > 0.0, np.minimum(allowed, straining), straining)


def build_actuators(layout: Layout, notes: list[str]) -> Actuators:
    """The actuators that a scene names.

    Args:
        layout: The bodies.
        notes: List to which warnings are appended.

    Raises:
        SceneError: An entry does not fit the bodies.
    """
    return Actuators(build_groups(layout, notes), _straining_work(layout), layout.scene)


def build_groups(layout: Layout, notes: list[str]) -> list[ActuatorGroup]:
    """The actuators of each kind that a scene names; see `build_actuators`."""
    entries = layout.scene.actuator_entries
    kinds = [kind for kind in actuator_kinds() if entries[kind.section]]
    groups = [kind.build(layout, entries[kind.section], notes) for kind in kinds]
    for kind, group in zip(kinds, groups, strict=True):
        if kind.acts_at_rest and group.term:
            for index in rows_that_move_nothing(group.term, layout.nodes):
                owner = (group.entries or entries[kind.section])[index]
                key = next(key for key, entry in layout.scene.keyed(kind.section) if entry is owner)
                raise layout.scene.error(key, group.names[index], "lies wholly in what is fixed: it moves nothing")
    return groups



def _straining_work(layout: Layout) -> float:
    """Work that strains all bodies and springs by one, and lifts them by their size [J]."""
    scene, size = layout.scene, layout.nodes.size
    size = size if np.isfinite(size) else 0.0
    work = sum(part.young_modulus * part.volume for body in layout.bodies for part in body.materials)
    work += sum(spring.stiffness for spring in (*scene.springs, *scene.mass_springs)) * size**2
    work += sum(tube.axial_stiffness for tube in scene.tubes) * size
    work += sum(fibre.stiffness for fibre in scene.fibres) * size
    work += sum(
        beam.entry.material.young_modulus * beam.section.area * float(beam.lengths.sum())
        for beam in layout.beams
    )
    mass = sum(part.mass for part in (*layout.bodies, *layout.rigid, *layout.beams))
    work += mass * float(np.linalg.norm(scene.gravity)) * size
    # Without stiffness and weight there is no scale of efforts.
    return work or 1.0
