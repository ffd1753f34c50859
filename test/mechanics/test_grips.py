"""Grips: the stiffness is the derivative of the force, and that of the energy."""

import numpy as np
import pytest

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.grips import Grips
from softrobot_twin.mechanics.rotation import rotation_from_vector
from test.finite_differences import (
    assert_stiffness_of_forces,
    central_slopes,
    forces_of,
    slots_of_dense,
)

# Five nodes of a body, of which the first is fixed, then the four of a frame.
NODES = np.array([[0, 1, 2, 3], [4, 2, 1, 0], [1, 2, 3, 4]])
WEIGHTS = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.25, 0.25, 0.0], [0.1, 0.1, 0.2, 0.6]])
FREE = np.array([-1, 0, 1, 2, 3, 4, 5, 6, 7])
COUNT = 8
RANK = np.array([2, 0, 3, 1, 7, 5, 4, 6])


def grips() -> Grips:
    """One grip of two points on the frame, and one of a point on the world."""
    term = Grips(BarycentricMapping(NODES, WEIGHTS), np.array([0, 0, 1]), np.array([5, -1]),
                 np.array([300.0, 500.0, 200.0]), FREE)  # fmt: skip
    term.bind(RANK, slots_of_dense(COUNT))
    return term


def positions(seed=3) -> np.ndarray:
    x = np.random.default_rng(seed).uniform(-0.1, 0.1, (9, 3))
    x[6:] = x[5] + rotation_from_vector(np.array([0.3, -0.5, 0.2])).T
    return x


@pytest.mark.parametrize("held", [(True, False), (False, True), (True, True)])
def test_the_stiffness_is_the_derivative_of_the_force_and_that_of_the_energy(held):
    term, x = grips(), positions()
    for grip, holds in enumerate(held):
        term.take_hold(grip, holds, x)
    assert np.abs(forces_of(term, x, COUNT)).max() < 1e-13
    x = positions(seed=4)
    assert_stiffness_of_forces(term, x, FREE, 1e-5)
    free = np.flatnonzero(FREE >= 0)
    slope = -central_slopes(term.energy, x, free, 1e-6)
    assert np.allclose(forces_of(term, x, COUNT).ravel(), slope, rtol=1e-6, atol=1e-7)
    assert np.abs(term.forces(x)[list(held)]).max() > 1.0


def test_a_grip_that_does_not_hold_adds_nothing():
    term, x = grips(), positions()
    term.take_hold(0, True, x)
    term.take_hold(0, False, x)
    storage = np.zeros(9 * COUNT**2)
    term.add(positions(seed=4), np.zeros((COUNT, 3)), storage, False)
    assert not storage.any() and term.energy(positions(seed=4)) == 0.0
