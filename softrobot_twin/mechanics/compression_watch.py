"""Whether hexahedra are fine enough for their compression.

The law sees the mean strain of a cell; how strain varies in it is resisted by moduli that do not depend
on strain (`hourglass.py`), and only as far as eight corners can vary it. So the force of a body that cannot
expand freely while it is compressed is too high, the more so the larger a part of its energy varies in
cells. Of a body and a material, with sums over its cells,

    c = Σ_{λ < 0.8} (1 - λ) E_h / E,    d = r² Σ (4 - 3 λ) E_h / E,    E = Σ (E_h + E_m)
    r² = Σ p² V / (⅔ μ E)

E_h = ½ yᵀ M y is the energy of the variation, E_m that of the mean change of shape, as of neo-Hookean
rubber, λ ≤ 1 the least principal stretch of the mean, and p = K ln J. r is the pressure by that of a body
which expands freely. c tells of large compression, d of thin pads, whose few layers are too stiff at every
compression. The force of bonded blocks (ν 0.3 to 0.49, cells of aspect 1 to 5, to half of their height) was more than
25 % too high in no case with c < 0.026 and d < 2.7. In bending few cells are compressed so far and
pressures are low, so that both are small although much of the energy is E_h.

Arguments of the kernels here:
    deformations: F of all cells, shape (batch_count, 9 × BATCH).
    moduli: M [N/m], shape (batch_count, 144 × BATCH), see `hourglass.py`.
    y: Hour-glass strains [m], shape (batch_count, 12 × BATCH).
    weights: Volume of each cell [m³], 0 beyond the last one, shape (batch_count, BATCH).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import determinant, inner, trace, transposed_product
from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit
from softrobot_twin.mechanics.element_batches import BATCH, at, matrix_at
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.strain_watch import extreme_eigenvalues

SEEN = 0.95
"""λ below which a cell makes that a body is looked at: most never have one."""
COMPRESSED = 0.8
"""λ below which a cell counts in c."""
MOST_COMPRESSED, MOST_CONFINED = 0.025, 2.4
"""c and d above which a body is not trusted."""


@njit(**ONCE)
def any_compressed(deformations, weights):
    """Whether a cell is compressed; most are judged by a lower bound of λ² that needs no eigenvalue."""
    least = SEEN * SEEN
    for k in range(len(weights)):
        for e in range(BATCH):
            F = matrix_at(deformations[k], 0, e)
            C = transposed_product(F, F)
            mean = trace(C) / 3.0
            spread = max(inner(C, C) - 3.0 * mean * mean, 0.0)
            # All are within √(2/3) of the norm of the deviator around the mean.
            if mean - math.sqrt(spread / 1.5) < least and weights[k, e] > 0.0:
                if extreme_eigenvalues(C)[0] < least:
                    return True
    return False


@njit(**KERNEL)
def coarseness(deformations, weights, moduli, y, lame_lambda, shear_modulus):
    """The larger of c and d, each by the most that is trusted; 0 where no cell is compressed.

    Args:
        deformations, weights, moduli, y: As above.
        lame_lambda, shear_modulus: Lamé's constants of small strains [Pa].
    """
    if not any_compressed(deformations, weights):
        return 0.0
    bulk_modulus = lame_lambda + 2.0 * shear_modulus / 3.0
    total, compressed, shortened, squares = 0.0, 0.0, 0.0, 0.0
    varied, force = np.empty(BATCH), np.empty(BATCH)
    for k in range(len(weights)):
        varied[:] = 0.0
        for r in range(12):
            force[:] = 0.0
            for s in range(12):
                for e in range(BATCH):
                    force[e] += moduli[k, at(12 * r + s, e)] * y[k, at(s, e)]
            for e in range(BATCH):
                varied[e] += 0.5 * y[k, at(r, e)] * force[e]
        for e in range(BATCH):
            F, volume = matrix_at(deformations[k], 0, e), weights[k, e]
            J = determinant(F)
            if J <= 0.0 or volume == 0.0:
                continue
            shape = inner(F, F) / J ** (2.0 / 3.0) - 3.0
            total += varied[e] + 0.5 * shear_modulus * volume * shape
            squares += (bulk_modulus * math.log(J)) ** 2 * volume
            square = extreme_eigenvalues(transposed_product(F, F))[0]
            shortening = 1.0 - min(math.sqrt(max(square, 0.0)), 1.0)
            shortened += (1.0 + 3.0 * shortening) * varied[e]
            if shortening > 1.0 - COMPRESSED:
                compressed += shortening * varied[e]
    if total <= 0.0:
        return 0.0
    confined = 1.5 * squares / (shear_modulus * total)
    return max(compressed / MOST_COMPRESSED, confined * shortened / MOST_CONFINED) / total


class CompressionWatch(NamedTuple):
    """Watches the compression of the hexahedra of a term.

    Attributes:
        elements: The term.
        body: Name of their body.
        lame: Of their material at small strains.
    """

    elements: object
    body: str
    lame: LameParameters
