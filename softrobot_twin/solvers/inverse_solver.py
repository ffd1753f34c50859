"""Solves the inverse problems of one robot, one step after another.

Little changes from one step to the next. Therefore the active set of the last solution is tried
first: one small system of equations, whose result is accepted only where all optimality conditions
hold (`warm_start`). Only where this fails, a general solver is used: DAQP for a quadratic program,
pivoting over the branches where there are contacts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.solvers.inverse_problem import tracking_and_energy
from softrobot_twin.solvers.pivoting import MOST_PROGRAMS, WARM_START, never, solve_by_pivoting
from softrobot_twin.solvers.qpcc import QPCC, QPCCSolution
from softrobot_twin.solvers.quadratic_program import DAQPSolver, QPSolution, whiten
from softrobot_twin.solvers.warm_start import objective_at, optimum_from_active_set

# A dual below this share of the largest is rounding noise.
NO_DUAL = 1.0e-6

NO_CONTACTS, NO_FORCES = np.zeros(0, dtype=bool), np.zeros(0)


@njit(**KERNEL, inline="always")
def proved_efforts(
    W, effectors, errors, weights, energy_weight, proximal_weight, centre, violation,
    displacement_min, displacement_max, effort_min, effort_max, is_move, stiffness, reference, held,
    active, sizes,
):  # fmt: skip
    """What `build_inverse_problem` and `optimum_from_active_set` find without contacts.

    Posing such a small problem by array operations would take longer than solving it.

    Args:
        W: Compliance of all rows [m/N], those of the actuators first, shape (k, k).
        effectors: First row of the effectors, and the first one after them.
        errors: δ_e,free less the targets [m], shape (e,).
        weights: Q, weight of each effector row, shape (e,).
        energy_weight: ε.
        proximal_weight: p.
        centre: z̄ [N], shape (a,).
        violation: δ_a,free [m], shape (a,).
        displacement_min: Least displacements [m], shape (a,).
        displacement_max: Greatest ones [m], shape (a,).
        effort_min: Least efforts [N], shape (a,).
        effort_max: Greatest ones [N], shape (a,).
        is_move: Whether the unknown of each actuator is its move, shape (a,).
        stiffness: ρ of each actuator, see `with_effort_rows`; zero without an augmented tangent,
            shape (a,).
        reference: δ_ref of each [m], shape (a,).
        held: Unknowns when the actuators stay, shape (a,): with moves, as `solve_by_pivoting` does,
            only what is better is proved.
        active: Active bounds in the guess, of efforts, of displacements, and of the efforts of
            augmented actuators, shape (2 a + k,).
        sizes: Large displacement of each actuator in its unit, shape (a,).

    Returns:
        Whether they are proved; the efforts [N], shape (a,); and the active bounds.
    """
    count = len(violation)
    motion, A = W[effectors[0] : effectors[1], :count].copy(), W[:count, :count].copy()
    more = len(active) - 2 * count
    rows, least, most = np.empty((count + more, count)), effort_min.copy(), effort_max.copy()
    lower, upper, k = np.empty(count + more), np.empty(count + more), count
    for i in range(count):
        for j in range(count):
            rows[i, j] = A[i, j]
        lower[i] = displacement_min[i] - violation[i]
        upper[i] = displacement_max[i] - violation[i]
        if is_move[i]:
            least[i], lower[i] = lower[i], least[i]
            most[i], upper[i] = upper[i], most[i]
        elif stiffness[i] != 0.0:
            if k == len(rows):
                return False, least, active
            shift = stiffness[i] * (violation[i] - reference[i])
            for j in range(count):
                rows[k, j] = -stiffness[i] * A[i, j]
            rows[k, i] += 1.0
            lower[k], upper[k] = least[i] + shift, most[i] + shift
            least[i], most[i], k = -np.inf, np.inf, k + 1
    if k < len(rows):
        return False, least, active
    none, no_rows = np.empty(0), np.empty((0, count))
    P, g = tracking_and_energy(
        motion, A, is_move[:count], errors, weights, energy_weight, proximal_weight, centre, sizes
    )
    proved, efforts, objective, _, active, _ = optimum_from_active_set(
        P, g, least, most, rows, lower, upper, no_rows, none, none,
        np.empty(0, dtype=np.bool_), active,
    )  # fmt: skip
    if proved and is_move.any():
        proved = objective < objective_at(P, g, held)
    return proved, efforts, active


class InverseSolver:
    """Finds the optimum of each problem, starting from the last active set.

    Attributes:
        qp_solver: General solver of quadratic programs.
        uses_warm_start: False where the general solvers themselves are studied.
    """

    def __init__(self, most_programs: int = MOST_PROGRAMS, is_exact: bool = False):
        """Start without a last solution.

        Args:
            most_programs: Programs that one problem with contacts may solve.
            is_exact: True to solve problems without contacts to round-off too, by the search that
                solves those with contacts: where contacts come and go, what a general solver
                leaves at its tolerance would keep a robot from coming to rest.
        """
        self._is_exact = is_exact
        self.qp_solver: Any = DAQPSolver()
        self._most_programs = most_programs
        self.uses_warm_start = True
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, so that a run can be repeated to the bit."""
        self.active: np.ndarray | None = None

    @property
    def guess(self) -> np.ndarray | None:
        """The last active set, where a problem without contacts may be solved from it; else None."""
        return self.active if self.uses_warm_start else None

    def solve(
        self,
        problem: QPCC,
        held: np.ndarray,
        touching: np.ndarray = NO_CONTACTS,
        last: np.ndarray | None = None,
        expired: Callable[[], bool] = never,
        second_start: Callable[[np.ndarray], np.ndarray | None] | None = None,
    ) -> QPCCSolution:
        """Solve one problem.

        Args:
            problem: The problem.
            held: z when the actuators stay, shape (n,); admissible where there are contacts.
            touching: Contacts that touch then, shape (contact_count,).
            last: Contacts that touched in the last solution, shape (contact_count,).
            expired: Called before each program of a search; True when the time is over.
            second_start: See `solve_by_pivoting`; not called without contacts.

        Returns:
            The solution; not solved, with the held z, where there is none.
        """
        if problem.contact_count == 0 and not self._is_exact:
            solution = self._solve_program(problem, held)
        else:
            solution = solve_by_pivoting(
                problem, held, touching, last, self._most_programs, self.active, expired,
                second_start=second_start,
            )  # fmt: skip
        self.active = solution.active
        return solution

    def _solve_program(self, problem: QPCC, held: np.ndarray) -> QPCCSolution:
        """Solve a problem without contacts."""
        count = len(problem.g) + len(problem.row_lower)
        active = self.active
        if active is None or len(active) != count:
            active = np.zeros(count, dtype=np.int64)
        if self.uses_warm_start:
            proved, z, objective, _, active, _ = optimum_from_active_set(
                *problem, NO_CONTACTS, active
            )
            if proved:
                return _solution(problem, z, objective, active, WARM_START)
        found = self._from_general_solver(problem)
        if found is None:
            return _solution(problem, held, problem.objective(held), np.zeros(count, dtype=np.int64), "")
        z = np.minimum(np.maximum(found.unknowns, problem.lower), problem.upper)
        return _solution(problem, z, problem.objective(z), _active_set(problem, found), found.solver)

    def _from_general_solver(self, problem: QPCC) -> QPSolution | None:
        if not problem.is_finite:
            return None
        try:
            whitened = whiten(problem)
        except np.linalg.LinAlgError:
            return None
        found = self.qp_solver.solve(whitened)
        return found if found.solved else None


def _active_set(problem: QPCC, found: QPSolution) -> np.ndarray:
    """Bounds with a dual, those of unknowns before those of rows."""
    duals, m = found.duals, len(problem.row_lower)
    significant = np.abs(duals) > NO_DUAL * np.abs(duals).max(initial=0.0)
    signs = np.where(significant, np.sign(duals), 0.0).astype(np.int64)
    return np.concatenate([signs[m:], signs[:m]])


def _solution(problem: QPCC, z, objective, active, solver: str) -> QPCCSolution:
    return QPCCSolution(
        z, NO_CONTACTS, solver != "", objective, NO_FORCES, np.zeros(len(problem.row_lower)), 1, 0, active,
        solver,
    )  # fmt: skip
