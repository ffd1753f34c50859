"""Decomposition with single pivoting for a QPCC (Coevoet 2017, section 5.2.2).

Start from a branch: the contacts that touch at held actuation, or those of the last step. Solve it
exactly. Look at the degenerate contacts, those with neither force nor gap, where two branches meet.
Where a dual says that the other branch has a lower objective, change to it, the largest dual first,
and keep what lowers the objective. No branch is solved twice, and each kept one is lower than all
before by more than round-off; hence the search ends, however degenerate the problem is. Among the
many local minima it stays at the one of the robot's present state, which is a continuous function
of the problem until it ceases to be a minimum.

Little changes from step to step: where the active bounds of the last solution are given, the
solution is guessed from them first, and accepted where it is proved (`warm_start`).

Where no dual is positive, the solution is *strongly stationary*: it minimises the convex problem in
which the degenerate contacts may have both force and gap, hence it is a local minimum. Where duals
are positive but no single change helps, this convex problem is solved: if its optimum is no lower,
the solution is a local minimum all the same (*B-stationary*); otherwise its optimum says which
contacts must change together.

A robot that leans on an obstacle may be at a local minimum that it would leave if it let go. Where a
caller says so, the search begins a second time, from a branch that the caller names, and what it
finds is kept if it is much lower: lower by less, the robot stays where it is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.solvers.qpcc import (
    AS_GOOD,
    QPCC,
    Branch,
    BranchSolver,
    ProgramBudget,
    QPCCSolution,
)
from softrobot_twin.solvers.warm_start import optimum_from_active_set

# In shares of the problem's size: a force or a gap below it counts as zero. It is wide because a
# missed degenerate contact is a missed pivot, and one too many costs only one more program.
DEGENERATE = 1.0e-7
# A dual below it does not promise a lower objective.
IMPROVING = 1.0e-9
MOST_PROGRAMS = 50
# What a second start finds is kept where its objective, from the least one without any bound, is below
# this share of the first one's.
MUCH_LOWER = 0.5

WARM_START, PIVOTING = "warm start", "pivoting"


def never() -> bool:
    """No limit in time."""
    return False


def solve_by_pivoting(
    problem: QPCC,
    held: np.ndarray,
    touching: np.ndarray,
    last: np.ndarray | None = None,
    most_programs: int = MOST_PROGRAMS,
    active: np.ndarray | None = None,
    expired: Callable[[], bool] = never,
    second_start: Callable[[np.ndarray], np.ndarray | None] | None = None,
) -> QPCCSolution:
    """A local minimum, from the held actuation.

    Args:
        problem: The problem; `check` it where it does not come from a builder.
        held: z when the actuators stay: admissible, with the contact forces that belong to it,
            shape (n,).
        touching: Contacts that touch then, shape (contact_count,).
        last: Contacts that touched in the last step's solution, tried first,
            shape (contact_count,).
        most_programs: Quadratic programs that may be solved.
        active: Active bounds of the last solution, see `QPCCSolution.active`. Where nearly the
            same are active now, the solution is found, and proved, without a quadratic program.
        expired: Called before each program; True when the time is over.
        second_start: Called with z of the local minimum; gives the contacts that touch where the
            search begins a second time, shape (contact_count,), or None where z is good enough.

    Returns:
        The solution: never worse than `held`, which it is when nothing better was found in time.
    """
    budget = ProgramBudget(most_programs, expired)
    touching = touching.astype(bool)
    first = None
    if last is not None:
        last = last.astype(bool)
        first = _from_last(problem, held, last, active, budget)
        if first is not None and second_start is None:
            return first
    if first is None and not (problem.is_finite and np.isfinite(held).all()):
        return _held(problem, held, touching)
    again = None if first is None else second_start(first.unknowns)
    if first is not None and again is None:
        return first
    try:
        branches = BranchSolver(problem, held, budget)
    except np.linalg.LinAlgError:
        return _held(problem, held, touching) if first is None else first
    descent = _Descent(branches, budget)
    if first is None:
        first = descent.run(held, touching, last)
        if second_start is not None:
            again = second_start(first.unknowns)
    return first if again is None else descent.run_again(again, first)


def _from_last(problem, held, last, active, budget) -> QPCCSolution | None:
    """The solution from the last active set, proved and better than the held one; else None."""
    rows = len(problem.row_lower)
    if active is None or len(active) != len(held) - len(last) + rows or budget.is_over:
        return None
    problem = QPCC(*map(np.ascontiguousarray, problem))
    proved, z, objective, touching, active, pivots = optimum_from_active_set(*problem, last, active)
    if not (proved and objective < problem.objective(held) and budget.spend()):
        return None
    return QPCCSolution(
        z, touching, True, objective, np.zeros(len(last)), np.zeros(rows), budget.spent, pivots, active,
        WARM_START,
    )  # fmt: skip


def _held(problem, held, touching) -> QPCCSolution:
    with np.errstate(invalid="ignore", over="ignore"):
        return QPCCSolution(
            held, touching, False, problem.objective(held), problem.force_excess(held),
            problem.row_excess(held), 0, 0,
            np.zeros(len(held) - len(touching) + len(problem.row_lower), dtype=np.int64),
        )  # fmt: skip


class _Descent:
    """The search: branches solved so far, and the best of them."""

    def __init__(self, branches: BranchSolver, budget: ProgramBudget):
        self._branches = branches
        self._budget = budget
        self._visited: set[bytes] = set()
        self._held = self._best = branches.start()
        self._touching = np.zeros(branches.problem.contact_count, dtype=bool)
        self._pivots = 0
        self._solved_any = False

    def run(self, held, touching, last) -> QPCCSolution:
        """Find a start, descend from it, and return the best."""
        self._touching = touching
        if not self._begin(last):
            return self._solution(held)
        self._descend()
        return self._solution(self._branches.refine(self._best, self._touching))

    def run_again(self, start: np.ndarray, first: QPCCSolution) -> QPCCSolution:
        """Descend from another branch, and return what is found where it is much better.

        Args:
            start: Contacts that touch there, shape (contact_count,).
            first: What the first search found.
        """
        self._best = reached = self._branches.at(first.unknowns)
        self._touching = first.touching
        if not self._solve(start, lambda branch, than: True):
            return first._replace(programs=self._budget.spent)
        self._descend()
        if not self._best.is_much_better_than(reached, MUCH_LOWER):
            return first._replace(programs=self._budget.spent)
        z = self._branches.refine(self._best, self._touching)
        if not self._branches.at(z).is_much_better_than(reached, MUCH_LOWER):
            # Gaps of contacts in a line, nearly dependent, are closed to rounding by a long way.
            z = self._best.unknowns
        return self._solution(z)

    def _solution(self, z: np.ndarray) -> QPCCSolution:
        problem = self._branches.problem
        return QPCCSolution(
            z, self._touching, self._solved_any, problem.objective(z), problem.force_excess(z),
            self._branches.row_excess(z), self._budget.spent, self._pivots,
            self._branches.active(self._best), PIVOTING,
        )  # fmt: skip

    def _begin(self, last) -> bool:
        """Start from the last step's branch if it is better than holding, else from the held."""
        held = self._touching
        # A contact that touches without a force may belong to either branch.
        starts = (held, self._held.forces > 0.0)
        is_other = last is not None and not any(np.array_equal(last, start) for start in starts)
        if is_other and self._solve(last, Branch.is_better_than):
            return True
        if any(self._solve(start, _is_no_worse) for start in starts):
            return True
        return not self._solved_any and self._begin_with_fewer(held)

    def _begin_with_fewer(self, held: np.ndarray) -> bool:
        """Leave out one contact, the one with the least force first.

        Contacts in a line are nearly linearly dependent. The held state, solved less exactly, may
        then be in no branch.
        """
        lightest = np.argsort(self._held.forces, kind="stable")
        for contact in lightest[held[lightest]]:
            fewer = held.copy()
            fewer[contact] = False
            if self._solve(fewer, _is_no_worse):
                return True
        return False

    def _solve(self, touching: np.ndarray, is_enough: Callable[[Branch, Branch], bool]) -> bool:
        """Solve a branch if it is new, and keep it if it is good enough; whether it was kept."""
        name = touching.tobytes()
        if name in self._visited:
            return False
        self._visited.add(name)
        branch = self._branches.solve(touching)
        self._solved_any |= branch is not None
        if branch is None or not is_enough(branch, self._best):
            return False
        self._best, self._touching = branch, touching
        return True

    def _descend(self) -> None:
        """Change branches until no change lowers the objective."""
        while True:
            degenerate, improving = self._degenerate_contacts()
            if not len(improving):
                return
            if not any(self._change([contact]) for contact in improving):
                is_alone = len(degenerate) == 1 and not self._budget.is_over
                if is_alone or not self._change_together(degenerate):
                    return
            self._pivots += 1

    def _change_together(self, degenerate: np.ndarray) -> bool:
        """Change several contacts as the convex problem over all their branches says; whether it helped."""
        undecided = np.zeros(len(self._touching), dtype=bool)
        undecided[degenerate] = True
        around = self._branches.solve(self._touching, undecided)
        if around is None or not around.is_better_than(self._best):
            return False
        wanted = around.forces[degenerate] > around.gaps[degenerate]
        return self._change(degenerate[wanted != self._touching[degenerate]])

    def _change(self, contacts) -> bool:
        """Solve the branch in which these contacts make the other choice."""
        touching = self._touching.copy()
        touching[contacts] = ~touching[contacts]
        return self._solve(touching, Branch.is_better_than)

    def _degenerate_contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Contacts with neither force nor gap; and those of them whose dual promises a lower
        objective, the largest dual first."""
        best = self._best
        open_side = np.where(self._touching, best.forces, best.gaps)
        degenerate = (open_side <= DEGENERATE).nonzero()[0]
        if not len(degenerate):
            return degenerate, degenerate
        duals = np.where(self._touching, best.gap_duals, best.force_duals)
        improving = degenerate[duals[degenerate] > IMPROVING]
        return degenerate, improving[np.argsort(-duals[improving], kind="stable")]


def _is_no_worse(branch: Branch, than: Branch) -> bool:
    return not than.is_better_than(branch, AS_GOOD)
