"""The protocol of a force term: the forces and the stiffness that it adds in a step."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from softrobot_twin.kernels.worker_threads import Team
from softrobot_twin.mechanics.stencil import BoundStencils, bind_stencils


# Places and weights of a second derivative of fourth order, in steps.
SECOND_DIFFERENCE = (
    (-2.0, -1.0 / 12.0), (-1.0, 4.0 / 3.0), (1.0, 4.0 / 3.0), (2.0, -1.0 / 12.0), (0.0, -2.5),
)  # fmt: skip


class DenseRows(NamedTuple):
    """A part Σ k h hᵀ of a stiffness that couples too many unknowns for blocks.

    Attributes:
        row_index: Row h of each entry, shape (entry_count,).
        node_index: Unknown of each entry, shape (entry_count,).
        blocks: The entries, shape (entry_count, 3).
        stiffness: k of each row, not zero, shape (row_count,).
    """

    row_index: np.ndarray
    node_index: np.ndarray
    blocks: np.ndarray
    stiffness: np.ndarray


NO_DENSE_ROWS = DenseRows(*np.empty((2, 0), np.int64), np.empty((0, 3)), np.empty(0))


class ForceTerm(Protocol):
    """Forces on the unknowns, and their stiffness, of all elements of one kind.

    Terms inherit from this class. A method that a term does not define keeps the default below:
    no energy, and nothing remembered from the beginning of a step.

    Attributes:
        name: What the term is called in reports.
        remembers_start: True for a term whose forces depend on the state at the beginning of
            the step, as those of inertia and damping do; only then `begin_step` is called.
        is_inertia: True for a term of masses that resist acceleration: it is an `InertiaTerm`.
        stays_upright: True for a term of elements that no move may turn inside out; laws of small
            displacements do not know what is inside out.
        is_traceable: True where `add_forces`, and `add` of a tangent that is not projected, do nothing
            with numbers but by kernels, and what else they do follows from what kernels returned; see `traced_stage.py`.
        is_slender: True for a term of parts that are much stiffer along than across, such as
            beams. A part that turns on the straight line of a move is stretched a little on its
            way: its energy rises, and falls with the next move.
        memory_name: Under which name a state holds what the term remembers, see `step_part`; empty
            for one that remembers nothing.
        nearly_flat_count: Points at which the barrier against flat elements acts, at the state
            whose forces were taken last.
        crossed_count: Elements there that are beyond the barrier at a place between their points;
            they may be upright.
        dense_rows: The part of the stiffness that is not assembled, at the state evaluated last;
            None for a term without such a part.
    """

    name: str
    remembers_start: bool = False
    is_inertia: bool = False
    stays_upright: bool = False
    is_slender: bool = False
    is_traceable: bool = False
    memory_name: str = ""
    nearly_flat_count: int = 0
    crossed_count: int = 0
    dense_rows: DenseRows | None = None
    _stencils: np.ndarray
    _bound: BoundStencils

    def __init_subclass__(cls, **options) -> None:
        """Each class says itself whether it is traceable: it may have other methods."""
        super().__init_subclass__(**options)
        cls.is_traceable = vars(cls).get("is_traceable", False)

    @property
    def on_points(self) -> ForceTerm:
        """The term that works on points: itself, or the one that a folded term contains."""
        return self

    def stencils(self) -> np.ndarray:
        """Unknowns that each element couples, -1 where none, shape (element_count, width)."""
        return self._stencils

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness blocks in the factorization's storage.

        Args:
            elimination_rank: Place of each unknown in the elimination order,
                shape (free_node_count,).
            slots: The factorization's `slots`.
        """
        self._bound = bind_stencils(self._stencils, elimination_rank, slots)

    def use_threads(self, team: Team) -> None:
        """Assemble by threads where this gains time; the bits stay the same.

        Args:
            team: The threads.
        """

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Remember the state at the beginning of a step.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Velocities of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            time_step: h [s]; infinite in statics.
        """

    def follow_move(self, start: np.ndarray) -> None:
        """Take the last move of the step before for one of this step.

        Args:
            start: Node positions where it began [m], shape (node_count, 3).
        """

    def begin_rates(
        self, positions: np.ndarray, reference: np.ndarray, velocities: np.ndarray, span: float
    ) -> None:
        """Remember from where rates are taken: the velocity that counts is (q - q_r) / span.

        A scheme of second order calls it in place of `begin_step`, for terms without inertia.

        Args:
            positions: Node positions at the beginning of the step [m], shape (node_count, 3).
            reference: q_r [m], same shape.
            velocities: Velocities of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            span: [s], positive.
        """
        self.begin_step(reference, velocities, span)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces [N] and torques [N m] on the unknowns, shape (free_node_count, 3);
                added to.

        Returns:
            Number of elements that are flat or inside out.
        """
        ...

    def knows(self, positions: np.ndarray) -> bool:
        """Whether `add` takes the forces of a state as they were found last.

        Args:
            positions: Node positions of the state [m], shape (node_count, 3).
        """
        return True

    def add(self, positions: np.ndarray, forces: np.ndarray, storage: np.ndarray, projected: bool) -> None:
        """Add the forces, and the stiffness to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces [N] and torques [N m] on the unknowns, shape (free_node_count, 3);
                added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for a stiffness that is positive semidefinite at every state, False
                for the exact derivative of the forces.
        """
        self.add_forces(positions, forces)
        self.add_stiffness(positions, storage, projected)

    def add_stiffness(self, positions: np.ndarray, storage: np.ndarray, projected: bool) -> None:
        """Add the stiffness alone, after `add_forces` at the same state; none by default.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            storage: The factorization's storage [N/m]; added to.
            projected: See `add`.
        """

    def clear_dense_rows(self) -> None:
        """Where dense rows do not follow from the state evaluated last: have none until stiffness is
        added again; by a kernel, if the term is traceable.
        """

    def largest_share(self, before: np.ndarray, after: np.ndarray) -> float:
        """How much of a move may be made before the term's forces are not defined any more.

        Args:
            before: Node positions where the move begins [m], shape (node_count, 3).
            after: Those after the whole move [m], same shape.

        Returns:
            A share of the move, at most one.
        """
        return 1.0

    def add_force_curvature(
        self, positions: np.ndarray, direction: np.ndarray, reach: float, curvature: np.ndarray
    ) -> None:
        """Add ∂²f/∂h² of the internal forces f = ∂E/∂q at q + h x, h = 0: D³E[x, x].

        Here by central differences of fourth order of the forces. Terms whose stiffness can be
        differentiated more exactly do that. Only for scenes whose unknowns are nodes.

        Args:
            positions: q: node positions [m], shape (node_count, 3).
            direction: x of all nodes, zero where they are fixed, same shape.
            reach: Largest displacement |h x| of a node that differences are taken over [m].
            curvature: Takes the sum, shape (free_node_count, 3); added to.
        """
        longest = float(np.sqrt((direction * direction).sum(axis=1).max(initial=0.0)))
        if longest == 0.0:
            return
        step = 0.5 * reach / longest
        total = np.zeros_like(curvature)
        # The state itself comes last: what a term remembers of it is as it was.
        for place, weight in SECOND_DIFFERENCE:
            forces = np.zeros_like(curvature)
            self.add_forces(positions + place * step * direction, forces)
            total -= weight * forces
        curvature += total / step**2

    def energy(self, positions: np.ndarray) -> float:
        """Elastic energy stored at a state [J]; zero for a term that stores none.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return 0.0

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """Kinetic energy [J]; zero for a term without inertia.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            velocities: Velocities of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
        """
        return 0.0


class OwnBlocks(ForceTerm):
    """A force term whose stiffness couples each unknown with itself only."""

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the diagonal blocks; see `ForceTerm.bind`."""
        own = self._stencils.ravel()
        self._offsets, self._strides = slots(own, own)


class InertiaTerm(ForceTerm, Protocol):
    """A force term of masses that resist acceleration, -M w ((q - q₀)/h - v₀)/h.

    `begin_step` is given q₀, h, and as v₀ the velocity that the integration scheme extrapolates by.

    Attributes:
        weight: w, 1 for backward Euler. Greater ones make it a scheme of second order; turns are
            then taken about the middle of the step.
    """

    is_inertia: bool = True
    weight: float = 1.0

    def begin_second_order(
        self, positions: np.ndarray, ahead: np.ndarray, velocities: np.ndarray,
        accelerations: np.ndarray, time_step: float,
    ) -> None:  # fmt: skip
        """Remember the state at the beginning of a step of a scheme of second order.

        Args:
            positions: Node positions [m], guided ones already moved, shape (node_count, 3).
            ahead: The velocity that the scheme extrapolates by, of the unknowns [m/s] and [rad/s],
                shape (free_node_count, 3).
            velocities: Those at the beginning, same shape.
            accelerations: Same shape.
            time_step: h [s].
        """
        self.begin_step(positions, ahead, time_step)

    def add_accelerations(self, positions: np.ndarray, forces: np.ndarray, accelerations: np.ndarray) -> None:
        """Add M⁻¹ f.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: f [N] and [N m], shape (free_node_count, 3).
            accelerations: Of the unknowns [m/s²] and [rad/s²], same shape; added to.
        """
        ...
