"""Elements side by side in memory, so that the processor works on many at once.

Elements are worked on in batches of `BATCH`. Every quantity of a batch is one flat array, entry
after entry, each entry a row of `BATCH` numbers: F[at(5, e)] is entry 5 of element e's deformation
gradient, matrices row by row. A loop over e then becomes a few vector instructions, provided that
the entries' numbers are constants and what is read and what is written are different arrays.
`matrix_at` and `vector_at` read the entries of one element as the tuples of `matrix3`.
"""

from __future__ import annotations

import numpy as np
from numba.extending import overload

from softrobot_twin.compilation import INLINED, INNER, njit

BATCH = 16


@njit(**INLINED)
def at(entry, e):
    """Place of element e in the row of an entry."""
    return entry * BATCH + e


@njit(**INNER)
def copy_entries(source, target):
    """Copy an array; see `compilation`."""
    for i in range(len(source)):
        target[i] = source[i]


@njit(**INNER)
def scratch(entries):
    """Memory for a quantity of one batch."""
    return np.empty(entries * BATCH)


@njit(**INLINED)
def vector_at(V, index, e):
    """Vector number `index` of element e."""
    return (V[at(3 * index, e)], V[at(3 * index + 1, e)], V[at(3 * index + 2, e)])


@njit(**INLINED)
def put_vector(V, index, e, v):
    """Write what `vector_at` reads."""
    V[at(3 * index, e)], V[at(3 * index + 1, e)], V[at(3 * index + 2, e)] = v


@njit(**INLINED)
def matrix_at(A, index, e):
    """Matrix number `index` of element e."""
    first = 3 * index
    return (vector_at(A, first, e), vector_at(A, first + 1, e), vector_at(A, first + 2, e))


@njit(**INLINED)
def put_matrix(A, index, e, matrix):
    """Write what `matrix_at` reads."""
    first = 3 * index
    put_vector(A, first, e, matrix[0])
    put_vector(A, first + 1, e, matrix[1])
    put_vector(A, first + 2, e, matrix[2])


def rows_at(A, first, like, e):
    """Rows from number `first` on of element e, as many as the tuple `like` has, inside kernels."""
    raise NotImplementedError("only inside compiled kernels")


@overload(rows_at, jit_options={"forceinline": True})
def _rows_at(A, first, like, e):
    if len(like) == 1:
        return lambda A, first, like, e: (vector_at(A, first, e),)
    return lambda A, first, like, e: (
        (vector_at(A, first, e),) + rows_at(A, first + 1, like[1:], e)
    )


def put_rows(A, first, rows, e):
    """Write what `rows_at` reads, inside kernels."""
    raise NotImplementedError("only inside compiled kernels")


@overload(put_rows, jit_options={"forceinline": True})
def _put_rows(A, first, rows, e):
    if len(rows) == 1:
        return lambda A, first, rows, e: put_vector(A, first, e, rows[0])

    def put(A, first, rows, e):
        put_vector(A, first, e, rows[0])
        put_rows(A, first + 1, rows[1:], e)

    return put


@njit(**INLINED)
def of_node(V, a):
    """The three rows of node a: its vector in all elements of a batch."""
    return V[3 * a * BATCH : 3 * (a + 1) * BATCH]


def in_batches(values: np.ndarray, padding) -> np.ndarray:
    """Cut rows of elements into batches, the element last.

    Args:
        values: One row an element, shape (element_count, width).
        padding: What stands in the places after the last element.

    Returns:
        Shape (batch_count, width, BATCH).
    """
    element_count, width = values.shape
    batch_count = -(-element_count // BATCH)
    padded = np.full((batch_count * BATCH, width), padding, dtype=values.dtype)
    padded[:element_count] = values
    return np.ascontiguousarray(padded.reshape(batch_count, BATCH, width).transpose(0, 2, 1))
