"""Decomposition with single pivoting (Coevoet 2017, section 5.2.2).

Start from a piece, the contacts that touch at held actuation or those of the last step; solve it
exactly; look at the contacts with neither force nor gap, where two pieces meet; where the dual says
that the other piece goes lower, change to it, the largest dual first, and keep what lowers the
objective. No piece is solved twice and each kept one is lower than all before by more than
round-off, so it ends, whatever the degeneracy. Among the pieces' many minima it stays at the one
that the robot is in, which changes with the problem continuously until it ceases to be one.

From step to step little changes: where the last answer's bounds are given, the answer is guessed
from them first, and taken where that is proved (`guessed_bounds`).

Where no dual calls, the answer is *strongly stationary*: it minimises the convex problem in which
those contacts may have both force and gap, hence is a local minimum. Where duals call but no single
change helps, that convex problem is solved: if it goes no lower, the answer is a local minimum all
the same (*B-stationary*); else its optimum tells which contacts to change together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.solvers.complementarity_pieces import AS_GOOD, Piece, PieceSolver
from softrobot_twin.solvers.complementarity_problem import ComplementarityProblem
from softrobot_twin.solvers.complementarity_solution import ComplementaritySolution, Stationarity
from softrobot_twin.solvers.guessed_bounds import optimum_by_guess
from softrobot_twin.solvers.program_budget import Budget

# In shares of the problem's size: below it a force or a gap is taken for zero. Wide, for one missed
# is a pivot missed, and one too many a program more.
DEGENERATE = 1.0e-7
# A dual below it does not call.
CALLING = 1.0e-9
MOST_PROGRAMS = 50


def _never() -> bool:
    return False


def solve_by_pivoting(
    problem: ComplementarityProblem,
    held: np.ndarray,
    touching: np.ndarray,
    last: np.ndarray | None = None,
    most_programs: int = MOST_PROGRAMS,
    binding: np.ndarray | None = None,
    expired: Callable[[], bool] = _never,
    look_around: bool = False,
) -> ComplementaritySolution:
    """A local minimum, from the held actuation.

    Args:
        problem: The problem; `check` it where it does not come from a builder.
        held: z when the actuators stay: admissible, with the contact forces that belong to it,
            shape (n,).
        touching: Contacts that touch then, shape (contact_count,).
        last: Contacts that touched in the last step's answer, tried first, shape (contact_count,).
        most_programs: Quadratic programs that may be solved.
        binding: Bounds that bound in the last answer: where nearly the same do in this one, it is
            found, and proved, without a quadratic program; see `guessed_bounds`.
        expired: Asked before each; True when time is over.
        look_around: Whether to solve also the pieces in which one contact chooses otherwise though
            nothing calls it, and go on from there: more often the global minimum, for a program
            more by contact.

    Returns:
        The answer: never worse than `held`, which it is when nothing better was found in time.
    """
    budget = Budget(most_programs, expired)
    touching = touching.astype(bool)
    if last is not None:
        last = last.astype(bool)
        again = _guessed(problem, held, last, binding, budget)
        if again is not None:
            return again
    if not (problem.is_finite and np.isfinite(held).all()):
        return _held_out(problem, held, touching)
    try:
        pieces = PieceSolver(problem, held, budget)
    except np.linalg.LinAlgError:
        return _held_out(problem, held, touching)
    return _Descent(pieces, budget).run(held, touching, last, look_around)


def _guessed(problem, held, last, binding, budget) -> ComplementaritySolution | None:
    """The answer from what bound in the last one, proved and better than the held; else None."""
    rows = len(problem.row_lower)
    if binding is None or len(binding) != len(held) - len(last) + rows or budget.is_over:
        return None
    problem = ComplementarityProblem(*map(np.ascontiguousarray, problem))
    proved, z, objective, touching, binding, pivots = optimum_by_guess(*problem, last, binding)
    held_objective = problem.objective(held) if proved else 0.0
    if not (proved and objective < held_objective and budget.spend()):
        return None
    return ComplementaritySolution(
        z, touching, True, Stationarity.STRONG, objective, held_objective, np.zeros(len(last)),
        np.zeros(rows), budget.spent, pivots, binding,
    )  # fmt: skip


def _held_out(problem, held, touching) -> ComplementaritySolution:
    with np.errstate(invalid="ignore", over="ignore"):
        return ComplementaritySolution(
            held, touching, False, Stationarity.HELD, problem.objective(held),
            problem.objective(held), problem.force_excess(held), problem.row_excess(held), 0, 0,
            np.zeros(len(held) - len(touching) + len(problem.row_lower), dtype=np.int64),
        )  # fmt: skip


class _Descent:
    """The pieces seen so far, and the best."""

    def __init__(self, pieces: PieceSolver, budget: Budget):
        self._pieces = pieces
        self._budget = budget
        self._visited: set[bytes] = set()
        self._held = self._best = pieces.start()
        self._touching = np.zeros(pieces.problem.contact_count, dtype=bool)
        self._pivots = 0
        self._answered = False

    def run(self, held, touching, last, look_around) -> ComplementaritySolution:
        """Start, descend, and tell."""
        self._touching = touching
        improved = self._begin(last)
        stationarity = self._descend() if improved else Stationarity.HELD
        while improved and look_around and self._leap():
            self._pivots += 1
            stationarity = self._descend()
        problem = self._pieces.problem
        z = self._pieces.refine(self._best, self._touching) if improved else held
        return ComplementaritySolution(
            z, self._touching, self._answered, stationarity, problem.objective(z),
            problem.objective(held), problem.force_excess(z), self._pieces.row_excess(z),
            self._budget.spent, self._pivots, self._pieces.binding(self._best),
        )  # fmt: skip

    def _begin(self, last) -> bool:
        """Start from the last step's piece where it is better than holding, else from the held."""
        held = self._touching
        # Contacts that touch without a force may belong to either piece.
        starts = (held, self._held.forces > 0.0)
        is_other = last is not None and not any(np.array_equal(last, start) for start in starts)
        if is_other and self._solve(last, Piece.is_better_than):
            return True
        if any(self._solve(start, _is_no_worse) for start in starts):
            return True
        return not self._answered and self._begin_with_fewer(held)

    def _begin_with_fewer(self, held: np.ndarray) -> bool:
        """Leave out one contact, the lightest first: contacts in a line nearly follow from each
        other, and what was held, solved less exactly, may then be in no piece."""
        lightest = np.argsort(self._held.forces, kind="stable")
        for contact in lightest[held[lightest]]:
            fewer = held.copy()
            fewer[contact] = False
            if self._solve(fewer, _is_no_worse):
                return True
        return False

    def _solve(self, touching: np.ndarray, is_enough: Callable[[Piece, Piece], bool]) -> bool:
        """Solve a piece, if it is new, and keep it if it is good enough."""
        name = touching.tobytes()
        if name in self._visited:
            return False
        self._visited.add(name)
        piece = self._pieces.solve(touching)
        self._answered |= piece is not None
        if piece is None or not is_enough(piece, self._best):
            return False
        self._best, self._touching = piece, touching
        return True

    def _descend(self) -> Stationarity:
        """Change pieces until nothing goes lower."""
        while True:
            degenerate, calling = self._at_the_corner()
            if not len(calling):
                return Stationarity.STRONG
            if any(self._change([contact]) for contact in calling):
                self._pivots += 1
                continue
            if len(degenerate) == 1 and not self._budget.is_over:
                return Stationarity.BOULIGAND
            together = self._change_together(degenerate)
            if together is not None:
                return together
            self._pivots += 1

    def _leap(self) -> bool:
        """Change one contact wherever it stands, those with the least force or gap first."""
        nearest = np.argsort(np.where(self._touching, self._best.forces, self._best.gaps))
        return any(self._change([contact]) for contact in nearest)

    def _change_together(self, degenerate: np.ndarray) -> Stationarity | None:
        """Change several contacts as the convex problem around all their pieces has it.

        Returns:
            None where that goes lower; else what is then known of the best.
        """
        open_choice = np.zeros(len(self._touching), dtype=bool)
        open_choice[degenerate] = True
        around = self._pieces.solve(self._touching, open_choice)
        if around is None:
            return Stationarity.BUDGET if self._budget.is_over else Stationarity.SINGLE
        if not around.is_better_than(self._best):
            return Stationarity.BOULIGAND
        wanted = around.forces[degenerate] > around.gaps[degenerate]
        others = degenerate[wanted != self._touching[degenerate]]
        if self._change(others):
            return None
        return Stationarity.BUDGET if self._budget.is_over else Stationarity.SINGLE

    def _change(self, contacts) -> bool:
        """Solve the piece in which these contacts choose otherwise."""
        touching = self._touching.copy()
        touching[contacts] = ~touching[contacts]
        return self._solve(touching, Piece.is_better_than)

    def _at_the_corner(self) -> tuple[np.ndarray, np.ndarray]:
        """Contacts with neither force nor gap; those whose dual calls, the loudest first."""
        best = self._best
        open_side = np.where(self._touching, best.forces, best.gaps)
        degenerate = (open_side <= DEGENERATE).nonzero()[0]
        if not len(degenerate):
            return degenerate, degenerate
        duals = np.where(self._touching, best.gap_duals, best.force_duals)
        calling = degenerate[duals[degenerate] > CALLING]
        return degenerate, calling[np.argsort(-duals[calling], kind="stable")]


def _is_no_worse(piece: Piece, than: Piece) -> bool:
    return not than.is_better_than(piece, AS_GOOD)
