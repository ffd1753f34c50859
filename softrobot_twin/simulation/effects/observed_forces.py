"""Forces that nobody modelled: an observer finds them, and the model bears them.

A force comes in from an observer of markers and sensors before a step; see `control/force_observer.py`. The step
takes it for given, so that the model stays where the robot is, and targets are reached under it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from softrobot_twin.constraints.effector import EffectorPoints, Effectors
from softrobot_twin.constraints.point_forces import cross_matrices
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.observed_loads import ObservedLoads, ObservedPlace
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import fitting
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.step_part import StepPart


class ObservedForces(NamedTuple):
    """What an observer found, for a step.

    Attributes:
        wrenches: Force on the robot [N] and torque about the place [N m], zero where there is
            none, shape (place_count, 6).
        deviations: Their standard deviations, same shape.
        points: The point at which each acts, among those of its place, shape (place_count,).
        is_detected: Whether each is larger than noise makes it, same shape.
    """

    wrenches: np.ndarray
    deviations: np.ndarray
    points: np.ndarray
    is_detected: np.ndarray

    @classmethod
    def none(cls, count: int) -> ObservedForces:
        """Nothing at so many places.

        Args:
            count: Number of places.
        """
        return cls(*np.zeros((2, count, 6)), np.zeros(count, np.int64), np.zeros(count, bool))

    @property
    def is_any(self) -> bool:
        """Whether there is any force."""
        return bool(self.wrenches.any())


class ObservedRows:
    """Rows of quantities that are measured, and of observed places along all axes.

    A quantity has three coordinates in metres: those of a marker; the value of a sensor, as it counts in
    metres, and two zeros; those of an effector that no marker shows, which nothing measures.

    Attributes:
        places: The places.
        marker_count: Number of markers, which come first of all quantities.
        sensor_count: Number of sensors, which come next.
        unseen: Indices of the effectors that no marker shows, which come last.
        quantity_count: Number of all of them.
        row_count: Number of their rows, which come first.
        stack: The rows.
    """

    def __init__(self, model: Model, places: tuple[ObservedPlace, ...], with_quantities: bool):
        """Lay the rows out, of found places at their first point.

        Args:
            model: The model of a simulation.
            places: The places.
            with_quantities: Whether there are rows of the quantities too.
        """
        self.places, self._nodes = places, model.nodes
        self._sensors = model.sensors if with_quantities else None
        self.sensor_count = self._sensors.row_count if self._sensors else 0
        self.marker_count = model.markers.point_count if with_quantities else 0
        self.unseen = [e for e, own in enumerate(model.effector_markers) if with_quantities and not len(own)]
        self._own = [_point(model.markers, i) for i in range(self.marker_count)]
        self._own += [model.effectors.effectors[e].points for e in self.unseen]
        self.quantity_count = self.sensor_count + len(self._own)
        self.row_count = self.sensor_count + 3 * len(self._own)
        # Where the coordinates are whose rows there are, those of sensors first.
        first, last = 3 * self.marker_count, 3 * (self.marker_count + self.sensor_count)
        self._coordinates = np.r_[first:last:3, 0:first, last : 3 * self.quantity_count]
        self._has_wrench = any(place.is_wrench for place in places)
        self._identity = np.eye(3 * len(places))
        self._chosen: tuple[int, ...] | None = None
        self.choose(np.zeros(len(places), np.int64))

    def choose(self, points: np.ndarray) -> bool:
        """Have found places at other points.

        Args:
            points: Index of the point of each place, shape (place_count,).

        Returns:
            Whether any changed.
        """
        chosen = tuple(int(one) for one in points)
        if chosen == self._chosen:
            return False
        mappings = list(self._own)
        for place, point in zip(self.places, chosen, strict=True):
            if place.is_wrench:
                mappings += [_point(place.points, i) for i in range(4)]
            else:
                mappings.append(_point(place.points, point) if place.is_found else place.points)
        effectors = tuple(EffectorPoints("", one, (0, 1, 2), 1.0) for one in mappings)
        self._chosen, self._term = chosen, Effectors(effectors, self._nodes.free_index)
        self.stack = RowStack([*filter(None, (self._sensors, self._term))], self._nodes.carried, self._nodes.free_axes)
        return True

    def of_quantities(self, rows: np.ndarray) -> np.ndarray:
        """Values of all coordinates by those of the rows.

        Args:
            rows: Shape (row_count, ...).

        Returns:
            Shape (3 quantity_count, ...).
        """
        values = np.zeros((3 * self.quantity_count, *rows.shape[1:]))
        values[self._coordinates] = rows
        return values

    def basis(self, positions: np.ndarray) -> np.ndarray:
        """Forces at the rows of the places by the numbers of their loads.

        A wrench is the least forces at its four points that have this sum and torque.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Shape (row_count of places, number of loads).
        """
        if not self._has_wrench:
            return self._identity
        points = self._term.positions(positions)[len(self._own) :]
        blocks, first = [], 0
        for place in self.places:
            if place.is_wrench:
                arms = points[first : first + 4] - points[first]
                sums = np.hstack([np.vstack([np.eye(3), cross_matrices(arm)]) for arm in arms])
                blocks.append(np.linalg.pinv(sums))
            else:
                blocks.append(np.eye(3))
            first += 4 if place.is_wrench else 1
        return block_diag(*blocks)

    def places_at(self, positions: np.ndarray) -> np.ndarray:
        """Where the loads act [m], shape (place_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        points = self._term.positions(positions)[len(self._own) :]
        counts = [4 if place.is_wrench else 1 for place in self.places]
        return points[np.cumsum(counts) - counts]

    def add_forces(self, positions: np.ndarray, loads: np.ndarray, forces: np.ndarray) -> None:
        """Add the loads to the forces on the unknowns.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            loads: Numbers of all loads [N] and [N m], shape (load_count,).
            forces: On the unknowns [N], shape (free_node_count, 3); added to.
        """
        self.stack.evaluate(positions)
        self.stack.add_forces(self.basis(positions) @ loads, forces)


def _point(points: BarycentricMapping, index: int) -> BarycentricMapping:
    """One of some points."""
    one = slice(index, index + 1)
    return BarycentricMapping(points.nodes[one], points.barycentric_weights[one])


def numbers_of(places: tuple[ObservedPlace, ...], wrenches: np.ndarray) -> np.ndarray:
    """The numbers of all loads, without torques that a place does not have, shape (load_count,).

    Args:
        places: The places.
        wrenches: Forces and torques, shape (place_count, 6).
    """
    return np.concatenate([one[: place.dimension] for place, one in zip(places, wrenches, strict=True)])


class Observed(StepPart):
    """Lets the model bear what an observer found."""

    name, takes = "observer", ObservedForces

    def __init__(self, model: Model):
        """Take the term.

        Args:
            model: The built scene.
        """
        self._term = model.force_term(ObservedLoads)
        self._rows = ObservedRows(model, self._term.places, with_quantities=False)
        self._none = ObservedForces.none(len(self._term.places))
        self._found, self._rest = self._none, model.nodes.rest_positions

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """The fields of an `ObservedForces` that found nothing, and places [m]."""
        return {**self._none._asdict(), "places": self._rows.places_at(self._rest)}

    def begin(self, state: State, measured: ObservedForces | None) -> bool:
        """Set the loads of a step.

        Args:
            state: Where the step begins.
            measured: What was found; None where nothing was.

        Returns:
            False: the stiffness stays.

        Raises:
            CommandError: An array has another shape, or holds infinite values or NaN.
        """
        found = self._none if measured is None else measured
        count = len(self._term.places)
        wrenches = fitting("observed forces", found.wrenches, (count, 6), nan_allowed=False)
        self._found = found._replace(wrenches=np.array(wrenches))
        self._term.forces[:] = 0.0
        self._rows.choose(found.points)
        if wrenches.any():
            loads = numbers_of(self._term.places, wrenches)
            self._rows.add_forces(state.positions, loads, self._term.forces)
        return False

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """The loads of the step, and where they act."""
        found = {field: np.array(one) for field, one in self._found._asdict().items()}
        return {**found, "places": self._rows.places_at(positions)}

    @property
    def loads(self) -> np.ndarray:
        """All forces and torques, shape (6 place_count,)."""
        return self._found.wrenches.ravel()

    @property
    def load(self) -> float:
        """Sum of the forces of the step by magnitude [N]."""
        return float(np.linalg.norm(self._found.wrenches[:, :3], axis=1).sum())
