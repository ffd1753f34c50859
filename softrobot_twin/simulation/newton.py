"""One linearization of the statics: Coevoet 2017, eq. (9) to (15).

    A dq = b + Hᵀλ,   A = ∂F/∂q (and the stiffness of taut cables),   b = p - F(q)     (9, 10)
    A dq_free = b,    δ_free = δ(q) + H dq_free                                         (11-13)
    W = H A⁻¹ Hᵀ                                                                        (14)
    λ from an optimisation over W and δ_free                                            (16-18)
    dq = A⁻¹ (b + Hᵀλ)                                                                  (15)
"""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.simulation.actuation import Actuation, Linearized
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.stage_clock import StageClock
from softrobot_twin.solvers.factorization import NodeRows

# No node moves further than this share of the body's size in one linearization.
LONGEST_MOVE = 0.1
# Ways h v that what moves by itself may make beyond it.
INERTIAL_WAYS = 1.5
# A correction by the factor of an earlier state is kept when what the same factor would correct
# next is at most this share of it. That is the natural monotonicity test of simplified Newton methods
# (Deuflhard, Newton Methods for Nonlinear Problems, 2011, section 2.1). It measures ways: a stale
# factor leaves small forces on soft directions, which are long ways.
GREATEST_CONTRACTION = 0.5
# Beyond this share the factor is worn out: the next linearization makes a new one.
WORN_CONTRACTION = 0.1
# Ways below this share of the body's size are round-off.
NO_WAY = 1.0e-9
# Where the exact tangent was indefinite, it is so for a while: this many linearizations go by its
# projection at once before it is tried again.
PROJECTIONS = 20


class Newton:
    """Linearizes a model, and corrects its positions. Its arrays are allocated once.

    Attributes:
        projected_tangent: True when the last linearization had to project its tangent.
        inverted_count: Elements that were flat or inside out when the residual was taken last.
        constant_load: Sum of the forces on the nodes at rest, the body's weight [N].
        factor_age: Linearizations since the factor was made; None when there is none of use.
        is_worn: True when a stale factor corrected too little the last time.
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._model = model
        self._forces = np.zeros((model.nodes.free_node_count, 3))
        self._actuators = slice(0, model.actuators.row_count)
        effector_count = model.effectors.row_count if model.effectors else 0
        self._effectors = slice(self._actuators.stop, self._actuators.stop + effector_count)
        self._multipliers = np.zeros(self._effectors.stop)
        self._whole_limit = self._step_limit = LONGEST_MOVE * model.nodes.size
        self._time_step = self._last_way = 0.0
        # A single point has no size.
        self._no_way = NO_WAY * min(model.nodes.size, 1.0)
        self.projected_tangent = False
        self.inverted_count = 0
        self.forget()
        self._gather_forces(model.nodes.rest_positions)
        self.constant_load = float(np.linalg.norm(self._forces, axis=1).sum())

    @property
    def may_keep_factor(self) -> bool:
        """True when a linearization in a hurry may do with the factor of an earlier state."""
        return self.factor_age is not None and not self.is_worn

    def forget(self) -> None:
        """Forget what earlier states taught: the next linearization starts from nothing."""
        self.factor_age: int | None = None
        self.is_worn = False
        self.inverted_count = 0
        self._projections_left = 0

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """What flies on by inertia may go further than what a linearization bends.

        A factor holds inertia and damping of its own time step, and is of no use for another one.

        Args:
            positions: Not used.
            velocities: Of the unknowns [m/s], shape (free_node_count, 3).
            time_step: The step's duration [s].
        """
        inertial = INERTIAL_WAYS * time_step * self._model.nodes.longest(velocities)
        self._step_limit = self._whole_limit + inertial
        if time_step != self._time_step:
            self._time_step, self.factor_age = time_step, None

    def linearize(
        self,
        positions: np.ndarray,
        tensions: np.ndarray,
        clock: StageClock,
        with_stale_factor: bool = False,
    ) -> Linearized | None:
        """See the body from its constraints.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            tensions: Cable tensions there [N], shape (actuator_count,).
            clock: Books the stages.
            with_stale_factor: Take the new forces and rows, but the tangent of an earlier state:
                W is off by some 1e-3 a step, and the time of assembly and factor is saved.

        Returns:
            The condensed system, or None when the tangent cannot be factorized.
        """
        if with_stale_factor:
            self.factor_age += 1
            self._gather_forces(positions)
            clock.mark("assemble")
        elif self._factor(positions, tensions, clock):
            self.factor_age, self.is_worn = 0, False
        else:
            self.factor_age = None
            return None
        return self._condense(clock)

    def _factor(self, positions: np.ndarray, tensions: np.ndarray, clock: StageClock) -> bool:
        """Assemble and factorize; where the exact tangent is indefinite, its projection."""
        self._projections_left = max(0, self._projections_left - 1)
        if self._projections_left == 0:
            if self._factor_tangent(positions, tensions, False, clock):
                return True
            self._projections_left = PROJECTIONS
        return self._factor_tangent(positions, tensions, True, clock)

    def _factor_tangent(
        self, positions: np.ndarray, tensions: np.ndarray, projected: bool, clock: StageClock
    ) -> bool:
        self.projected_tangent = projected
        self._assemble(positions, tensions, projected)
        clock.mark("assemble")
        succeeded = self._model.factorization.factor()
        clock.mark("factor")
        return succeeded

    def _condense(self, clock: StageClock) -> Linearized:
        """W and the violations after free motion, of the rows evaluated last (11-14)."""
        rows = self._model.rows
        H = NodeRows(rows.row_index, rows.node_index, rows.blocks, rows.row_count)
        condensed = self._model.factorization.condense(H, self._forces)
        linear = self._seen(condensed.W, rows.values + condensed.free, rows.values)
        clock.mark("condense")
        return linear

    def _seen(self, W: np.ndarray, violation: np.ndarray, values: np.ndarray) -> Linearized:
        """The parts of the condensed system that an optimisation asks for."""
        a, e = self._actuators, self._effectors
        return Linearized(W[a, a], W[e, a], violation[a], violation[e], values[e])

    def _set_multipliers(self, actuation: Actuation) -> None:
        """λ of every row; an effector bears no load."""
        self._multipliers[self._actuators] = actuation.efforts

    def correct(self, positions: np.ndarray, actuation: Actuation) -> float:
        """Move the nodes by A⁻¹ (b + Hᵀλ), eq. (15).

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            actuation: λ.

        Returns:
            Share of the move that was made: one, less where it was too long for a
            linearization, zero where it was not finite.
        """
        self._set_multipliers(actuation)
        move = self._expand()
        longest = self._model.nodes.longest(move)
        if not math.isfinite(longest):
            return 0.0
        share = min(1.0, self._step_limit / longest) if longest > 0.0 else 1.0
        for term in self._model.actuators.terms:
            share = min(share, term.largest_share(positions, move))
        self._last_way = share * longest
        self._model.nodes.advance(positions, move, share)
        return share

    def _expand(self) -> np.ndarray:
        """A⁻¹ (b + Hᵀλ) of the rows that were condensed, shape (free_node_count, 3)."""
        return self._model.factorization.expand(self._multipliers)

    def residual(self, positions: np.ndarray, actuation: Actuation) -> float:
        """Largest force out of balance on a node, p - F(q) + Hᵀλ [N]; counts inverted elements."""
        model = self._model
        self._gather_forces(positions)
        self._set_multipliers(actuation)
        model.rows.add_forces(self._multipliers, self._forces)
        return model.nodes.largest_force(self._forces)

    def makes_progress(self) -> bool:
        """Whether the stale factor in use corrects: at held λ it would go on much less than it did.

        Asked after `correct` and `residual`. Notes when the factor is worn out.

        Returns:
            False when the correction must not be kept.
        """
        left = self._model.factorization.solve(self._forces)
        way_left = self._model.nodes.longest(left)
        if way_left <= self._no_way:
            return True
        self.is_worn = not way_left <= WORN_CONTRACTION * self._last_way
        return way_left <= GREATEST_CONTRACTION * self._last_way

    def _gather_forces(self, positions: np.ndarray) -> None:
        """Sum b = p - F(q) and the rows H, δ of all terms; A stays as it is."""
        self._forces[:] = 0.0
        self.inverted_count = sum(
            term.add_forces(positions, self._forces) for term in self._model.forces
        )
        self._model.rows.evaluate(positions)

    def _assemble(self, positions: np.ndarray, tensions: np.ndarray, projected: bool) -> None:
        """Sum b = p - F(q), A and the rows H, δ of all terms."""
        model = self._model
        storage = model.factorization.storage
        self._forces[:] = 0.0
        model.factorization.clear()
        for term in model.forces:
            term.add(positions, self._forces, storage, projected)
        first = 0
        for term in model.actuators.terms:
            rows = slice(first, first + term.row_count)
            term.add_stiffness(positions, tensions[rows], storage)
            first = rows.stop
        model.rows.evaluate(positions)

    def touching(self, actuation: Actuation):
        """Contacts that carry force: None, where nothing can touch."""
        return None
