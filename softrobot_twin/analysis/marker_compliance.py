"""What markers and sensors show of forces at observed places, while actuators hold what they hold."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.analysis.apparent_compliance import CondensedHold, HeldTangent
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.observed_loads import ObservedLoads
from softrobot_twin.simulation.effects.observed_forces import ObservedRows
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.simulation.step.apparent_stiffness import SHARING
from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal

# Where a step left markers further from balance than this share of the robot's size, what they yield is
# found by the stiffness there, and not by that where the step began.
FAR = 0.001


class MarkerMoves(NamedTuple):
    """What moves the measured quantities around one state; see `ObservedRows`.

    Attributes:
        by_loads: Motion by each number of the loads [m/N] and [m/(N m)], shape
            (3 quantity_count, load_count).
        by_actuators: Motion by each actuator with a row that holds its displacement, or is driven by
            its effort, each up to a factor, shape (3 quantity_count, n).
        lag: What the last step left to move [m], shape (3 quantity_count,).
    """

    by_loads: np.ndarray
    by_actuators: np.ndarray
    lag: np.ndarray


class MarkerCompliance(HeldTangent):
    """Computes the compliance of markers and sensors at the present state of a simulation with an observer.

    Attributes:
        rows: Rows of the quantities and of the places.
    """

    def __init__(self, simulation: Simulation):
        """Lay the rows out.

        Args:
            simulation: The simulation.
        """
        super().__init__(simulation)
        self.rows = ObservedRows(simulation.model, simulation.model.force_term(ObservedLoads).places, True)
        self._take_rows()
        self._of_step = self._beside_step = None

    def _take_rows(self) -> None:
        self.own_rows = self.rows.stack

    def at_state(self, points: np.ndarray, may_be_slow: bool = True) -> MarkerMoves | None:
        """What quantities yield, and how far they are from balance, by one linearization.

        By the factorization of the last step where it has that of statics; see
        `EffectorCompliance.after_step`.

        Args:
            points: Index of the point of each place, shape (place_count,).
            may_be_slow: Whether an indefinite tangent, as of a body that buckles, is factorized with
                what holds it: that takes a hundred times as long.

        Returns:
            What moves the quantities; None where that would take too long, or the equations have no
            finite solution.
        """
        if self.rows.choose(points):
            self._take_rows()
        positions = self._simulation.state.positions
        holding = self._holding()
        rows = self._rows(positions, holding)
        left, apart = self._left(holding)
        factorization, is_slow = self._factorization(positions, holding), not self._may_be_definite
        if not (factorization or is_slow or may_be_slow):
            return None
        try:
            moves = self._moves(factorization, rows, holding, left, apart)
            if factorization and np.abs(moves.lag).max() > FAR * self._model.nodes.size:
                # So far from balance the tangent is another one than where the step began.
                here = self._definite(positions)
                if here or may_be_slow:
                    moves = self._moves(here, rows, holding, left, apart)
        except np.linalg.LinAlgError:
            return None
        moves = moves._replace(by_loads=moves.by_loads @ self.rows.basis(positions))
        return moves if all(np.isfinite(part).all() for part in moves) else None

    def places_at(self, points: np.ndarray) -> np.ndarray:
        """Where the loads act at the present state [m], shape (place_count, 3).

        Args:
            points: See `at_state`.
        """
        if self.rows.choose(points):
            self._take_rows()
        return self.rows.places_at(self._simulation.state.positions)

    def _moves(
        self, factorization: Factorization | None, rows, holding, left: np.ndarray,
        apart: np.ndarray,
    ) -> MarkerMoves:  # fmt: skip
        """Motion of the quantities by forces at the rows of places, by actuators, and by what is left.

        Args:
            factorization: A⁻¹; None where only the saddle has a solution.
            rows: The rows.
            holding: What holds.
            left: Forces out of balance [N], shape (free_node_count, 3).
            apart: Displacements that what holds is apart, shape (held_count,).
        """
        count, h = len(holding.held) + len(holding.contacts), holding.places
        own, held = self.rows.row_count, np.count_nonzero(holding.held)
        driven = np.flatnonzero(holding.is_by_effort & ~holding.held)
        if not factorization:
            saddle = self._saddle(rows, holding)
            H = saddle.H.toarray()
            E = H[count:]
            below = np.column_stack([np.zeros((len(h), len(E) + len(driven))), apart])
            unknowns, multipliers = saddle.solve(
                np.column_stack([E.T, H[driven].T, left.ravel()]), below)
            moves, by_held = E @ unknowns, multipliers[:, : len(E)]
            by_driven = moves[:own, len(E) : -1]
        else:
            W, free = factorization.condense(rows.H, left)
            moves, by_held = _released(W, free, h, holding.own_of_places, apart, count)
            # W is symmetric: what a row is held by tells how it follows what holds it.
            by_driven = W[count : count + own, driven] + by_held[:, :own].T @ W[np.ix_(h, driven)]
        by_actuators = np.column_stack([by_held[:held, :own].T, by_driven])
        parts = moves[:own, own : len(moves)], by_actuators, moves[:own, -1]
        return MarkerMoves(*map(self.rows.of_quantities, parts))

    def _left(self, holding) -> tuple[np.ndarray, np.ndarray]:
        """What the last step left: forces out of balance [N], and displacements of what holds."""
        model, state = self._model, self._simulation.state
        forces, apart = self._simulation.newton.balance.forces, np.zeros(len(holding.places))
        if model.is_dynamic:
            return np.zeros_like(forces), apart
        a = model.rows.groups.actuators
        off = model.actuators.drives(state.setpoints)[a] - model.rows.actuator_paths(state.efforts[a])
        is_set = holding.held & ~model.actuators.is_effort_driven[a]
        apart[: np.count_nonzero(holding.held)] = np.where(is_set, off, 0.0)[holding.held]
        return forces, apart

    def _factorization(self, positions: np.ndarray, holding) -> Factorization | None:
        """A⁻¹ of statics while what holds holds; None where it is not definite."""
        found = self._simulation.newton.tangent.held_factorization(holding.held)
        if not found:
            return self._definite(positions)
        if isinstance(found, Multifrontal) and found is not self._of_step:
            self._of_step, self._beside_step = found, found.with_other_rows()
        return self._beside_step if found is self._of_step else found

    def by_candidates(self, place: int) -> np.ndarray:
        """Motion of the quantities by a force at each of the points among which a place is.

        Args:
            place: Index of the place.

        Returns:
            [m/N], shape (point_count, 3 quantity_count, 3).
        """
        positions, nodes = self._simulation.state.positions, self._model.nodes
        holding = self._holding()
        rows = self._rows(positions, holding)
        count, own = len(holding.held) + len(holding.contacts), self.rows.row_count
        H, h = rows.H.transposed(nodes.free_node_count), holding.places
        factorization = self._factorization(positions, holding)
        system = (CondensedHold(factorization, H[:, h].T, holding.own_of_places) if factorization
                  else self._saddle(rows, holding))
        seen, _ = system.solve(H[:, count : count + own], np.zeros((len(h), own)))
        by_node = self.rows.of_quantities(seen.T).T.reshape(nodes.free_node_count, 3, -1)
        points = self.rows.places[place].points
        free = nodes.free_index[points.nodes]
        weights = np.where(free >= 0, points.barycentric_weights, 0.0)
        return np.einsum("pa,paik->pki", weights, by_node[np.maximum(free, 0)])


@njit(**KERNEL)
def _released(W, free, held, own, apart, first):
    """Motion of the rows from `first` on by forces on them, and in the last column by themselves.

    In addition the efforts of what holds, by the same.

    Args:
        W: Compliance of all rows, shape (row_count, row_count).
        free: Their motion when nothing holds, shape (row_count,).
        held: Those that hold, shape (held_count,).
        own: Compliance of what holds, shape (held_count, held_count).
        apart: Displacements that it is apart, shape (held_count,).
        first: The first row that moves.
    """
    n, count = len(held), len(W) - first
    M, right, moves = own.copy(), np.empty((n, count + 1)), np.empty((count, count + 1))
    for i in range(n):
        row = held[i]
        for j in range(n):
            M[i, j] += W[row, held[j]]
        M[i, i] += SHARING * M[i, i] if M[i, i] > 0.0 else 1.0  # See `sharing`.
        right[i, :count], right[i, count] = -W[row, first:], apart[i] - free[row]
    by_held = np.linalg.solve(M, right)
    moves[:, :count], moves[:, count] = W[first:, first:], free[first:]
    for k in range(count):
        for i in range(n):
            moves[k] += W[first + k, held[i]] * by_held[i]
    return moves, by_held
