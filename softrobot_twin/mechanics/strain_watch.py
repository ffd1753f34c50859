"""Whether the strain of elements is within the range in which their law can be trusted.

The principal stretches of a point are the square roots of the eigenvalues of C = FᵀF. Most points
are judged by bounds of them that need no eigenvalues: the greatest is below tr C, and the least is
at least 4 det C / tr² C.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    determinant,
    inner,
    plus_identity,
    trace,
    transposed_product,
)
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.element_batches import BATCH, matrix_at


class StrainOutside(NamedTuple):
    """Elements that are strained beyond the range of their law.

    Attributes:
        key: Key of their material in the scene, such as ``body.material``.
        body: Name of their body.
        least: Their least principal strain.
        greatest: Their greatest.
        range: Least and greatest principal strain that the law is trusted in.
    """

    key: str
    body: str
    least: float
    greatest: float
    range: tuple[float, float]

    def in_words(self) -> str:
        """A sentence with body, strain and range."""
        reached = [f"{100.0 * strain:.0f} %"
                   for strain, is_out in ((self.least, self.least < self.range[0]),
                                          (self.greatest, self.greatest > self.range[1]))
                   if is_out]  # fmt: skip
        low, high = (100.0 * strain for strain in self.range)
        return (f"{self.body}: strain of {' and '.join(reached)} is outside of the range of "
                f"{self.key}, {low:.0f} % to {high:.0f} %")  # fmt: skip


@njit(**KERNEL)
def extreme_eigenvalues(C):
    """Least and greatest eigenvalue of a symmetric matrix C, three rows of three (Smith 1961)."""
    mean = trace(C) / 3.0
    D = plus_identity(C, -mean)
    size = math.sqrt(inner(D, D) / 6.0)
    if size <= 1.0e-14 * mean:
        return mean, mean
    cosine = min(max(0.5 * determinant(D) / size**3, -1.0), 1.0)
    angle = math.acos(cosine) / 3.0
    greatest = mean + 2.0 * size * math.cos(angle)
    return mean + 2.0 * size * math.cos(angle + 2.0 * math.pi / 3.0), greatest


@njit(**KERNEL)
def extreme_squares(deformations, weights, least, greatest):
    """Least and greatest eigenvalue of C beyond given ones.

    Args:
        deformations: F at the points, shape (batch_count, point_count, 9 × BATCH).
        weights: Volume of each point [m³], 0 beyond the last element,
            shape (batch_count, point_count, BATCH).
        least: Only lower eigenvalues count.
        greatest: Only greater ones count.

    Returns:
        Both; the given ones where no point has others.
    """
    for k in range(len(weights)):
        for q in range(weights.shape[1]):
            for e in range(BATCH):
                A = matrix_at(deformations[k, q], 0, e)
                squares, J = inner(A, A), determinant(A)
                if squares <= greatest and 4.0 * J * J >= least * squares * squares:
                    continue
                if weights[k, q, e] > 0.0:
                    low, high = extreme_eigenvalues(transposed_product(A, A))
                    least, greatest = min(least, low), max(greatest, high)
    return least, greatest


class StrainWatch(NamedTuple):
    """Watches the strain of the elements of a term.

    Attributes:
        elements: The term.
        key: Key of their material in the scene.
        body: Name of their body.
        range: Least and greatest principal strain that the law is trusted in.
    """

    elements: object
    key: str
    body: str
    range: tuple[float, float]

    def outside(self, positions: np.ndarray) -> StrainOutside | None:
        """How far the strain is outside of its range; None where it is inside.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        low, high = ((1.0 + strain) ** 2 for strain in self.range)
        least, greatest = self.elements.extreme_squares(positions, low, high)
        if least >= low and greatest <= high:
            return None
        return StrainOutside(
            self.key, self.body, math.sqrt(max(least, 0.0)) - 1.0, math.sqrt(greatest) - 1.0,
            self.range,
        )  # fmt: skip
