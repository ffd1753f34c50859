"""The small kernels against plain numpy."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from softrobot_twin.solvers.multifrontal.dense_kernels import (
    NARROW,
    TRIANGLE,
    WIDE,
    add_node,
    add_node_columns,
    add_strips,
    clear_strips,
    copy_node,
    factor_triangle,
    negate_product,
    place_block,
    solve_backward,
    solve_forward,
    solve_product,
    subtract_columns,
    subtract_dots,
    subtract_product,
)
from softrobot_twin.solvers.multifrontal.numeric_factorization import factor_panel, make_update

WIDTHS = pytest.mark.parametrize("width", [NARROW, WIDE])
RNG = np.random.default_rng(0)


def columns(rows, count):
    """A random matrix that is stored by columns."""
    return np.asfortranarray(RNG.standard_normal((rows, count)))


def address(array):
    return array.ctypes.data


def positive_block(width):
    root = RNG.standard_normal((width, width))
    return np.asfortranarray(root @ root.T + width * np.eye(width))


def triangle_of(block):
    """As the kernels keep it: columns of WIDE, the diagonal inverted."""
    factor = np.linalg.cholesky(block)
    kept = np.zeros((WIDE, WIDE), order="F")
    kept[: len(block), : len(block)] = factor
    np.fill_diagonal(kept[: len(block), : len(block)], 1.0 / factor.diagonal())
    return kept


@WIDTHS
@pytest.mark.parametrize("strips", [0, 1, 2, 3, 4, 5, 7, 8, 13])
@pytest.mark.parametrize("depth", [0, 1, 3, 6, 50])
def test_products_are_those_of_numpy(width, strips, depth):
    rows = 8 * strips
    A, B = columns(rows + 5, max(depth, 1)), columns(width + 2, max(depth, 1))
    C = columns(rows + 3, width)
    block = positive_block(width)
    triangle, factor = triangle_of(block), np.linalg.cholesky(block)
    product = A[:rows, :depth] @ B[:width, :depth].T
    shared = depth, address(A), rows + 5, address(B), width + 2
    for kernel, extra, expected in (
        (negate_product, (), -product),
        (subtract_product, (), C[:rows] - product),
        (
            solve_product, (address(triangle),),
            np.linalg.solve(factor, (C[:rows] - product).T).T,
        ),
    ):  # fmt: skip
        result = C.copy(order="F")
        kernel(width, strips, *shared, address(result), rows + 3, *extra)
        np.testing.assert_allclose(result[:rows], expected, atol=1e-12)
        np.testing.assert_array_equal(result[rows:], C[rows:])


@WIDTHS
def test_a_triangle_is_the_cholesky_factor_of_its_block(width):
    block = columns(width + 4, width)
    block[:width] = positive_block(width)
    kept = np.zeros(TRIANGLE)
    read = block.copy(order="F")
    read[:width][np.triu_indices(width, 1)] = np.nan  # only the lower part counts
    assert factor_triangle(width, address(read), width + 4, address(kept))
    kept = kept.reshape(WIDE, WIDE).T
    np.testing.assert_allclose(kept, triangle_of(block[:width]), atol=1e-14)


@WIDTHS
@pytest.mark.parametrize("value", [0.0, -1e-300, np.nan, np.inf])
def test_a_pivot_that_is_not_positive_is_reported(width, value):
    for place in range(width):
        block = np.asfortranarray(np.eye(width))
        block[place, place] = value
        assert not factor_triangle(width, address(block), width, address(np.zeros(TRIANGLE)))


@WIDTHS
def test_triangles_solve_forward_and_backward(width):
    block = positive_block(width)
    kept, factor = triangle_of(block), np.linalg.cholesky(block)
    x = RNG.standard_normal(width)
    forward, backward = x.copy(), x.copy()
    solve_forward(width, address(kept), address(forward))
    solve_backward(width, address(kept), address(backward))
    np.testing.assert_allclose(factor @ forward, x, atol=1e-13)
    np.testing.assert_allclose(factor.T @ backward, x, atol=1e-13)


@WIDTHS
@pytest.mark.parametrize("strips", [0, 1, 2, 5])
def test_columns_are_subtracted(width, strips):
    L, x, rows = columns(8 * strips + 1, width), RNG.standard_normal(width), np.ones(8 * strips)
    expected = rows - L[: 8 * strips] @ x
    subtract_columns(width, strips, address(L), 8 * strips + 1, address(x), address(rows))
    np.testing.assert_allclose(rows, expected, atol=1e-13)


@WIDTHS
@pytest.mark.parametrize("skipped", range(8))
@pytest.mark.parametrize("strips", [1, 2, 5])
def test_dot_products_skip_the_first_rows(width, skipped, strips):
    L, x = columns(8 * strips, width), RNG.standard_normal(width)
    rows = RNG.standard_normal(8 * strips)
    expected = x - L[skipped:].T @ rows[skipped:]
    L[:skipped], rows[:skipped] = np.inf, np.nan
    subtract_dots(width, strips, skipped, address(L), 8 * strips, address(rows), address(x))
    np.testing.assert_allclose(x, expected, atol=1e-13)


@njit
def move(kind, target, stride, source, source_stride, count):
    """Intrinsics can be called from compiled code only."""
    if kind == 0:
        clear_strips(target, count)
    elif kind == 1:
        place_block(target, stride, source)
    elif kind == 2:
        add_node_columns(target, stride, source, source_stride, count)
    elif kind == 3:
        copy_node(target, source)
    elif kind == 4:
        add_node(target, source)
    else:
        add_strips(target, source, count)


def moved(kind, target, stride=0, source=None, source_stride=0, count=0):
    result = target.copy(order="F")
    source = np.zeros(1) if source is None else source
    move(kind, address(result), stride, address(source), source_stride, count)
    return result


def test_copies_write_only_their_target():
    target, source = RNG.standard_normal(48), RNG.standard_normal(48)
    for count in (0, 1, 3):
        end = 8 * count
        expected = np.concatenate([np.zeros(end), target[end:]])
        np.testing.assert_array_equal(moved(0, target, count=count), expected)
        expected = np.concatenate([target[:end] + source[:end], target[end:]])
        np.testing.assert_array_equal(moved(5, target, source=source, count=count), expected)
    expected = np.concatenate([source[:3], target[3:]])
    np.testing.assert_array_equal(moved(3, target, source=source), expected)
    expected = np.concatenate([target[:3] + source[:3], target[3:]])
    np.testing.assert_array_equal(moved(4, target, source=source), expected)


def test_a_block_is_placed_column_by_column():
    target, block = columns(7, 5), columns(3, 3)
    result = moved(1, target, stride=7, source=block)
    np.testing.assert_array_equal(result[:3, :3], block)
    result[:3, :3] = target[:3, :3]
    np.testing.assert_array_equal(result, target)


@pytest.mark.parametrize("count", range(0, 34))
def test_columns_of_a_node_are_added(count):
    target, source = columns(40, 4), columns(36, 4)
    expected = target.copy()
    expected[:count, :3] += source[:count, :3]
    result = moved(2, target, 40, source, 36, count)
    np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize("nodes", [(1, 0), (1, 1), (2, 3), (3, 2), (4, 9), (7, 0), (9, 20)])
def test_a_front_is_factorized_and_leaves_its_schur_complement(nodes):
    own, rows = 3 * nodes[0], 3 * sum(nodes)
    strips = -(-rows // 8)
    padding, height = 8 * strips - rows, 8 * strips
    root = RNG.standard_normal((rows, rows))
    A = root @ root.T + rows * np.eye(rows)
    panel = np.asfortranarray(np.full((height, own), 7.0))
    panel[padding:] = np.tril(A)[:, :own]
    triangles = np.zeros(TRIANGLE * (own // WIDE + 1))
    assert factor_panel(address(panel), height, padding, 0, own, strips, address(triangles))
    L = np.tril(panel[padding:])
    np.testing.assert_allclose(L @ L[:own].T, np.tril(A)[:, :own] + np.triu(A[:, :own], 1),
                               atol=1e-10)  # fmt: skip
    if rows == own:
        return
    first = (padding + own) // 8
    update = np.zeros((height - 8 * first, rows - own), order="F")
    make_update(
        address(panel), height, padding, own, own, rows, strips, address(update), height - 8 * first
    )
    result = np.tril(update[(padding + own) % 8 :])
    np.testing.assert_allclose(result, np.tril(-L[own:] @ L[own:].T), atol=1e-10)


SYSTEM = """
import sys
import numpy as np
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.multifrontal.vector_code import VECTOR_WIDTH
# The analysis counts and sorts, without vectors: as Python it needs no compilation.
for module in [module for name, module in sys.modules.items() if ".multifrontal." in name]:
    for name, kernel in list(vars(module).items()):
        if hasattr(kernel, "py_func") and kernel.__module__.endswith(".symbolic"):
            setattr(module, name, kernel.py_func)
rng = np.random.default_rng(0)
n = 60
rows, columns = rng.integers(0, n, (2, 150))
solver = Multifrontal(rows, columns, n)
A = 40.0 * np.eye(3 * n).reshape(n, 3, n, 3)
for r, c in zip(rows, columns):
    if r != c:
        A[r, :, c] = rng.uniform(-1, 1, (3, 3))
        A[c, :, r] = A[r, :, c].T
r = np.concatenate([rows, columns, np.arange(n)])
c = np.concatenate([columns, rows, np.arange(n)])
lower = solver.elimination_rank[r] >= solver.elimination_rank[c]
r, c = r[lower], c[lower]
offsets, strides = solver.slots(r, c)
for i in range(3):
    for j in range(3):
        solver.storage[offsets + i + j * strides] = A[r, i, c, j]
A = A.reshape(3 * n, 3 * n)
assert solver.factor()
H = NodeRows(np.arange(9), np.arange(9) * 5, rng.standard_normal((9, 3)), 9)
b = rng.standard_normal((n, 3))
W, free = solver.condense(H, b)
dense = H.transposed(n)
np.testing.assert_allclose(W, dense.T @ np.linalg.solve(A, dense), atol=1e-13)
dx = solver.expand(np.ones(9)).ravel()
np.testing.assert_allclose(A @ dx, b.ravel() + dense.sum(axis=1), atol=1e-11)
print(VECTOR_WIDTH)
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize("processor, features, lanes", [
    ("haswell", "+sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+avx,+avx2,+fma", 4),
    ("x86-64", "+sse,+sse2", 2),
])  # fmt: skip
def test_processors_with_shorter_vectors_compute_the_same(processor, features, lanes):
    if os.uname().machine != "x86_64":
        pytest.skip("names processors of x86_64")
    environment = os.environ | {
        "NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": features,
        "PYTHONPATH": str(Path(__file__).parents[3]),
    }  # fmt: skip
    run = subprocess.run(
        [sys.executable, "-c", SYSTEM], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) == lanes
