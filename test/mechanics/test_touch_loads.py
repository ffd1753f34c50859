"""Loads of touches: given forces, and points held at a place."""

import numpy as np

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.touch_loads import TouchLoads
from test.finite_differences import assert_stiffness_of_forces, forces_of, slots_of_dense

NODES = np.array([[0, 1, 2, 3], [4, 2, 1, 0]])
WEIGHTS = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.25, 0.25, 0.0]])
FREE = np.array([-1, 0, 1, 2, 3])
COUNT = 4
RANK = np.array([2, 0, 3, 1])


def touches() -> TouchLoads:
    """Two points on five nodes, of which the first is fixed; the second slides along x and y."""
    axes = np.array([[True, True, True], [False, False, True]])
    term = TouchLoads(BarycentricMapping(NODES, WEIGHTS), axes, np.array([500.0, 200.0]), FREE)
    term.bind(RANK, slots_of_dense(COUNT))
    return term


def positions() -> np.ndarray:
    return np.random.default_rng(3).uniform(-0.1, 0.1, (5, 3))


def test_a_force_is_spread_over_the_nodes_that_carry_the_point():
    term, x = touches(), positions()
    given = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert not term.load(given, np.full((2, 3), np.nan))
    forces = forces_of(term, x, COUNT)
    # Node 0 is fixed and takes a tenth of the first force; the second acts along z alone.
    assert np.allclose(forces.sum(axis=0), 0.9 * given[0] + [0.0, 0.0, 6.0])
    assert np.allclose(forces[3], [0.0, 0.0, 3.0])
    storage = np.zeros(9 * COUNT**2)
    term.add(x, np.zeros((COUNT, 3)), storage, False)
    assert not storage.any()


def test_the_stiffness_of_a_held_point_is_the_derivative_of_its_force():
    term, x = touches(), positions()
    assert term.load(np.ones((2, 3)), np.full((2, 3), 0.02))
    found = assert_stiffness_of_forces(term, x, FREE, 1e-6)
    assert np.linalg.eigvalsh(found).min() > -1e-9


def test_a_point_without_a_touch_adds_nothing():
    term, x = touches(), positions()
    term.load(np.ones((2, 3)), np.full((2, 3), np.nan))
    assert not term.load(np.zeros((2, 3)), np.full((2, 3), np.nan))
    assert not term.is_active and not forces_of(term, x, COUNT).any()
