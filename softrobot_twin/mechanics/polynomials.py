"""Polynomials of several variables up to a total degree, with their first and second derivatives.

Monomials are in graded order: those of lower degree come first. Each one is another monomial of one
degree less times one variable, so that all of them cost one product each. The derivatives of a
polynomial are polynomials themselves, whose coefficients are computed once: values, gradients and
second derivatives are then products of a matrix and the vector of monomials, and consistent with
each other to round-off.

Arguments of the kernels here:
    parents, factors, out: Of each monomial, shape (monomial_count,).
    z: Variables, shape (variable_count,).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit


@njit(**KERNEL)
def write_monomials(z, parents, factors, out):
    """Every monomial at z: its parent times one variable; the first one is 1."""
    out[0] = 1.0
    for m in range(1, len(out)):
        out[m] = out[parents[m]] * z[factors[m]]


@dataclass(frozen=True)
class Monomials:
    """All monomials of some variables up to a total degree.

    Attributes:
        variable_count: Number of variables n.
        degree: Greatest total degree.
    """

    variable_count: int
    degree: int

    @cached_property
    def exponents(self) -> np.ndarray:
        """Power of each variable in each monomial, shape (monomial_count, n)."""
        rows = []
        for degree in range(self.degree + 1):
            for chosen in combinations_with_replacement(range(self.variable_count), degree):
                rows.append(np.bincount(np.array(chosen, int), minlength=self.variable_count))
        return np.array(rows, dtype=np.int64)

    @cached_property
    def _place(self) -> dict[tuple, int]:
        return {tuple(row): index for index, row in enumerate(self.exponents.tolist())}

    @property
    def count(self) -> int:
        """Number of monomials."""
        return len(self.exponents)

    def count_up_to(self, degree: int) -> int:
        """Number of monomials up to a degree; they come first.

        Args:
            degree: The greatest degree that is counted.
        """
        return int((self.exponents.sum(axis=1) <= degree).sum())

    @cached_property
    def recipe(self) -> tuple[np.ndarray, np.ndarray]:
        """Parent of each monomial, and the variable that it is multiplied by, shape (count,)."""
        parents, factors = np.zeros(self.count, np.int64), np.zeros(self.count, np.int64)
        for index, row in enumerate(self.exponents[1:], start=1):
            factor = int(np.flatnonzero(row)[0])
            lower = row.copy()
            lower[factor] -= 1
            parents[index], factors[index] = self._place[tuple(lower.tolist())], factor
        return parents, factors

    def values(self, points: np.ndarray) -> np.ndarray:
        """Every monomial at every point.

        Args:
            points: Variables, shape (point_count, n).

        Returns:
            Shape (point_count, count).
        """
        parents, factors = self.recipe
        out = np.empty((len(points), self.count))
        for own, point in zip(out, np.ascontiguousarray(points, float), strict=True):
            write_monomials(point, parents, factors, own)
        return out

    @cached_property
    def derivatives(self) -> np.ndarray:
        """Matrices that give the coefficients of ∂/∂z_k from those of a polynomial.

        Returns:
            Shape (n, count of one degree less, count).
        """
        matrices = np.zeros((self.variable_count, self.count_up_to(self.degree - 1), self.count))
        for index, row in enumerate(self.exponents):
            for k in np.flatnonzero(row):
                lower = row.copy()
                lower[k] -= 1
                matrices[k, self._place[tuple(lower.tolist())], index] = row[k]
        return matrices

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂/∂z_k of every monomial at every point, shape (point_count, n, count).

        Args:
            points: Places z, shape (point_count, n).
        """
        lower = self.values(points)[:, : self.count_up_to(self.degree - 1)]
        return np.einsum("pl,klm->pkm", lower, self.derivatives, optimize=True)

    def gradient_coefficients(self, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients of ∂/∂z_k, shape (..., n, count of one degree less).

        Args:
            coefficients: Coefficients of polynomials of this degree, shape (..., count).
        """
        return np.einsum("klm,...m->...kl", self.derivatives, coefficients, optimize=True)

    def curvature_coefficients(self, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients of ∂²/∂z_k∂z_l, shape (..., n, n, count of two degrees less).

        Args:
            coefficients: Coefficients of polynomials of this degree, shape (..., count).
        """
        lower = Monomials(self.variable_count, self.degree - 1)
        return lower.gradient_coefficients(self.gradient_coefficients(coefficients))
