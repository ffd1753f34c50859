"""Block Gauss–Seidel for actuators and contacts with friction (Coevoet 2017, section 4.3)."""

from __future__ import annotations

import numpy as np

from softrobot_twin.solvers import contact_sweeps as kernels
from softrobot_twin.solvers.contact_cone import CONTACT_SIZE
from softrobot_twin.solvers.contact_problem import ContactProblem, ContactSolution


class ContactGaussSeidel:
    """Solves contact problems, each from the multipliers of the one before.

    Attributes:
        tolerance: Residual at which a solution is good enough [m].
        most_sweeps: Sweeps after which the best so far is given back, as not converged.
    """

    def __init__(self, tolerance: float = 1.0e-10, most_sweeps: int = 500):
        self.tolerance = tolerance
        self.most_sweeps = most_sweeps

    def solve(self, problem: ContactProblem, guess: np.ndarray) -> ContactSolution:
        """Multipliers from a guess.

        Args:
            problem: The problem.
            guess: Multipliers to begin with [N], shape (n,).

        Returns:
            The solution; with `converged` False if the residual is above the tolerance, and the
            guess with infinite residuals if the problem or the guess is not finite.

        Raises:
            ValueError: Sizes do not fit together, see `ContactProblem.check`.
        """
        problem.check()
        W = np.ascontiguousarray(problem.W, dtype=np.float64)
        violation = np.ascontiguousarray(problem.violation, dtype=np.float64)
        force = np.array(guess, dtype=np.float64)
        if force.shape != violation.shape:
            raise ValueError(f"a guess of {force.size} multipliers for {violation.size} rows")
        finite = np.isfinite(W).all() and np.isfinite(violation).all() and np.isfinite(force).all()
        if not finite:
            return ContactSolution(np.nan_to_num(force), np.inf, np.inf, 0, False)
        return self._sweep(problem, W, violation, force)

    def _sweep(self, problem, W, violation, force) -> ContactSolution:
        bounds = problem.lower, problem.upper, problem.friction, problem.rows_per_contact
        local = np.empty((len(problem.friction), CONTACT_SIZE))
        if problem.rows_per_contact == 3:
            kernels.measure_contacts(W, len(problem.lower), problem.friction, local)
        kernels.admissible(*bounds, force)
        delta = np.empty_like(force)
        kernels.motion(W, violation, force, delta)
        gap, newtons = kernels.residual(W, *bounds, force, delta)
        sweeps = 0
        while not gap <= self.tolerance and sweeps < self.most_sweeps:
            kernels.sweep(W, *bounds, local, force, delta)
            gap, newtons = kernels.residual(W, *bounds, force, delta)
            sweeps += 1
        kernels.motion(W, violation, force, delta)
        gap, newtons = kernels.residual(W, *bounds, force, delta)
        return ContactSolution(force, gap, newtons, sweeps, bool(gap <= self.tolerance))
