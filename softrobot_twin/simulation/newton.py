"""One linearization of the statics: Coevoet 2017, eq. (9) to (15).

    A dq = b + Hᵀλ,   A = ∂F/∂q (and the stiffness of taut cables),   b = p - F(q)     (9, 10)
    A dq_free = b,    δ_free = δ(q) + H dq_free                                         (11-13)
    W = H A⁻¹ Hᵀ                                                                        (14)
    λ from an optimisation over W and δ_free                                            (16-18)
    dq = A⁻¹ (b + Hᵀλ)                                                                  (15)
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.actuation import Linearized
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.stage_clock import StageClock
from softrobot_twin.solvers.factorization import NodeRows

# No node moves further than this share of the body's size in one linearization.
LONGEST_MOVE = 0.1
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
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._model = model
        self._forces = np.zeros((len(model.body.free_nodes), 3))
        self._multipliers = np.zeros(model.rows.row_count)
        rows = model.rows
        self._H = NodeRows(rows.row_index, rows.node_index, rows.blocks, rows.row_count)
        self._actuators = slice(0, model.cables.row_count if model.cables else 0)
        self._effectors = slice(self._actuators.stop, rows.row_count)
        self._step_limit = LONGEST_MOVE * model.body.size
        self.projected_tangent = False
        self.inverted_count = 0
        self.forget()
        self._gather_forces(model.body.mesh.node_positions)
        self.constant_load = float(np.linalg.norm(self._forces, axis=1).sum())

    def forget(self) -> None:
        """Forget what earlier states taught: the next linearization starts from nothing."""
        self.factor_age: int | None = None
        self._projections_left = 0

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
            self.factor_age = 0
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
        model = self._model
        condensed = model.factorization.condense(self._H, self._forces)
        violation = model.rows.values + condensed.free
        a, e = self._actuators, self._effectors
        linear = Linearized(
            condensed.W[a, a], condensed.W[e, a], violation[a], violation[e], model.rows.values[e]
        )
        clock.mark("condense")
        return linear

    def correct(self, positions: np.ndarray, tensions: np.ndarray) -> float:
        """Move the nodes by A⁻¹ (b + Hᵀλ), eq. (15).

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            tensions: λ_a [N], shape (actuator_count,).

        Returns:
            Share of the move that was made: one, less where it was too long for a
            linearization, zero where it was not finite.
        """
        self._multipliers[self._actuators] = tensions
        move = self._model.factorization.expand(self._multipliers)
        longest = longest_row(move)
        if not np.isfinite(longest):
            return 0.0
        share = min(1.0, self._step_limit / longest) if longest > 0.0 else 1.0
        positions[self._model.body.free_nodes] += share * move
        return share

    def residual(self, positions: np.ndarray, tensions: np.ndarray) -> float:
        """Largest force out of balance on a node, p - F(q) + Hᵀλ [N]; counts inverted elements."""
        model = self._model
        self._gather_forces(positions)
        self._multipliers[self._actuators] = tensions
        model.rows.add_forces(self._multipliers, self._forces)
        return longest_row(self._forces)

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
        if model.cables is not None:
            model.cables.add_stiffness(positions, tensions, storage)
        model.rows.evaluate(positions)


def longest_row(vectors: np.ndarray) -> float:
    """Length of the longest of some vectors, shape (count, 3); not finite if one is not."""
    squares = np.einsum("ni,ni->n", vectors, vectors)
    return float(np.sqrt(np.max(squares, initial=0.0)))
