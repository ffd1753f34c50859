"""Quadratic programs with complementarity constraints, QPCC (Coevoet 2017, eq. 19-22).

    min ½ zᵀPz + gᵀz
    s.t.  lower ≤ z ≤ upper,   row_lower ≤ A z ≤ row_upper,
          0 ≤ λ ⊥ C z + d ≥ 0,   λ ≤ force_max     with λ the last unknowns of z

Without contacts it is a convex quadratic program. With contacts it is not convex: each contact
either presses at gap zero, or is open with force zero. One choice for all contacts selects one
*branch*, which is an ordinary convex program, called QP_I in the paper:

    contact i in I: gap_i = 0, force_i ≥ 0        otherwise: force_i = 0, gap_i ≥ 0

Where the constraints of a branch cannot all be met, they are relaxed in this order: `force_max`
first, then the bounds on rows. `lower` and `upper` are never exceeded, contacts never pull, and
bodies never penetrate. The least excess is found first, then the objective is minimised with no
more than this excess allowed. Both problems are convex, hence the solution is a continuous function
of every bound.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrobot_twin.solvers.polyhedron_projection import (
    PolyhedronProjection,
    Projection,
    SoftBounds,
)

# A size below this share of the widest interval of a row counts as zero.
NEGLIGIBLE = 1.0e-6
# Objectives that differ by less are equal, in the unit of the problem's size squared.
ROUND_OFF = 1.0e-13
# A start that is worse than the held state by less is as good: the held state is no more exact.
AS_GOOD = 1.0e-9
# Excesses that differ by less are equal, in shares of the held one or of the size of the problem.
EQUAL_EXCESS = 1.0e-7
# What is no excess, in shares of the largest row or force, or of their bounds.
ROUNDING = 1.0e-12
# A relaxed bound is widened by this share, so that rounding does not make the next program empty.
MARGIN = 1.0e-9
# Duals of an excess count where they exceed SIGNIFICANT, or SIGNIFICANT_SHARE of the largest. The
# unit is the cost of moving by the problem's own size.
SIGNIFICANT, SIGNIFICANT_SHARE = 10.0, 1.0e-5
# Duals of an excess go before those of the objective by this factor.
PRIORITY = 1.0e6


class QPCC(NamedTuple):
    """The problem, in any units: solvers scale it.

    Attributes:
        P: Hessian, symmetric positive definite, shape (n, n).
        g: Gradient at zero, shape (n,).
        lower: Lower bound of each unknown; zero for contact forces, shape (n,).
        upper: Upper bound; infinite for contact forces, shape (n,).
        A: Further rows with bounds, shape (m, n).
        row_lower: Their lower bounds, shape (m,).
        row_upper: Their upper bounds, shape (m,).
        C: Gap by unknown, shape (contact_count, n).
        d: Gap at zero, shape (contact_count,).
        force_max: Limit of each contact force, shape (contact_count,).
    """

    P: np.ndarray
    g: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    A: np.ndarray
    row_lower: np.ndarray
    row_upper: np.ndarray
    C: np.ndarray
    d: np.ndarray
    force_max: np.ndarray

    @property
    def contact_count(self) -> int:
        """Number of contacts; their forces are the last unknowns."""
        return len(self.d)

    @property
    def is_finite(self) -> bool:
        """False where a number is NaN or infinite; bounds may be infinite."""
        numbers = (self.P, self.g, self.A, self.C, self.d)
        bounds = (self.lower, self.upper, self.row_lower, self.row_upper, self.force_max)
        return all(np.isfinite(array).all() for array in numbers) and not any(
            np.isnan(array).any() for array in bounds
        )

    def objective(self, z: np.ndarray) -> float:
        """½ zᵀPz + gᵀz.

        Args:
            z: The unknowns, shape (n,).
        """
        return float(0.5 * z @ self.P @ z + self.g @ z)

    def whitening(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scale, shape (n,), factor L and T, shape (n, n), of unknowns w with z = T w, by which the
        Hessian is the identity: P = L Lᵀ by z / scale, and w = Lᵀ (z / scale).

        Raises:
            numpy.linalg.LinAlgError: P is not positive definite.
        """
        scale = 1.0 / np.sqrt(self.P.diagonal())
        factor = np.linalg.cholesky(self.P * np.outer(scale, scale))
        return scale, factor, scale[:, None] * np.linalg.inv(factor).T

    def gaps(self, z: np.ndarray) -> np.ndarray:
        """Gaps C z + d, shape (contact_count,).

        Args:
            z: The unknowns, shape (n,).
        """
        return self.C @ z + self.d

    def forces(self, z: np.ndarray) -> np.ndarray:
        """Contact forces: the last unknowns, shape (contact_count,).

        Args:
            z: The unknowns, shape (n,).
        """
        return z[len(z) - self.contact_count :]

    def force_excess(self, z: np.ndarray) -> np.ndarray:
        """Excess of contact forces over their limits, shape (contact_count,).

        Args:
            z: The unknowns, shape (n,).
        """
        return np.maximum(self.forces(z) - self.force_max, 0.0)

    def row_excess(self, z: np.ndarray) -> np.ndarray:
        """Excess of rows over their bounds on either side, shape (m,).

        Args:
            z: The unknowns, shape (n,).
        """
        rows = self.A @ z
        return np.maximum(np.maximum(rows - self.row_upper, self.row_lower - rows), 0.0)

    def size_of(self, unknowns: float, T: np.ndarray) -> float:
        """Size of the problem in unknowns w with z = T w.

        Args:
            unknowns: Order of magnitude of w.
            T: Unknowns by w, shape (n, n).

        Returns:
            This order of magnitude; where it is rounding noise, the widest interval of a row.
        """
        widths = self.row_upper - self.row_lower
        lengths = np.linalg.norm(self.A @ T, axis=1)
        finite = np.isfinite(widths) & (lengths > 0.0)
        widest = float(np.max(widths[finite] / lengths[finite], initial=0.0))
        return unknowns if unknowns > NEGLIGIBLE * widest else widest or 1.0


class QPCCSolution(NamedTuple):
    """An admissible solution.

    Attributes:
        unknowns: z, shape (n,).
        touching: Contacts that the branch holds at gap zero, shape (contact_count,).
        solved: False when no program could be solved; z is then the held one.
        objective: Objective of z.
        force_excess: Excess over `force_max`, zero unless nothing else was admissible,
            shape (contact_count,).
        row_excess: Excess of rows over their bounds, likewise, shape (m,).
        programs: Quadratic programs solved.
        pivots: Changes of the branch that were kept.
        active: Active bounds of unknowns besides contact forces, then of rows: -1 at the lower
            bound, 1 at the upper, 0 at neither, shape (n - contact_count + m,).
        solver: Name of the method that found it; empty where none did.
    """

    unknowns: np.ndarray
    touching: np.ndarray
    solved: bool
    objective: float
    force_excess: np.ndarray
    row_excess: np.ndarray
    programs: int
    pivots: int
    active: np.ndarray
    solver: str = ""


class ProgramBudget:
    """Counts the quadratic programs that a search may still solve."""

    def __init__(self, most: int, expired: Callable[[], bool]):
        """Start with nothing spent.

        Args:
            most: Programs that may be solved.
            expired: Called before each; True when the time is over.
        """
        self.spent = 0
        self._most = most
        self._expired = expired

    def spend(self) -> bool:
        """Take one; False when nothing is left."""
        if self.is_over:
            return False
        self.spent += 1
        return True

    @property
    def is_over(self) -> bool:
        """Whether nothing is left."""
        return self.spent >= self._most or self._expired()


class Optimum(NamedTuple):
    """The optimum in whitened unknowns, with the bounds it was found with.

    Attributes:
        projection: w, and the duals of the objective.
        duals: Duals of the excess, if there is one, plus those of the objective, shape (rows,).
        lower: Lower bounds of all rows, in the problem's units, shape (rows,).
        upper: Upper bounds, shape (rows,).
    """

    projection: Projection
    duals: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class Branch(NamedTuple):
    """The optimum of one branch.

    Attributes:
        unknowns: z in the problem's units, shape (n,).
        misfit: The objective over the square of the problem's size, plus a constant that makes
            it zero where no bound is active.
        row_excess: Norm of the rows' excess, in shares of the largest row.
        force_excess: Norm of the forces' excess, in shares of the largest force.
        optimum: What it was computed from.
        forces: Contact forces in shares of the problem's size, shape (contact_count,).
        gaps: Gaps in shares of the problem's size, shape (contact_count,).
        force_duals: Positive where more force would lower the objective, shape (contact_count,).
        gap_duals: Positive where more gap would lower the objective, shape (contact_count,).
    """

    unknowns: np.ndarray
    misfit: float
    row_excess: float
    force_excess: float
    optimum: Optimum
    forces: np.ndarray
    gaps: np.ndarray
    force_duals: np.ndarray
    gap_duals: np.ndarray

    def is_better_than(self, other: Branch, by: float = ROUND_OFF) -> bool:
        """Whether it is better by more than round-off: excess of rows, of forces, objective.

        Args:
            other: The branch that it is compared with.
            by: Share of the misfit that counts as round-off.
        """
        for mine, others in self._excesses(other):
            if abs(mine - others) > EQUAL_EXCESS:
                return mine < others
        return self.misfit < other.misfit - by * (1.0 + other.misfit)

    def is_much_better_than(self, other: Branch, share: float) -> bool:
        """Whether its misfit is below a share of the other's, and no excess is greater.

        Args:
            other: The branch that it is compared with.
            share: The share, below one.
        """
        is_worse = any(mine > others + EQUAL_EXCESS for mine, others in self._excesses(other))
        return not is_worse and self.is_better_than(other) and self.misfit < share * other.misfit

    def _excesses(self, other: Branch) -> tuple[tuple[float, float], tuple[float, float]]:
        return (self.row_excess, other.row_excess), (self.force_excess, other.force_excess)


class BranchSolver:
    """Solves branches of one problem.

    The problem is whitened once: in unknowns w with z = T w the Hessian is the identity and the
    problem has size one. Branches differ only in their bounds.
    """

    def __init__(self, problem: QPCC, reference: np.ndarray, budget: ProgramBudget):
        """Whiten the problem.

        Args:
            problem: The problem.
            reference: An admissible z, of the solution's order of magnitude, shape (n,).
            budget: What may be spent.

        Raises:
            numpy.linalg.LinAlgError: The Hessian is not positive definite.
        """
        self.problem = problem
        self._budget = budget
        n, m, contacts = len(problem.g), len(problem.row_lower), problem.contact_count
        self._forces = np.arange(n - contacts, n)
        self._rows = np.arange(n, n + m)
        self._gaps = np.arange(n + m, n + m + contacts)
        self._lower = np.concatenate([problem.lower, problem.row_lower, -problem.d])
        self._upper = np.concatenate([problem.upper, problem.row_upper, np.full(contacts, np.inf)])
        self._limited = np.flatnonzero(np.isfinite(problem.force_max))
        scale, factor, T = problem.whitening()
        q, whitened = problem.g @ T, (reference / scale) @ factor
        size = problem.size_of(max(np.linalg.norm(q), np.linalg.norm(whitened)), T)
        self._T, self._scale, self._factor, self._size = T * size, scale, factor, size
        self._geometric = self._geometric_projection(reference)
        self._whitened = PolyhedronProjection(self._stack(self._T), q / size, self._geometric.lengths)
        self._reference = reference
        rows = np.concatenate([problem.A @ reference, problem.row_lower, problem.row_upper])
        self._row_unit = np.abs(rows[np.isfinite(rows)]).max(initial=0.0) or 1.0
        usual = (problem.forces(reference), problem.force_max[self._limited])
        self._force_unit = np.concatenate(usual).max(initial=0.0) or 1.0

    def start(self) -> Branch:
        """The reference itself, as a branch without duals."""
        return self.at(self._reference)

    def at(self, z: np.ndarray) -> Branch:
        """An admissible z as a branch without duals, shape (n,).

        Args:
            z: The unknowns, shape (n,).
        """
        no_duals = np.zeros(len(self._lower))
        start = Projection(self._whiten(z), no_duals)
        return self._branch(z, Optimum(start, no_duals, self._lower, self._upper))

    def solve(self, touching: np.ndarray, undecided: np.ndarray | None = None) -> Branch | None:
        """Solve one branch, or the convex problem that contains several.

        Args:
            touching: Contacts in I, shape (contact_count,).
            undecided: Contacts that may have both a force and a gap, shape (contact_count,).

        Returns:
            Its optimum; None where it is empty or the budget is spent.
        """
        lower, upper = self._bounds(touching, undecided)
        optimum = self._with_least_force_excess(lower, upper)
        if optimum is None and len(self._rows):
            optimum = self._with_least_row_excess(lower, upper)
        if optimum is None:
            return None
        return self._branch(self._within_bounds(optimum.projection.w), optimum)

    def refine(self, branch: Branch, touching: np.ndarray) -> np.ndarray:
        """Meet the equations of a branch's active rows to rounding.

        Args:
            branch: The optimum.
            touching: Contacts in I, shape (contact_count,).

        Returns:
            z, shape (n,).
        """
        optimum = branch.optimum
        z = self._within_bounds(self._whitened.refined(optimum.projection, optimum.lower, optimum.upper))
        forces = self.problem.forces(z)
        forces[~touching] = 0.0
        # A force at its limit is the limit itself, without rounding.
        over = forces - self.problem.force_max
        at_bound = (over > 0.0) & (over < ROUNDING * self._force_unit)
        forces[at_bound] = self.problem.force_max[at_bound]
        return z

    def active(self, branch: Branch) -> np.ndarray:
        """Active bounds, see `QPCCSolution.active`, shape (n - contact_count + m,).

        Args:
            branch: A branch that this solver found.
        """
        duals = np.sign(branch.optimum.projection.duals).astype(np.int64)
        own = len(self.problem.g) - self.problem.contact_count
        return np.concatenate([duals[:own], duals[self._rows]])

    def row_excess(self, z: np.ndarray) -> np.ndarray:
        """Excess of rows over their bounds, without rounding noise, shape (m,).

        Args:
            z: The unknowns, shape (n,).
        """
        excess = self.problem.row_excess(z)
        return np.where(excess > ROUNDING * self._row_unit, excess, 0.0)

    def _stack(self, T: np.ndarray) -> np.ndarray:
        return np.concatenate([T, self.problem.A @ T, self.problem.C @ T])

    def _geometric_projection(self, reference: np.ndarray) -> PolyhedronProjection:
        """Projection of the reference, in unknowns that displace all rows by the same amount.

        These rows are better conditioned than the whitened ones, where directions that only cost
        energy are long: feasible and infeasible bounds are distinguished here.
        """
        reach = np.sqrt((self.problem.A**2).sum(axis=0) + (self.problem.C**2).sum(axis=0))
        scale = 1.0 / np.where(reach > 0.0, reach, 1.0)
        start = reference / scale
        size = max(np.linalg.norm(start), np.abs(self.problem.d).max(initial=0.0))
        size = self.problem.size_of(size, np.diag(scale))
        unit = scale * size
        rows = [np.diag(unit), self.problem.A * unit, self.problem.C * unit]
        return PolyhedronProjection(np.concatenate(rows), -start / size)

    def _bounds(self, touching, undecided) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = self._lower.copy(), self._upper.copy()
        closed, apart = touching, ~touching
        if undecided is not None:
            closed, apart = closed & ~undecided, apart & ~undecided
        upper[self._forces[apart]] = 0.0
        upper[self._gaps[closed]] = lower[self._gaps[closed]]
        return lower, upper

    def _with_least_force_excess(self, lower, upper) -> Optimum | None:
        """Solve within the force limits, or with their least excess where they cannot be met."""
        limited = self._limited
        if not len(limited):
            return self._solve(lower, upper)
        force_max, rows = self.problem.force_max[limited], self._forces[limited]
        limits = upper.copy()
        limits[rows] = np.minimum(upper[rows], force_max)
        optimum = self._solve(lower, limits)
        if optimum is not None:
            return optimum
        relaxed = self._relax(lower, upper, SoftBounds(rows, np.full(len(rows), -np.inf), force_max))
        if relaxed is None:
            return None
        forces = self._values(relaxed, rows)
        allowed = np.maximum(force_max, forces) + MARGIN * self._force_unit
        limits[rows] = np.minimum(upper[rows], allowed)
        lower, limits, duals = self._keep_excess(relaxed, rows, lower, limits)
        return self._or_relaxed(self._solve(lower, limits), relaxed, duals, lower, limits)

    def _with_least_row_excess(self, lower, upper) -> Optimum | None:
        """Solve with the least excess of the rows' bounds."""
        rows = self._rows
        lowest, highest = lower.copy(), upper.copy()
        lowest[rows], highest[rows] = -np.inf, np.inf
        relaxed = self._relax(lowest, highest, SoftBounds(rows, lower[rows], upper[rows]))
        if relaxed is None:
            return None
        reached, margin = self._values(relaxed, rows), MARGIN * self._row_unit
        lowest[rows] = np.minimum(lower[rows], reached - margin)
        highest[rows] = np.maximum(upper[rows], reached + margin)
        lowest, highest, duals = self._keep_excess(relaxed, rows, lowest, highest)
        optimum = self._with_least_force_excess(lowest, highest)
        return self._or_relaxed(optimum, relaxed, duals, lowest, highest)

    def _or_relaxed(self, optimum, relaxed, duals, lower, upper) -> Optimum:
        """The optimum with the least excess; where none is found, what has this excess.

        The bounds that keep the excess may enclose a nearly empty set, or equations that leave no
        freedom may be too nearly dependent in whitened unknowns.
        """
        if optimum is not None:
            return optimum._replace(duals=duals + optimum.duals)
        w = self._whiten(self._values(relaxed, np.arange(len(self.problem.g))))
        return Optimum(Projection(w, duals), duals, lower, upper)

    def _keep_excess(
        self, relaxed: Projection, soft: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bounds in which the excess stays the least.

        Wherever the excess is the least, the rows whose duals are not zero are at their bounds.
        They become equations: as inequalities they would enclose a nearly empty set.

        Returns:
            Lower and upper bounds, and the duals, scaled to go before those of the objective.
        """
        lower, upper, count = lower.copy(), upper.copy(), len(self._lower)
        sizes = np.abs(relaxed.duals)
        significant = sizes > max(SIGNIFICANT, SIGNIFICANT_SHARE * sizes.max())
        duals = np.where(significant, relaxed.duals, 0.0)[:count]
        at_upper, at_lower = np.flatnonzero(duals > 0.0), np.flatnonzero(duals < 0.0)
        lower[at_upper], upper[at_lower] = upper[at_upper], lower[at_lower]
        exceeded = soft[significant[count:]]
        lower[exceeded] = upper[exceeded] = self._values(relaxed, exceeded)
        return lower, upper, PRIORITY * duals

    def _solve(self, lower, upper) -> Optimum | None:
        if not self._budget.spend():
            return None
        projection = self._whitened.solve(lower, upper, self._independent(lower, upper))
        return None if projection is None else Optimum(projection, projection.duals, lower, upper)

    def _relax(self, lower, upper, soft: SoftBounds) -> Projection | None:
        if not self._budget.spend():
            return None
        independent = self._independent(lower, upper)
        return self._geometric.solve_softly(lower, upper, independent, soft)

    def _independent(self, lower, upper) -> np.ndarray:
        return self._geometric.independent(np.flatnonzero(lower == upper))

    def _values(self, projection: Projection, rows: np.ndarray) -> np.ndarray:
        return (self._geometric.rows[rows] @ projection.w) * self._geometric.lengths[rows]

    def _whiten(self, z: np.ndarray) -> np.ndarray:
        return (z / self._scale) @ self._factor / self._size

    def _within_bounds(self, w: np.ndarray) -> np.ndarray:
        return np.clip(self._T @ w, self.problem.lower, self.problem.upper)

    def _branch(self, z: np.ndarray, optimum: Optimum) -> Branch:
        lengths, residual = self._geometric.lengths, optimum.projection.w + self._whitened.q
        return Branch(
            z,
            0.5 * float(residual @ residual),
            float(np.linalg.norm(self.problem.row_excess(z))) / self._row_unit,
            float(np.linalg.norm(self.problem.force_excess(z))) / self._force_unit,
            optimum,
            self.problem.forces(z) / lengths[self._forces],
            self.problem.gaps(z) / lengths[self._gaps],
            optimum.duals[self._forces],
            optimum.duals[self._gaps],
        )
