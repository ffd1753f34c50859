"""3×3 matrices as tuples of three rows, each a vector of `vector3`, for use inside kernels.

No array is allocated, and a row of a matrix is a vector: `matrix[i]` may be given to `dot` or
`cross`. All functions are inlined: a call would cost more than the arithmetic, and would keep a
loop over elements from becoming vector instructions.

Arguments of the kernels here:
    A, B, dA: Matrices, three rows of three numbers.
    a, b, v: Vectors, three numbers.
    x: An array of shape (3, 3).
"""

from __future__ import annotations

from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, row, scaled, set_row
from softrobot_twin.kernels.compilation import INLINED, njit

ZERO = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@njit(**INLINED)
def rows(x):
    """An array of shape (3, 3) as a matrix."""
    return (row(x, 0), row(x, 1), row(x, 2))


@njit(**INLINED)
def set_rows(x, A):
    """Write matrix A into an array of shape (3, 3)."""
    set_row(x, 0, A[0])
    set_row(x, 1, A[1])
    set_row(x, 2, A[2])


@njit(**INLINED)
def scaled_matrix(A, factor):
    """factor A."""
    return (scaled(A[0], factor), scaled(A[1], factor), scaled(A[2], factor))


@njit(**INLINED)
def add_scaled_matrix(A, B, factor):
    """A + factor B."""
    return (
        add_scaled(A[0], B[0], factor),
        add_scaled(A[1], B[1], factor),
        add_scaled(A[2], B[2], factor),
    )


@njit(**INLINED)
def add_outer(A, a, b):
    """A + a bᵀ."""
    return (
        add_scaled(A[0], b, a[0]),
        add_scaled(A[1], b, a[1]),
        add_scaled(A[2], b, a[2]),
    )


@njit(**INLINED)
def plus_identity(A, factor):
    """A + factor 1."""
    return (
        (A[0][0] + factor, A[0][1], A[0][2]),
        (A[1][0], A[1][1] + factor, A[1][2]),
        (A[2][0], A[2][1], A[2][2] + factor),
    )


@njit(**INLINED)
def trace(A):
    """tr A."""
    return A[0][0] + A[1][1] + A[2][2]


@njit(**INLINED)
def inner(A, B):
    """A : B, the sum of the products of the entries."""
    return dot(A[0], B[0]) + dot(A[1], B[1]) + dot(A[2], B[2])


@njit(**INLINED)
def transposed(A):
    """Aᵀ."""
    return (
        (A[0][0], A[1][0], A[2][0]),
        (A[0][1], A[1][1], A[2][1]),
        (A[0][2], A[1][2], A[2][2]),
    )


@njit(**INLINED)
def symmetric(A):
    """(A + Aᵀ)/2."""
    xy, xz = 0.5 * (A[0][1] + A[1][0]), 0.5 * (A[0][2] + A[2][0])
    yz = 0.5 * (A[1][2] + A[2][1])
    return ((A[0][0], xy, xz), (xy, A[1][1], yz), (xz, yz, A[2][2]))


@njit(**INLINED)
def cross_matrix(v):
    """[v]×, the matrix with [v]× w = v × w."""
    return ((0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0))


@njit(**INLINED)
def transform(A, v):
    """A v."""
    return (dot(A[0], v), dot(A[1], v), dot(A[2], v))


@njit(**INLINED)
def product(A, B):
    """A B."""
    return product_transposed(A, transposed(B))


@njit(**INLINED)
def product_transposed(A, B):
    """A Bᵀ."""
    return (transform(B, A[0]), transform(B, A[1]), transform(B, A[2]))


@njit(**INLINED)
def transposed_product(A, B):
    """Aᵀ B."""
    return product(transposed(A), B)


@njit(**INLINED)
def cofactor(A):
    """The cofactors of A: det(A) A⁻ᵀ, also where A is singular."""
    return (cross(A[1], A[2]), cross(A[2], A[0]), cross(A[0], A[1]))


@njit(**INLINED)
def cofactor_change(A, dA):
    """The change of the cofactors of A by a small change dA."""
    return (
        add_scaled(cross(dA[1], A[2]), cross(A[1], dA[2]), 1.0),
        add_scaled(cross(dA[2], A[0]), cross(A[2], dA[0]), 1.0),
        add_scaled(cross(dA[0], A[1]), cross(A[0], dA[1]), 1.0),
    )


@njit(**INLINED)
def determinant(A):
    """det A."""
    return dot(A[0], cross(A[1], A[2]))
