"""Derivatives of an equilibrium by the numbers of its scene, and by loads.

At rest, forces are in balance and what holds is where it is held. With the unknowns q, the efforts λ
of what holds, and a parameter p,

    r(q, λ, p) = 0,    δ(q, p) + C λ - d(p) = 0,

    A dq - Hᵀ dλ = ∂r/∂p,    D dq + C dλ = ∂d/∂p - ∂δ/∂p,

with the tangent A = -∂r/∂q. One factorization serves all parameters. The right sides are differences
between the terms of two scenes that are built, but not stepped, so each number of a scene is a
parameter.

The adjoint solves the transposed equations for a few rows g of the unknowns: then g · dq follows for
any number of parameters by products.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from softrobot_twin.analysis.apparent_compliance import CondensedHold, HeldTangent, Saddle
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.errors import CommandError, NamedError, SceneError
from softrobot_twin.mechanics.touch_loads import TouchLoads
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_parameters import JointParameter, Parameter
from softrobot_twin.simulation.build import Terms, build_terms, with_cables
from softrobot_twin.simulation.building.scene_layout import Layout
from softrobot_twin.simulation.mounting import mount
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.apparent_stiffness import effector_rows
from softrobot_twin.simulation.step.step_part import memories_of_terms

# Differences are taken over this share of a number. Residuals have 1e-16 of the inner forces as
# round-off, so 1e-10 of the derivative is lost, and by the curvature 1e-12.
STEP_SHARE = 1.0e-6
# A length is not changed by less than the step of a tenth of the robot's size: it may be a coordinate
# near the origin.
LEAST_LENGTH = 0.1
# What stands for a number that is zero, by its unit.
ZEROS = {"Pa": 1.0e3}
# Sections of a scene that say what touches.
TOUCHING = ("contact", "obstacles", "rigid_bodies")
# This share of all loads may be out of balance.
UNBALANCED = 1.0e-2


class SensitivityError(NamedError):
    """A derivative does not exist, or cannot be told; its name is the key of the parameter."""


class Loads(NamedTuple):
    """Changes of forces and displacements, by one parameter or by each of several.

    Attributes:
        forces: On the unknowns [N], shape (free_node_count, 3, ...).
        displacements: By which each actuator with a row is held further in the direction in which
            its effort does work, in its unit, shape (actuator_row_count, ...).
        effectors: Of the effectors while unknowns stay [m], shape (effector_count, 3, ...).
    """

    forces: np.ndarray
    displacements: np.ndarray
    effectors: np.ndarray


class Answer(NamedTuple):
    """What follows from loads.

    Attributes:
        moves: Of the unknowns [m], of rotations [rad], shape (free_node_count, 3, load_count).
        efforts: Changes of the efforts of the actuators, in their units, zero for what holds
            nothing, shape (actuator_count, load_count).
    """

    moves: np.ndarray
    efforts: np.ndarray


class Sensitivity(NamedTuple):
    """Derivatives of an equilibrium by parameters.

    Where slopes to both sides of a number differ, as where a point lies on a face between elements, the
    derivative is their mean.

    Attributes:
        parameters: The parameters, p of them.
        effectors: Of the effectors' positions [m per unit], shape (effector_count, 3, p).
        efforts: Of the actuators' efforts, in their units, shape (actuator_count, p).
        moves: Of the unknowns [m per unit], shape (free_node_count, 3, p).
    """

    parameters: tuple[Parameter | JointParameter, ...]
    effectors: np.ndarray
    efforts: np.ndarray
    moves: np.ndarray


class AtState(NamedTuple):
    """What the terms of a scene tell at the unknowns and efforts of a state of another one.

    Attributes:
        forces: Out of balance, on the unknowns [N], shape (free_node_count, 3).
        paths: Displacements of the actuators with rows from rest, each in its unit.
        drives: Displacements at which setpoints hold them, same shape.
        effectors: Positions [m], shape (effector_count, 3).
        passive: Those of the force terms alone.
        layout: The bodies of the scene.
    """

    forces: np.ndarray
    paths: np.ndarray
    drives: np.ndarray
    effectors: np.ndarray
    passive: np.ndarray
    layout: Layout

    def loads(self, holds_setpoints: bool | np.ndarray) -> Loads:
        """The same as loads, whose changes move the equilibrium.

        Args:
            holds_setpoints: See `Sensitivities.of_parameters`.
        """
        holds = np.atleast_1d(holds_setpoints)[: len(self.drives)]
        held = np.where(holds, self.drives, 0.0)
        return Loads(self.forces, held - self.paths, self.effectors)


class Sensitivities(HeldTangent):
    """Derivatives at the present state of a simulation, which is in balance.

    Attributes:
        by_effort: See `EffectorCompliance.at_state`.
    """

    def __init__(self, simulation: Simulation, by_effort: np.ndarray | bool = False):
        """Allocate.

        Args:
            simulation: The simulation.
            by_effort: See `EffectorCompliance.at_state`.
        """
        super().__init__(simulation)
        self.by_effort = by_effort
        self._at: tuple[State | None, bytes] = None, b""
        self._middle: AtState | None = None
        self._built: dict[tuple[str, int], Terms] = {}
        self._effector_rows: dict[int, RowStack] = {}

    def solve_sensitivity(self, forces: np.ndarray, displacements: np.ndarray | None = None) -> Answer:
        """How unknowns and efforts answer to small loads, while held actuators hold.

        Args:
            forces: On the unknowns [N], shape (free_node_count, 3, load_count).
            displacements: By which actuators are held further; see `Loads`. None for none.
        """
        count, system, a = forces.shape[2], *self._system()
        below = np.zeros((len(self._held.places), count))
        if displacements is not None:
            moved = (self._held.ratios * displacements.T).T  # Their paths move more than their winches.
            below[: np.count_nonzero(self._held.held)] = moved[self._held.held]
        moves, multipliers = system.solve(forces.reshape(3 * len(forces), count), below)
        efforts = np.zeros((self._model.actuators.count, count))
        efforts[:a][self._held.held] = multipliers[: np.count_nonzero(self._held.held)]
        return Answer(moves.reshape(forces.shape), efforts)

    def adjoint(self, rows: np.ndarray | None = None, efforts: np.ndarray | None = None) -> Loads:
        """What some combinations of the unknowns and the efforts gain by each load.

        Args:
            rows: Weights of the unknowns, shape (row_count, free_node_count, 3); None for the
                positions of the effectors, three rows each.
            efforts: Weights of the efforts, shape (row_count, actuator_count); None for none.

        Returns:
            For each row its derivative by the force on each unknown [1/N], shape
            (free_node_count, 3, row_count), and by the displacement of each actuator, shape
            (actuator_row_count, row_count). Nothing by effectors.
        """
        system, a = self._system()
        above = self._effectors if rows is None else rows.reshape(len(rows), -1)
        below = np.zeros((len(self._held.places), len(above)))
        if efforts is not None:
            below[: np.count_nonzero(self._held.held)] = efforts[:, :a][:, self._held.held].T
        forces, multipliers = system.solve(above.T, below, transposed=True)
        displacements = np.zeros((a, len(above)))
        displacements[self._held.held] = multipliers[: np.count_nonzero(self._held.held)]
        displacements *= self._held.ratios[:, None]
        return Loads(forces.reshape(-1, 3, len(above)), displacements, np.zeros((self._count, 3, len(above))))

    def gradient(
        self, parameters: Sequence[Parameter | JointParameter], effectors: np.ndarray, efforts: np.ndarray,
        holds_setpoints: bool | np.ndarray = True,
    ) -> np.ndarray:  # fmt: skip
        """Derivatives of one function of effectors and efforts, by the adjoint: one solution for all.

        Args:
            parameters: See `of_parameters`.
            effectors: Its derivatives by the positions of effectors, shape (effector_count, 3).
            efforts: By the efforts of actuators, shape (actuator_count,).
            holds_setpoints: See `of_parameters`.

        Returns:
            Shape (parameter_count,).

        Raises:
            SensitivityError: A derivative does not exist at this state.
        """
        self._system()
        weights = (effectors.ravel() @ self._effectors).reshape(1, -1, 3)
        gains, found = self.adjoint(weights, efforts[None]), np.empty(len(parameters))
        for place, one in enumerate(parameters):
            loads = self.loads(one, holds_setpoints)
            found[place] = np.vdot(gains.forces[..., 0], loads.forces) + np.vdot(
                gains.displacements[:, 0], loads.displacements) + np.vdot(effectors, loads.effectors)
        return found

    def of_parameters(
        self, parameters: Sequence[Parameter | JointParameter], holds_setpoints: bool | np.ndarray = True
    ) -> Sensitivity:
        """Derivatives of effectors and efforts by parameters.

        Args:
            parameters: See `softrobot_twin.scene.scene_parameters`.
            holds_setpoints: Whether actuators hold their setpoints, such as lengths of cables; else
                their displacements from rest, such as shortenings, whose zero may depend on a
                parameter. Of all, or of each, shape (actuator_count,).

        Raises:
            SensitivityError: A derivative does not exist at this state.
        """
        return self.of_loads(parameters, [self.loads(one, holds_setpoints) for one in parameters])

    def of_loads(self, parameters: Sequence[Parameter], loads: Sequence[Loads]) -> Sensitivity:
        """Derivatives of effectors and efforts by parameters whose loads are known.

        Args:
            parameters: The parameters.
            loads: What each of them changes; see `loads`.
        """
        count, (_, a) = len(parameters), self._system()
        none = (np.empty((*shape, 0)) for shape in
                ((self._model.nodes.free_node_count, 3), (a,), (self._count, 3)))  # fmt: skip
        forces, displacements, explicit = (
            (np.stack(parts, -1) for parts in zip(*loads, strict=True)) if count else none)
        answer = self.solve_sensitivity(forces, displacements)
        carried = self._effectors @ answer.moves.reshape(self._effectors.shape[1], count)
        effectors = explicit + carried.reshape(self._count, 3, count)
        return Sensitivity(tuple(parameters), effectors, answer.efforts, answer.moves)

    def loads(self, parameter: Parameter | JointParameter, holds_setpoints: bool | np.ndarray = True) -> Loads:
        """What a parameter changes per its unit, while unknowns and efforts stay.

        Args:
            parameter: The parameter.
            holds_setpoints: See `of_parameters`.

        Raises:
            CommandError: `holds_setpoints` has not one truth value for each actuator.
            SensitivityError: The derivative does not exist at this state.
        """
        self._system()
        holds, count = np.asarray(holds_setpoints), self._model.actuators.count
        if holds.dtype != bool or holds.shape not in ((), (count,)):
            raise CommandError("holds_setpoints", f"{holds_setpoints!r:.60} must be true or false, "
                               f"of all actuators or of each of {count}")
        if self._middle is None:
            self._middle = self._evaluated(self._own_terms)
        value = parameter.read(self._model.scene)
        step, sides = STEP_SHARE * self._scale(parameter), dict[int, AtState]()
        for side in (1, -1, 2, -2):
            if len(sides) == 2 or (side == 2 and 1 not in sides):
                continue
            try:
                terms = self._terms(parameter, side, value + side * step)
                self._check_memory(parameter.key, value, terms)
                sides[side] = self._evaluated(terms)
            except SceneError as error:  # The number is at its limit: the other side tells.
                refused = error
        if len(sides) < 2:
            words = f"{step:g} {parameter.unit}".strip()
            raise SensitivityError(parameter.key, f"cannot be changed by {words}: {refused}") from refused
        self._check_balance()
        for other in sides.values():
            self._check(parameter.key, other)
        middle, *others = (one.loads(holds_setpoints) for one in (self._middle, *sides.values()))
        return Loads(*(_derivative(tuple(sides), step, *parts) for parts in zip(middle, *others, strict=True)))

    def _load(self) -> float:
        """Sum of the weight and of the forces of the actuators, by magnitude [N]."""
        own = self._model.actuators.load(self._simulation.state.efforts)
        return self._simulation.newton.balance.constant_load + own

    def _check_balance(self) -> None:
        """Refuses a state of statics that is far from its equilibrium."""
        scene, forces = self._model.scene, self._middle.forces
        left = float(np.linalg.norm(forces, axis=1).sum())
        most = max(UNBALANCED * self._load(), len(forces) * scene.solver.residual_tolerance)
        if scene.integration == "quasi_static" and not self._held.contact_count and left > most:
            raise SensitivityError("state", f"is not in balance: forces of {left:.2g} N are left in "
                                   f"all, more than {most:.2g} N; let it settle first")

    def _scale(self, parameter: Parameter | JointParameter) -> float:
        """The size of a number, of which a small share is its difference."""
        if isinstance(parameter, JointParameter):
            return min(self._scale(one) / abs(share)
                       for one, share in zip(parameter.numbers, parameter.shares, strict=True))
        unit, value = parameter.unit, parameter.read(self._model.scene)
        if unit == "m":
            size = self._model.nodes.size
            return max(abs(value), LEAST_LENGTH * size if np.isfinite(size) else 0.0) or 1.0
        return abs(value) or ZEROS.get(unit, 1.0)

    def _system(self) -> tuple[Saddle | CondensedHold, int]:
        """The factorized equations at the present state, and the number of actuators with rows."""
        state = self._simulation.state
        by_effort = np.asarray(self.by_effort).tobytes()
        if self._at[0] is not state or self._at[1] != by_effort:
            held = self._held = self._holding(self.by_effort)
            rows, own = self._rows(state.positions, held), held.own_of_places
            A, self._middle = self._definite(state.positions), None
            H = rows.H.transposed(self._model.nodes.free_node_count).T
            self._actuator_rows, self._effectors = H[: len(held.held)], H[len(H) - 3 * self._count :]
            self._solver = CondensedHold(A, H[held.places], own) if A else self._saddle(rows, held)
            self._at = state, by_effort
        return self._solver, len(self._held.held)

    @cached_property
    def _own_terms(self) -> Terms:
        """The terms of the scene itself."""
        scene = self._model.scene
        terms = build_terms(scene, self._simulation.mounted.positions if scene.mounting else None)
        terms.bind_alone()
        return terms

    def _terms(self, parameter: Parameter | JointParameter, side: int, value: float) -> Terms:
        """The terms of the scene with another number; they are built once.

        Raises:
            SceneError: The scene does not take the value.
        """
        key = parameter.key, side
        if key not in self._built:
            scene, base = parameter.set(self._model.scene, value), self._own_terms
            is_plain = not (scene.mounting or self._simulation.has_reduced_bodies)
            if is_plain and parameter.sections == {"cables"}:
                terms = with_cables(base, scene)
                kept = {id(term) for term in (*base.forces, *base.constraints)}
            else:
                terms, kept = build_terms(scene, self._mounted(scene)), set()
                if not _is_alike(base.layout, terms.layout):
                    raise SensitivityError(
                        parameter.key, "makes another mesh or holds other nodes: its structure must "
                        "stay, as that of a box with given numbers of cells")
            terms.bind_alone(kept)
            self._built[key] = terms
        return self._built[key]

    def _mounted(self, scene: Scene) -> np.ndarray | None:
        """Where a scene with another number is mounted, in which case what counts from rest moves."""
        if not scene.mounting:
            return None
        return mount(scene, type(self._simulation), self._simulation.mounted).positions

    def _evaluated(self, terms: Terms) -> AtState:
        """What the terms of a scene tell at the present unknowns and efforts."""
        state, own = self._simulation.state, self._model.nodes
        nodes, actuators = terms.layout.nodes, terms.actuators
        for part in memories_of_terms(terms):
            part.recall(state)
        for term, now in zip(_touches(terms.forces), _touches(self._model.forces), strict=True):
            term.load(now.loads, np.where(now.is_held[:, None], now.places, np.nan))
        positions = nodes.placed_like(own, state.positions)
        # Terms of the scene itself tell the same as before.
        is_own = nodes is self._own_terms.layout.nodes and not actuators.held_forces
        if is_own and self._middle is not None:
            passive, places = self._middle.passive, self._middle.effectors
        else:
            passive, places = terms.passive_forces(positions), self._effector_places(terms, positions)
        forces = passive.copy()
        rows = RowStack(actuators.terms, nodes.carried, nodes.free_axes)
        # What a regulator is told stays; the pressure that it means may be a number of the scene.
        efforts = np.where(actuators.is_effort_driven, actuators.drives(state.setpoints), state.efforts)
        rows.tell_efforts(efforts)
        rows.evaluate(positions)
        rows.add_forces(rows.multipliers(efforts), forces)
        a = rows.groups.actuators
        drives = np.where(actuators.is_effort_driven, 0.0, actuators.drives(state.setpoints))[a]
        return AtState(forces, rows.actuator_paths(state.efforts[a]), drives, places, passive, terms.layout)

    def _effector_places(self, terms: Terms, positions: np.ndarray) -> np.ndarray:
        """Where the effectors of some terms are [m], shape (effector_count, 3)."""
        if id(terms) not in self._effector_rows:
            self._effector_rows[id(terms)] = effector_rows(terms.effectors, terms.layout.nodes)
        rows = self._effector_rows[id(terms)]
        rows.evaluate(positions)
        return rows.values.reshape(-1, 3)

    def _check_memory(self, key: str, value: float, terms: Terms) -> None:
        """Refuses a number whose effect remembers what it did, and is not there at its value."""
        state = self._simulation.state
        if any(part.memory_at_rest() and not state.memory_of(part.name) for part in memories_of_terms(terms)):
            raise SensitivityError(key, f"is {value:g}, and its effect is not in the scene: give it a "
                                   "first value above zero")

    def _check(self, key: str, other: AtState) -> None:
        """Refuses a parameter by which the terms cannot be compared."""
        middle, scene = self._middle, self._model.scene
        rest, moved = middle.layout.nodes.rest_positions, other.layout.nodes.rest_positions
        is_moved = not np.array_equal(rest, moved) or any(
            getattr(other.layout.scene, name) != getattr(scene, name) for name in TOUCHING)
        if is_moved and self._held.contact_count:
            raise SensitivityError(key, "moves what touches, of which no derivative is built")


def _is_alike(one: Layout, other: Layout) -> bool:
    """Whether two scenes have the same cells and unknowns, at whatever places."""
    pairs = zip(one.bodies, other.bodies, strict=True)
    unknowns = ((layout.nodes.free_index, layout.nodes.free_axes) for layout in (one, other))
    return all(map(np.array_equal, *unknowns)) and all(
        before.mesh is after.mesh or np.array_equal(before.mesh.cells, after.mesh.cells)
        for before, after in pairs)


def _touches(forces: Iterable) -> list[TouchLoads]:
    """The terms of touches among force terms."""
    points = (term.on_points for term in forces)
    return [term for term in points if isinstance(term, TouchLoads)]


def _derivative(
    sides: tuple[int, int], step: float, middle: np.ndarray, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """Derivative of an array by a number.

    Args:
        sides: Steps from the number to the two others.
        step: Length of a step.
        middle, first, second: The array at the number and at the others.
    """
    at, to = sides
    one, other = (first - middle) / (at * step), (second - middle) / (to * step)
    # The parabola through the three.
    return (to * one - at * other) / (to - at)
