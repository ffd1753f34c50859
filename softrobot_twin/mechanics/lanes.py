"""Elements side by side, so that the processor works on many at once.

Elements are worked on in batches of `LANES`. Every quantity of a batch is one flat array, entry
after entry, each entry a row of `LANES` numbers: F[at(5, e)] is entry 5 of element e's deformation
gradient, matrices row by row. A loop over e then becomes a few vector instructions, provided that
the entries' numbers are constants and what is read and what is written are different arrays.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Strictly by IEEE: no line may be reordered or fused, so that vector code and the scalar code that
# stands in for it where arrays seem to overlap give the same bits. It costs nothing measurable.
KERNEL = {"cache": True, "nogil": True, "error_model": "numpy"}
LANES = 16


@njit(**KERNEL)
def at(entry, e):
    """Place of element e in the row of an entry."""
    return entry * LANES + e


@njit(**KERNEL)
def room(entries):
    """Memory for a quantity of one batch."""
    return np.empty(entries * LANES)


def in_lanes(values: np.ndarray, padding) -> np.ndarray:
    """Cut rows of elements into batches, the element last.

    Args:
        values: One row an element, shape (element_count, width).
        padding: What stands in the lanes after the last element.

    Returns:
        Shape (batch_count, width, LANES).
    """
    element_count, width = values.shape
    batch_count = -(-element_count // LANES)
    padded = np.full((batch_count * LANES, width), padding, dtype=values.dtype)
    padded[:element_count] = values
    return np.ascontiguousarray(padded.reshape(batch_count, LANES, width).transpose(0, 2, 1))
