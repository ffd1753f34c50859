"""A straight stretch between points that nodes carry: of a cable, or a spring."""

from __future__ import annotations

import numpy as np
from numba import njit

# What is shorter than this [m] has no direction.
NO_LENGTH = 1.0e-9


@njit(cache=True, nogil=True, error_model="numpy")
def stretch_vector(x, nodes, coefficients, constant):
    """r = Σ c_a x_a + r_0 of one stretch, and its length."""
    r0, r1, r2 = constant[0], constant[1], constant[2]
    for a in range(len(nodes)):
        n = nodes[a]
        if n >= 0:
            c = coefficients[a]
            r0 += c * x[n, 0]
            r1 += c * x[n, 1]
            r2 += c * x[n, 2]
    return r0, r1, r2, np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
