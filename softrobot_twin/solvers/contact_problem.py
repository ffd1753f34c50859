"""Actuators and contacts with friction as one complementarity problem on W.

With δ = W λ + violation the motion of all rows under the multipliers λ (Coevoet 2017, eq. 4 and
section 5.2.1), a solution is

    actuator   lower ≤ λ ≤ upper ⊥ δ    δ > 0 only at lower, δ < 0 only at upper, else δ = 0
    contact    0 ≤ λ_n ⊥ δ_n ≥ 0        Signorini: no pulling, no penetration
               ‖λ_t‖ ≤ µ λ_n            Coulomb: at rest (δ_t = 0) inside the cone,
               δ_t = -s λ_t, s ≥ 0      sliding against the force on its surface

Signorini's law is that of an actuator with the bounds 0 and ∞: where other contacts have friction,
one without is such a row.

Such a problem has solutions, though not always one: redundant contacts share a load in many ways.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class ContactProblem(NamedTuple):
    """Rows of actuators first, then those of contacts.

    Contacts have either one row each, all without friction, or three. In a problem of both kinds
    those without friction are rows with the bounds 0 and ∞ after the actuators; see
    `with_frictionless_contacts`.

    Attributes:
        W: Compliance [m/N], symmetric positive semi-definite, shape (n, n); None where it is
            given by `Yt`.
        violation: Motion without multipliers δ_free [m], shape (n,). Actuator: δ_free less the
            commanded displacement. Contact: the gap, then with friction the tangential motion in
            this step.
        lower: Least multiplier of each actuator [N], shape (actuator_count,).
        upper: Greatest one [N]; equal to `lower` for an actuator given by force.
        friction: Coefficient µ of each contact, shape (contact_count,).
        rows_per_contact: 3 (normal and two tangents), or 1 without friction.
        Yt: Yᵀ with W = Yᵀ Y, where W is of low rank, shape (n, rank); else None.
    """

    W: np.ndarray | None
    violation: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    friction: np.ndarray
    rows_per_contact: int
    Yt: np.ndarray | None = None

    def with_matrix(self) -> ContactProblem:
        """The same problem with W formed, and without its factor."""
        if self.Yt is None:
            return self
        return self._replace(W=self.Yt @ self.Yt.T if self.W is None else self.W, Yt=None)

    def in_units(self, lengths: np.ndarray) -> ContactProblem:
        """The same problem in other units of the actuators: tolerances are of metres and newtons.

        Args:
            lengths: Unit of each actuator's displacement in a new one, by which efforts are divided,
                shape (actuator_count,).
        """
        rows = np.append(lengths, np.ones(len(self.violation) - len(lengths)))
        return self._replace(
            W=None if self.W is None else self.W * np.outer(rows, rows),
            violation=self.violation * rows, lower=self.lower / lengths, upper=self.upper / lengths,
            Yt=None if self.Yt is None else self.Yt * rows[:, None],
        )  # fmt: skip


def with_frictionless_contacts(problem: ContactProblem) -> ContactProblem:
    """The problem whose contacts without friction are rows with the bounds 0 and ∞.

    Args:
        problem: Its contacts without friction have one row each, and come before those with
            friction, which have three.
    """
    count = np.count_nonzero(problem.friction == 0.0)
    if count == 0:
        return problem
    return problem._replace(
        lower=np.concatenate([problem.lower, np.zeros(count)]),
        upper=np.concatenate([problem.upper, np.full(count, np.inf)]),
        friction=problem.friction[count:],
    )


class ContactSolution(NamedTuple):
    """Multipliers, and how far they are from solving the problem.

    The residual of a row is that of the natural map. For a contact's normal it is the smaller of
    δ_n and w λ_n; for its tangents w λ_t minus the projection of w λ_t - δ_t onto the disc of
    radius µ w λ_n; for an actuator w λ minus the projection of w λ - δ onto its bounds. w is the
    row's own compliance W_ii (for tangents the mean of both). The residual is zero if and only if
    the row is solved. Divided by w it is in newtons.

    Attributes:
        multipliers: λ [N], shape (n,); inside bounds and cones, whether converged or not.
        gap_residual: Largest residual [m].
        force_residual: Largest residual [N].
        sweeps: Gauss–Seidel sweeps made.
        converged: The residual is within the tolerance.
    """

    multipliers: np.ndarray
    gap_residual: float
    force_residual: float
    sweeps: int
    converged: bool
