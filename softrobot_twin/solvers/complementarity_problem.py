"""A convex quadratic program whose contacts choose: touch, or push not (Coevoet 2017, eq. 19-22).

    min ½ zᵀPz + gᵀz
    s.t.  lower ≤ z ≤ upper,   row_lower ≤ A z ≤ row_upper,
          0 ≤ λ ⊥ C z + d ≥ 0,   λ ≤ force_max     with λ the last unknowns of z

It is not convex: a contact either pushes at gap zero or leaves with force zero. Each choice for all
contacts is one *piece*, an ordinary convex program.

What gives way where not everything can be had, in this order: the objective; `force_max`; the rows'
bounds; `lower` and `upper` never, nor that contacts do not pull and bodies do not cross.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


# Share of the way across its bounds that is none.
NEGLIGIBLE = 1.0e-9


class ComplementarityProblem(NamedTuple):
    """The problem, in any units: solvers bring it to scale.

    Attributes:
        P: Hessian, symmetric positive definite, shape (n, n).
        g: Gradient at zero, shape (n,).
        lower: Least value of each unknown; zero for contact forces, shape (n,).
        upper: Greatest value; infinite for contact forces, shape (n,).
        A: Further rows with bounds, shape (m, n).
        row_lower: Their least values, shape (m,).
        row_upper: Their greatest values, shape (m,).
        C: Gap by unknown, shape (contact_count, n).
        d: Gap at zero, shape (contact_count,).
        force_max: The contact force that is asked not to be exceeded, shape (contact_count,).
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
        """Contacts; their forces are the last unknowns."""
        return len(self.d)

    @property
    def is_finite(self) -> bool:
        """False when a number is not one; bounds may be infinite."""
        numbers = (self.P, self.g, self.A, self.C, self.d)
        bounds = (self.lower, self.upper, self.row_lower, self.row_upper, self.force_max)
        return all(np.isfinite(array).all() for array in numbers) and not any(
            np.isnan(array).any() for array in bounds
        )

    def check(self) -> None:
        """See whether the sizes fit together.

        Raises:
            ValueError: They do not, a bound is reversed, or a contact may pull.
        """
        n, m, count = len(self.g), len(self.row_lower), len(self.d)
        shapes = {
            "P": (n, n), "lower": (n,), "upper": (n,), "A": (m, n), "row_upper": (m,),
            "C": (count, n), "force_max": (count,),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, not {shape}")
        if count > n:
            raise ValueError(f"{count} contacts, but {n} unknowns")
        for low, high in ((self.lower, self.upper), (self.row_lower, self.row_upper)):
            if np.any(low > high):
                raise ValueError("a lower bound is above its upper bound")
        if np.any(self.lower[n - count :] != 0.0) or np.any(self.force_max < 0.0):
            raise ValueError("a contact's force starts at zero, and so does its bound")

    def objective(self, z: np.ndarray) -> float:
        """½ zᵀPz + gᵀz."""
        return float(0.5 * z @ self.P @ z + self.g @ z)

    def gaps(self, z: np.ndarray) -> np.ndarray:
        """Gaps C z + d, shape (contact_count,)."""
        return self.C @ z + self.d

    def forces(self, z: np.ndarray) -> np.ndarray:
        """Contact forces: the last unknowns, shape (contact_count,)."""
        return z[len(z) - self.contact_count :]

    def force_excess(self, z: np.ndarray) -> np.ndarray:
        """By how much contact forces exceed their bounds, shape (contact_count,)."""
        return np.maximum(self.forces(z) - self.force_max, 0.0)

    def row_excess(self, z: np.ndarray) -> np.ndarray:
        """By how much rows break their bounds, shape (m,)."""
        rows = self.A @ z
        return np.maximum(np.maximum(rows - self.row_upper, self.row_lower - rows), 0.0)

    def size_of(self, unknowns: float, T: np.ndarray) -> float:
        """Size of the problem in unknowns w with z = T w.

        Args:
            unknowns: Order of size of w.
            T: Unknowns by w, shape (n, n).

        Returns:
            It; where it is round-off, the longest way across a row's bounds.
        """
        ways = self.row_upper - self.row_lower
        lengths = np.linalg.norm(self.A @ T, axis=1)
        finite = np.isfinite(ways) & (lengths > 0.0)
        longest = float(np.max(ways[finite] / lengths[finite], initial=0.0))
        return unknowns if unknowns > NEGLIGIBLE * longest else longest or 1.0
