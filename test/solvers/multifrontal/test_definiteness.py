"""What the factorization tells of matrices that are indefinite, badly scaled or not numbers."""

import numpy as np
import pytest


def test_entries_above_the_diagonal_are_ignored(make_system):
    system = make_system("grid", seed=4)
    nodes = np.arange(system.count)
    offsets, strides = system.solver.slots(nodes, nodes)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        system.solver.storage[offsets + i + j * strides] = np.nan
    assert system.solver.factor()
    b = system.rng.standard_normal((system.count, 3))
    x = system.solver.solve(b)
    np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 0.3, 1])
def test_a_matrix_that_is_not_positive_definite_is_reported(make_system, value, place):
    system = make_system("grid", seed=2)
    node = int(place * (system.count - 1))
    offset, stride = system.solver.slots(np.array(node), np.array(node))
    system.solver.storage[offset + 1 + stride] = value
    assert not system.solver.factor()
    system.solver.storage[offset + 1 + stride] = system.A[3 * node + 1, 3 * node + 1]
    assert system.solver.factor()
    b = np.ones((system.count, 3))
    x = system.solver.solve(b)
    np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_a_matrix_with_a_negative_eigenvalue_is_reported(make_system, seed):
    system = make_system("slab", seed=seed)
    smallest = np.linalg.eigvalsh(system.A)[0]
    identity = np.eye(3 * system.count)
    system.assemble(system.A - (smallest - 1e-6) * identity)
    assert system.solver.factor()
    system.assemble(system.A - (smallest + 1e-6) * identity)
    assert not system.solver.factor()


@pytest.mark.parametrize("scale", [1e-200, 1e-8, 1e8, 1e150])
def test_the_unit_of_the_matrix_does_not_matter(make_system, scale):
    system = make_system("two bodies")
    system.assemble(scale * system.A)
    assert system.solver.factor()
    b = system.rng.standard_normal((system.count, 3))
    x = scale * system.solver.solve(b)
    np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


@pytest.mark.parametrize("decades", [4, 8, 12])
def test_a_badly_conditioned_matrix_is_solved_as_well_as_arithmetic_allows(make_system, decades):
    system = make_system("slab", seed=1)
    A = np.eye(3 * system.count)
    for number, (row, column) in enumerate(zip(system.rows, system.columns, strict=True)):
        stretch = system.rng.standard_normal(6)
        dofs = np.concatenate([3 * row + np.arange(3), 3 * column + np.arange(3)])
        stiffness = 10.0 ** (decades * (number % 3) / 2)
        A[np.ix_(dofs, dofs)] += stiffness * np.outer(stretch, stretch)
    system.assemble(A)
    assert system.solver.factor()
    b = system.rng.standard_normal((system.count, 3))
    x = system.solver.solve(b).ravel()
    assert np.linalg.cond(A) > 0.1 * 10.0**decades
    residual = np.linalg.norm(A @ x - b.ravel())
    assert residual < 1e-15 * np.linalg.norm(A, 2) * np.linalg.norm(x) + 1e-15 * np.linalg.norm(b)


def test_a_failed_or_nan_solve_does_not_affect_the_next_one(make_system):
    system = make_system("grid", seed=6)
    H, b = system.constraint_rows(4), system.rng.standard_normal((system.count, 3))
    system.solver.factor()
    W, free = system.solver.condense(H, b)
    clean = W.copy(), free.copy(), system.solver.expand(np.ones(4)).copy()
    system.solver.condense(H, np.full_like(b, np.nan))
    system.solver.expand(np.full(4, np.nan))
    system.solver.solve(np.full_like(b, np.inf))
    W, free = system.solver.condense(H, b)
    again = W.copy(), free.copy(), system.solver.expand(np.ones(4)).copy()
    for mine, theirs in zip(clean, again, strict=True):
        np.testing.assert_array_equal(mine, theirs)
