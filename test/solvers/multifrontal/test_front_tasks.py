"""A factorization as tasks: the same bits for any number of threads."""

import numpy as np
import pytest

from softrobot_twin.solvers.multifrontal import front_tasks
from test.solvers.multifrontal.conftest import PATTERNS, System


@pytest.fixture
def threads_pay(monkeypatch):
    """Small systems are cut into small tasks."""
    for name, value in (("LEAST_COST", 0.0), ("LEAST_GAIN", -10.0), ("GRAIN", 2e3), ("PARTS", 64),
                        ("WAKE", 0.0), ("BLOCK", 24)):  # fmt: skip
        monkeypatch.setattr(front_tasks, name, value)


def _all_results(system, H, b, multipliers):
    solver = system.solver
    assert solver.factor()
    condensed = solver.condense(H, b)
    return condensed.W, condensed.free, solver.expand(multipliers).copy(), solver.solve(b)


@pytest.mark.parametrize("name", PATTERNS)
def test_results_are_the_same_bits_for_any_number_of_threads(name, threads_pay):
    system = System(PATTERNS[name])
    H, b = system.constraint_rows(11), system.rng.standard_normal((system.count, 3))
    multipliers = system.rng.standard_normal(11)
    expected = _all_results(system, H, b, multipliers)
    for count in (2, 3, 4, 1):
        system.solver.use_threads(count)
        for _ in range(3):
            for found, value in zip(_all_results(system, H, b, multipliers), expected, strict=True):
                np.testing.assert_array_equal(found, value)


def test_a_late_helper_does_not_touch_what_comes_later(threads_pay):
    """Rows, and the memory for them, change between two runs of the same list."""
    system = System(PATTERNS["slab"])
    b, solver = system.rng.standard_normal((system.count, 3)), system.solver
    assert solver.factor()
    rows = [system.constraint_rows(count) for count in (2, 30, 9, 17)]
    expected = [solver.condense(H, b) for H in rows]
    solver.use_threads(4)
    for _ in range(50):
        assert solver.factor()
        for H, value in zip(rows, expected, strict=True):
            found = (solver if len(H.row_index) < 50 else solver.with_other_rows()).condense(H, b)
            np.testing.assert_array_equal(found.W, value.W)
            np.testing.assert_array_equal(found.free, value.free)


@pytest.mark.parametrize("seed", range(5))
def test_an_indefinite_matrix_is_found_by_all_threads(seed, threads_pay):
    system = System(PATTERNS["grid"], seed)
    node = system.rng.integers(system.count)
    system.A[3 * node, 3 * node] *= -1.0
    system.solver.use_threads(3)
    system.assemble()
    assert not system.solver.factor()
    system.A[3 * node, 3 * node] *= -1.0
    system.assemble()
    assert system.solver.factor()
