"""Facts of weight."""

import numpy as np
import pytest

from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.inertia import borne_masses


def test_nodes_weigh_what_the_body_weighs(block):
    mesh = block()
    assert borne_masses(mesh, 1070.0).sum() == pytest.approx(1070.0 * mesh.volume)


def test_weight_acts_along_gravity_on_free_nodes_only(block):
    mesh = block()
    free = np.arange(5, mesh.node_count)
    forces = np.ones((len(free), 3))
    masses = borne_masses(mesh, 1000.0)[free]
    Gravity(masses, np.array([0.0, -9.81, 0.0])).add_forces(None, forces)
    np.testing.assert_allclose(forces - 1.0, np.outer(masses, [0.0, -9.81, 0.0]), atol=1e-12)
