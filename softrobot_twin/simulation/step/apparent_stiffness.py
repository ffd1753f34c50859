"""The stiffness that effectors show to a touch, and its exact derivative by the actuation.

A force on an effector meets its apparent compliance, while the actuators hold what they hold:
displacements h where they are driven by them and their efforts are within their bounds, efforts
elsewhere. With the load e of one newton along an axis, e = H_eᵀ, the body moves by x and the held
actuators change their efforts by Λ:

    A x - H_hᵀ Λ = e,    H_h x = 0,    C = eᵀ x = W_ee - W_eh W_hh⁻¹ W_he,    k = 1/C.

That is a symmetric system, so C changes with unknowns q and efforts λ by

    dC = -xᵀ dA x + 2 Λᵀ dH_h x.

A is the second derivative of Π = E - pᵀq - λᵀδ, and so, with derivatives along x,

    ∂C/∂q   = -(D³E[x, x] - Σ_i λ_i D²H_i[x, x]) + 2 Σ_i Λ_i DH_i[x] = s,
    ∂C/∂λ_i = DH_i[x] · x.

Both are found without a matrix more than A: D³E[x, x] is the second derivative of the internal
forces along x (`ForceTerm.add_force_curvature`), for elements from their differential; that of the
rows is taken from the rows at places along x. By symmetry of the third derivative one such vector s
serves all actuators: with dq = A⁻¹ (b + Hᵀλ) of a step (eq. 15), and y = A⁻¹ s,

    C(λ) = C(q, λ₀) + yᵀ (b + H_aᵀ λ) + Σ_i ∂C/∂λ_i (λ_i - λ₀_i).

So a direction costs two or three solutions with the factor, one pass over the elements, and four
evaluations of the rows, whatever the number of actuators. Coevoet 2017, section 7.2.4, controls
W_ee with the actuators' efforts given; here what holds its displacement resists too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.effector import Effectors, along_all_axes
from softrobot_twin.constraints.row_stack import RowStack, add_row_forces
from softrobot_twin.mechanics.force_term import SECOND_DIFFERENCE
from softrobot_twin.mechanics.kinematics import Nodes
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.linearized import LinearizedState

# Rows that say the same make W_hh singular. With this share of their own compliance they share the
# load; it is far below what any result could show.
SHARING = 1.0e-10
# Largest displacement of a node that rows and forces are differentiated over, as a share of the
# body's size: differences of fourth order then have about ten digits.
REACH = 2.0e-4
# A finger pushes an effector this far, as a share of the body's size. What would go slack or stall
# by that, either way, holds nothing.
PUSH = 1.0e-4
# One linearization asks for no greater change of a stiffness, as a share of it.
LONGEST_CHANGE = 0.25
# Places and weights of a first derivative of fourth order, in steps; of the places above.
FIRST_DIFFERENCE = {-2.0: 1.0 / 12.0, -1.0: -2.0 / 3.0, 1.0: 2.0 / 3.0, 2.0: -1.0 / 12.0}


class ComplianceGradient(NamedTuple):
    """The apparent compliance of effectors along some directions, and its derivatives.

    Attributes:
        compliance: C of each direction [m/N], shape (n,).
        by_position: ∂C/∂q [1/N], shape (n, free_node_count, 3).
        by_effort: ∂C/∂λ of each actuator with a row, shape (n, actuator_row_count).
        free: C at multipliers of zero, by the linearization [m/N], shape (n,).
        by_multiplier: Its change by the multipliers of the actuators, shape (n, actuator_row_count).
        holds: Whether each actuator with a row holds where a finger pushes, same shape.
        bearing: Change of its effort by that push, zero where it does not hold, same shape.
    """

    compliance: np.ndarray
    by_position: np.ndarray
    by_effort: np.ndarray
    free: np.ndarray
    by_multiplier: np.ndarray
    holds: np.ndarray
    bearing: np.ndarray


class StiffnessRows(NamedTuple):
    """Rows of wanted stiffnesses around one state.

    Attributes:
        wanted: z of the targets [m], shape (n,).
        now: z [m], shape (n,).
        free: z at multipliers of zero, by the linearization [m], shape (n,).
        motion: Change of z by the multipliers of the actuators, shape (n, actuator_row_count).
        weights: Weight of each row, zero where a compliance is not positive, shape (n,).
        lengths: ℓ [m], shape (n,).
        directions: Directions, 3 × effector + axis, shape (n,).
        gradient: Compliances and their derivatives.
        with_bearing: Gives the rows if just some actuators held, shape (actuator_row_count,).
    """

    wanted: np.ndarray
    now: np.ndarray
    free: np.ndarray
    motion: np.ndarray
    weights: np.ndarray
    lengths: np.ndarray
    directions: np.ndarray
    gradient: ComplianceGradient
    with_bearing: Callable[[np.ndarray], StiffnessRows]

    @property
    def asked(self) -> np.ndarray:
        """Change of z that one linearization asks for [m], shape (n,)."""
        longest = LONGEST_CHANGE * self.lengths
        return np.clip(self.wanted - self.now, -longest, longest)

    def places(self, multipliers: np.ndarray) -> np.ndarray:
        """z under multipliers of the actuators, by the linearization [m], shape (n,).

        Args:
            multipliers: λ, those of the actuators first, shape (count,).
        """
        return self.free + self.motion @ multipliers[: self.motion.shape[1]]

    def after(self, move: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Stiffnesses after a move, to first order from the state [N/m], shape (n,).

        Args:
            move: Displacement of the unknowns [m], shape (free_node_count, 3).
            change: Of the actuators' efforts, shape (actuator_row_count,).
        """
        found = self.gradient
        moved = np.einsum("nij,ij->n", found.by_position, move)
        k = 1.0 / found.compliance
        return k - k * k * (moved + found.by_effort @ change)


def effector_rows(effectors: Effectors, nodes: Nodes) -> RowStack:
    """Three rows for each effector, whatever directions a scene controls.

    Args:
        effectors: The effectors of a scene.
        nodes: The nodes of the scene.
    """
    return RowStack([along_all_axes(effectors, nodes.free_index)], nodes.carried, nodes.free_axes)


def sharing(diagonal: np.ndarray) -> np.ndarray:
    """What is added to the compliances of rows that hold, so that redundant ones share a load.

    Args:
        diagonal: Compliance of each row by itself, shape (row_count,).

    Returns:
        Same shape. A row that reaches no unknown holds nothing.
    """
    return np.where(diagonal > 0.0, SHARING * diagonal, 1.0)


class ApparentStiffness:
    """Finds the apparent compliance of the effectors of one scene, and its derivatives."""

    def __init__(self, model: Model):
        """Lay out the loads.

        Args:
            model: A scene in statics, whose unknowns are nodes or coordinates of reduced bodies,
                with actuators that do not yield, without contact and slides; see
                `why_no_stiffness`.
        """
        self._model, self._free_nodes = model, model.nodes.free_nodes
        self._reach, self._push = REACH * model.nodes.size, PUSH * model.nodes.size
        rows = effector_rows(model.effectors, model.nodes)
        rows.evaluate(model.nodes.rest_positions)
        self._loads = rows.row_index, rows.node_index, rows.blocks
        # Rows of axes that the scene controls, which are condensed already.
        own = model.effectors
        places = (3 * own.row_effector + own.row_axis)[: own.position_row_count]
        self._row_of = {place: row for row, place in enumerate(places.tolist())}

    def gradient(
        self, state: LinearizedState, directions: np.ndarray, holding: np.ndarray | None = None
    ) -> ComplianceGradient:
        """Compliance along some directions, and its derivatives.

        Args:
            state: The linearized state.
            directions: Directions, 3 × effector + axis, one at least, shape (n,).
            holding: Actuators with rows that hold, whatever their efforts are,
                shape (actuator_row_count,); None for those that bear.
        """
        found = [self._along(state, direction, holding) for direction in directions.tolist()]
        return ComplianceGradient(*(np.array(part) for part in zip(*found, strict=True)))

    def _along(self, state: LinearizedState, direction: int, holding: np.ndarray | None) -> tuple:
        """One entry of each field of `ComplianceGradient`."""
        load = self.load(direction)
        x, Lambda, held = self._response(state, direction, load, holding)
        compliance = float(np.vdot(load, x))
        by_position, by_effort = self._derivatives(state, x, Lambda)
        y = state.solver.solve(by_position)
        linear = state.linear
        moved = self._row_motion(y)
        by_multiplier, free = moved.copy(), compliance + float(np.vdot(y, state.forces))
        # λ = λ̂ - ρ (W λ̂ + δ_free - δ_ref)
        rho, reference, *_ = linear.augmentation
        by_multiplier += by_effort - (by_effort * rho) @ linear.W_aa
        free -= float(by_effort @ (rho * (linear.actuators - reference) + state.efforts))
        bearing = np.abs(Lambda) * self._push / compliance if compliance > 0.0 else 0.0 * Lambda
        return compliance, by_position, by_effort, free, by_multiplier, held, bearing

    def load(self, direction: int) -> np.ndarray:
        """e of a direction of the effectors' points [-], shape (free_node_count, 3).

        Args:
            direction: Number of the row of a direction of the effectors' points.
        """
        rows, nodes, blocks = self._loads
        load, own = np.zeros((len(self._free_nodes), 3)), rows == direction
        np.add.at(load, nodes[own], blocks[own])
        return load

    def _response(
        self, state: LinearizedState, direction: int, load: np.ndarray, holding: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x [m/N], shape (free_node_count, 3), Λ and who holds, shape (actuator_row_count,)."""
        linear = state.linear
        W, held = linear.W_aa, self.holds(state.efforts)
        if holding is not None:
            held = holding
        row = self._row_of.get(direction)
        if row is None:
            moved = self._row_motion(state.solver.solve(load))
        else:
            moved = linear.W[linear.groups.actuators, linear.groups.effectors.start + row]
        # Held rows do not move; the efforts λ̂ - ρ δ of the others do not change.
        while True:
            share = np.where(held, 1.0, -linear.augmentation.stiffness)
            M = share[:, None] * W
            M[np.diag_indices_from(M)] += np.where(held, SHARING * W.diagonal(), 1.0)
            change = np.linalg.solve(M, -share * moved)
            forces = load.copy()
            self._add_row_forces(self._model.rows.blocks, change, forces)
            x = state.solver.solve(forces)
            still = held & self._bears(state.efforts, np.where(held, change, 0.0), np.vdot(load, x))
            if holding is not None or (still == held).all():
                return x, np.where(held, change, 0.0), held
            held = still

    def _bears(self, efforts: np.ndarray, change: np.ndarray, compliance: float) -> np.ndarray:
        """Whether each actuator stays within its efforts where a finger pushes, either way.

        Args:
            efforts: Of the actuators with rows, shape (actuator_row_count,).
            change: Of these by a force of one newton, same shape.
            compliance: What the force meets [m/N].
        """
        if not compliance > 0.0:
            return np.ones(len(efforts), dtype=bool)
        limits, change = self._model.actuators.limits, np.abs(change) * self._push / compliance
        a = slice(0, len(efforts))
        return (efforts - change >= limits.effort_min[a]) & (
            efforts + change <= limits.effort_max[a]
        )

    def holds(self, efforts: np.ndarray) -> np.ndarray:
        """Whether each actuator with a row holds its displacement at such efforts, shape (count,).

        Args:
            efforts: Efforts of the actuators with a row, in their units, shape (count,).
        """
        actuators = self._model.actuators
        return actuators.limits.can_hold(efforts) & ~actuators.is_effort_driven[: len(efforts)]

    def _derivatives(
        self, state: LinearizedState, x: np.ndarray, Lambda: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """s = ∂C/∂q, shape (free_node_count, 3), and ∂C/∂λ, shape (actuator_row_count,)."""
        model, positions = self._model, state.positions
        direction = self._moves_of_nodes(positions, x)
        curvature = np.zeros_like(x)
        for term in model.forces:
            term.add_force_curvature(positions, direction, self._reach, curvature)
        first, second = self._row_derivatives(positions, direction)
        gradient = -curvature
        self._add_row_forces(second, state.efforts, gradient)
        self._add_row_forces(first, 2.0 * Lambda, gradient)
        return gradient, self._row_motion(x, first)

    def _moves_of_nodes(self, positions: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Moves of all nodes by those of the unknowns, zero where they are fixed."""
        nodes, moves = self._model.nodes, x
        if nodes.carried:
            moves = nodes.carried.point_moves(positions, x)
        found, moving = np.zeros_like(positions), nodes.free_index >= 0
        found[moving] = moves[nodes.free_index[moving]]
        return found

    def _row_derivatives(
        self, positions: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Entries of DH[x] and D²H[x, x] of the actuators' rows, each of shape (entry_count, 3)."""
        rows = self._model.rows
        longest = float(np.sqrt((direction * direction).sum(axis=1).max()))
        first = second = np.zeros((0, 3))
        if longest == 0.0:
            return first, second
        step = 0.5 * self._reach / longest
        for place, weight in SECOND_DIFFERENCE:
            blocks = rows.actuator_blocks_at(positions + place * step * direction)
            if not len(second):
                first, second = np.zeros_like(blocks), np.zeros_like(blocks)
            second += weight * blocks
            first += FIRST_DIFFERENCE.get(place, 0.0) * blocks
        return first / step, second / step**2

    def _add_row_forces(self, blocks: np.ndarray, efforts: np.ndarray, forces: np.ndarray) -> None:
        """Add Hᵀ λ of the actuators' rows, with other entries than those at the state."""
        rows, count = self._model.rows, self._model.rows.actuator_entry_count
        add_row_forces(
            rows.row_index[:count], rows.node_index[:count], blocks[:count],
            np.ascontiguousarray(efforts), forces,
        )  # fmt: skip

    def _row_motion(self, move: np.ndarray, blocks: np.ndarray | None = None) -> np.ndarray:
        """H x of the actuators' rows, shape (actuator_row_count,)."""
        rows, count = self._model.rows, self._model.rows.actuator_entry_count
        own = (rows.blocks if blocks is None else blocks)[:count]
        return np.bincount(
            rows.row_index[:count], np.einsum("ij,ij->i", own, move[rows.node_index[:count]]),
            rows.groups.actuators.stop,
        )  # fmt: skip


def why_no_stiffness(model: Model) -> str:
    """What a scene has that the derivative of the stiffness is not built for; empty if nothing.

    Args:
        model: The model of a simulation.
    """
    rows, nodes = model.rows, model.nodes
    if model.is_dynamic:
        return "integration other than quasi_static"
    is_linear = all(kind.has_constant_derivatives for kind in nodes.kinds)
    if nodes.free_node_count != len(nodes.free_nodes) or not is_linear:
        return "rigid bodies, beams or vertebrae"
    if rows.varies:
        return "contact"
    if model.slides:
        return "slides"
    if not model.actuators.conserves:
        return model.actuators.losses
    if rows.told is not None or any(term.yields for term in rows.terms):
        return "actuators that yield, such as cables that stretch"
    return ""
