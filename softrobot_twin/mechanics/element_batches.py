"""Elements side by side in memory, so that the processor works on many at once.

Elements are worked on in batches of `BATCH`. Every quantity of a batch is one flat array, entry
after entry, each entry a row of `BATCH` numbers: F[at(5, e)] is entry 5 of element e's deformation
gradient, matrices row by row. Elements of a batch have as many nodes as the one that has most of them;
what lies behind in arrays that are as wide as the widest batch is not read (`node_count_of`). A loop over e then becomes a few vector instructions, provided that
the entries' numbers are constants and what is read and what is written are different arrays.
`matrix_at` and `vector_at` read the entries of one element as the tuples of `matrix3`.

Arguments of the kernels here:
    A: Matrices of all elements of a batch, shape (9 matrix_count × BATCH,).
    count: Number of nodes.
    e: An element of the batch.
    entries: Number of entries.
    index: Number of a vector or matrix among those of an element.
    V: Some entries of all elements of a batch, shape (entry_count × BATCH,).
    matrix: Three rows of three numbers.
    source, target: Arrays of one shape (count,).
    v: A vector, three numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from softrobot_twin.geometry.shape_functions import IntegrationPoints
from softrobot_twin.kernels.compilation import INLINED, INNER, njit
from softrobot_twin.mechanics.stencil import bind_stencils

BATCH = 16


class ElementBatches(NamedTuple):
    """Elements in batches, the nodes of each in elimination order.

    Attributes:
        cells: Nodes, -1 behind the last one of a batch, shape (batch_count, width, BATCH).
        free: Their unknowns, -1 where there are none, same shape.
        gradients: ∇N_a at each point [1/m], shape (batch_count, point_count, 3 width × BATCH).
        weights: Volume of each point [m³], 0 beyond the last element,
            shape (batch_count, point_count, BATCH).
        offsets: Place of each block, see `bind_stencils`, shape (batch_count, pair_count, BATCH).
        strides: Distance of its columns, same shape.
        order: Nodes of each element in elimination order, shape (element_count, width).
    """

    cells: np.ndarray
    free: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray
    offsets: np.ndarray
    strides: np.ndarray
    order: np.ndarray


@njit(**INLINED)
def at(entry, e):
    """Place of element e in the row of an entry."""
    return entry * BATCH + e


@njit(**INLINED)
def node_count_of(cells):
    """Number of nodes of the elements of a batch.

    Args:
        cells: Their nodes, -1 behind the last one, shape (most nodes of a batch, BATCH).
    """
    count = len(cells)
    while cells[count - 1, 0] < 0:
        count -= 1
    return count


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
    """Rows from number `first` on of element e, as many as the tuple `like` has, inside kernels.

    Args:
        A: As of `matrix_at`.
        first: Number of the first row.
        like: A tuple of as many rows; its values are not read.
        e: Place of the element in the batch.
    """
    raise NotImplementedError("only inside compiled kernels")


@overload(rows_at, jit_options={"forceinline": True})
def _rows_at(A, first, like, e):
    if len(like) == 1:
        return lambda A, first, like, e: (vector_at(A, first, e),)
    return lambda A, first, like, e: (
        (vector_at(A, first, e),) + rows_at(A, first + 1, like[1:], e)
    )


def put_rows(A, first, rows, e):
    """Write what `rows_at` reads, inside kernels.

    Args:
        A: As of `put_matrix`; written.
        first: Number of the first row.
        rows: The rows, each of three numbers.
        e: Place of the element in the batch.
    """
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


@njit(**INLINED)
def of_nodes(V, count):
    """The rows of the first nodes."""
    return V[: 3 * count * BATCH]


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


def stencils_of(cells: np.ndarray, node_counts: np.ndarray, free_index: np.ndarray) -> np.ndarray:
    """Unknowns that each element couples, -1 where there are none, shape (element_count, width).

    Args:
        cells: Nodes of the elements, shape (element_count, width).
        node_counts: How many of these are its own, shape (element_count,).
        free_index: Unknown of each node, -1 where it is fixed, shape (node_count,).
    """
    is_own = np.arange(cells.shape[1]) < node_counts[:, None]
    return np.where(is_own, free_index[cells], -1)


def lay_out_elements(
    cells: np.ndarray, node_counts: np.ndarray, points: IntegrationPoints, free_index: np.ndarray,
    elimination_rank: np.ndarray, slots,
) -> ElementBatches:  # fmt: skip
    """Find the places of the stiffness, sort each element's nodes, and form batches.

    Args:
        cells, node_counts, free_index: See `stencils_of`; counts do not fall.
        points: Gradients and volumes at the elements' points.
        elimination_rank: Place of each unknown in the elimination order.
        slots: The factorization's `slots`.
    """
    count, width = cells.shape
    stencils = stencils_of(cells, node_counts, free_index)
    widths = node_counts[np.minimum(np.arange(BATCH, count + BATCH, BATCH), count) - 1]
    batch_count, pair_count = len(widths), width * (width + 1) // 2
    batches = ElementBatches(
        np.full((batch_count, width, BATCH), -1), np.full((batch_count, width, BATCH), -1),
        np.zeros((batch_count, points.weights.shape[1], 3 * width * BATCH)),
        in_batches(points.weights, 0.0),
        np.full((batch_count, pair_count, BATCH), -1), np.zeros((batch_count, pair_count, BATCH), int),
        np.tile(np.arange(width), (count, 1)),
    )  # fmt: skip
    for own_width in np.unique(widths):
        places = slice(*np.searchsorted(widths, [own_width, own_width + 1]))
        rows, nodes = slice(places.start * BATCH, places.stop * BATCH), slice(int(own_width))
        bound = bind_stencils(stencils[rows, nodes], elimination_rank, slots)
        pairs, order = slice(bound.offsets.shape[1]), bound.order[:, None, :, None]
        gradients = np.take_along_axis(points.gradients[rows, :, nodes], order, axis=2)
        gradients = in_batches(gradients.reshape(len(gradients), -1), 0.0)
        gradients = gradients.reshape(*batches.gradients[places].shape[:2], -1)
        batches.order[rows, nodes] = bound.order
        batches.cells[places, nodes] = in_batches(bound.sorted(cells[rows, nodes]), 0)
        batches.free[places, nodes] = in_batches(bound.sorted(stencils[rows, nodes]), -1)
        batches.gradients[places, :, : gradients.shape[2]] = gradients
        batches.offsets[places, pairs] = in_batches(bound.offsets, -1)
        batches.strides[places, pairs] = in_batches(bound.strides, 0)
    # The last batch is padded with copies of an element, without volume and unknowns.
    spare = slice((count - 1) % BATCH + 1, BATCH)
    padded = batches.gradients[-1].reshape(points.weights.shape[1], -1, BATCH)
    padded[:, :, spare] = padded[:, :, :1]
    batches.cells[-1][:, spare] = batches.cells[-1][:, :1]
    return batches
