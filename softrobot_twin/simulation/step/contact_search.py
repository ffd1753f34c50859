"""Solves the problems of an inverse one after the other, from what touched in the one before."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.solvers.inverse_solver import InverseSolver
from softrobot_twin.solvers.qpcc import QPCC, QPCCSolution

# Programs that one linearization may solve; each takes some tens of microseconds.
MOST_PROGRAMS = 30
# After each second start in vain, twice as many linearizations pass without one, and at most these.
LONGEST_WAIT = 7


class ContactSearch:
    """Finds the optimum of each problem, and which contacts press in it.

    Attributes:
        solver: Finds it from the last active set.
        touching: Whether each contact pressed in the last solution, by its key; None before the first.
    """

    def __init__(self, tolerance: float, is_exact: bool = True):
        """Begin without a last solution.

        Args:
            tolerance: What effectors may miss until the search begins a second time [m].
            is_exact: See `InverseSolver`.
        """
        self._tolerance, self.solver = tolerance, InverseSolver(MOST_PROGRAMS, is_exact)
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, and the contacts that bore it."""
        self.solver.reset()
        self.touching: dict[tuple[int, int], bool] | None = None
        self._wait = self._next_wait = 0

    @property
    def memory(self) -> tuple:
        """All that the next solution begins from."""
        return self.solver.active, self.touching, self._wait, self._next_wait

    @memory.setter
    def memory(self, memory: tuple) -> None:
        self.solver.active, self.touching, self._wait, self._next_wait = memory

    def solve(
        self, problem: QPCC, held: np.ndarray, taut: np.ndarray, forces: np.ndarray,
        keys: list[tuple[int, int]], missed: Callable[[np.ndarray], float],
    ) -> QPCCSolution:  # fmt: skip
        """Solve a problem, from an admissible actuation and from what touched in the last solution.

        Where contacts press and effectors miss what is asked of them, from the branch too in which
        all contacts with bodies are open.

        Args:
            problem: The problem.
            held: z when the actuators stay, shape (n,).
            taut: Efforts of commanded actuators then [N], shape (commanded_count,).
            forces: λ of contacts then [N], shape (contact_row_count,).
            keys: By which contacts are recognised in the next problem.
            missed: What effectors miss by a solution [m]; NaN where no contact presses in it.
        """
        touching = np.concatenate([taut, forces]) > 0.0
        last = None
        if self.touching is not None and len(keys) == len(forces):
            before = [self.touching.get(key, False) for key in keys]
            last = np.concatenate([taut > 0.0, np.array(before, dtype=bool)])
        missing: np.ndarray | None = None

        def second_start(z: np.ndarray) -> np.ndarray | None:
            nonlocal missing
            if not self._begins_again(missed(z)):
                return None
            missing = z
            start = problem.forces(z) > 0.0
            start[len(taut) :] = False
            return start

        solution = self.solver.solve(
            problem, held, touching, last, second_start=second_start if len(forces) else None
        )
        if missing is not None:
            is_in_vain = solution.unknowns is missing
            self._next_wait = min(2 * self._next_wait + 1, LONGEST_WAIT) if is_in_vain else 0
            self._wait = self._next_wait
        self.touching = dict(zip(keys, solution.touching[len(taut) :].tolist(), strict=True))
        return solution

    def _begins_again(self, missed: float) -> bool:
        """Whether the search begins a second time, by what effectors miss [m]."""
        if missed <= self._tolerance:
            self._wait = self._next_wait = 0
        if not missed > self._tolerance:
            return False
        self._wait -= 1
        return self._wait < 0
