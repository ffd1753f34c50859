"""Facts of what cubic bubbles add to quadratic elements."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.cubic_bubbles import add_bubbles
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.mechanics.cubic_correction import CubicCorrection, CubicPart
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws.small_displacement import SmallDisplacement
from softrobot_twin.mechanics.material import lame_parameters

LAME = lame_parameters(1.0e5, 0.4)


def small_displacement(mesh, free_index, lame):
    return Elements(mesh, free_index, SmallDisplacement(*lame))


@pytest.fixture
def free(block):
    """A body that nothing holds, with its bubbles: its mesh and its correction."""
    mesh = add_mid_edge_nodes(block(cells=(1, 1, 2)))
    cubic = add_bubbles(mesh)
    index = np.arange(mesh.node_count + len(cubic.bubble_corners))
    part = CubicPart(cubic, 0, LAME, 1000.0, True)
    return mesh, CubicCorrection([part], index, mesh.node_count)


def turned(mesh):
    rotation = Rotation.from_rotvec([0.4, -0.9, 0.7]).as_matrix()
    return rotation, mesh.node_positions @ rotation.T + [0.1, 0.2, -0.3]


def test_a_rigid_motion_loads_no_bubble(free):
    mesh, correction = free
    for positions in (mesh.node_positions, turned(mesh)[1]):
        assert np.abs(correction.linearize(positions)).max() < 1e-9


def test_the_stiffness_is_symmetric(free):
    mesh, correction = free
    rng = np.random.default_rng(3)
    correction.linearize(turned(mesh)[1] + 1e-2 * rng.standard_normal((mesh.node_count, 3)))
    a, b = rng.standard_normal((2, mesh.node_count + correction.bubble_count, 3))
    assert np.vdot(a, correction.multiply(b)) == pytest.approx(np.vdot(b, correction.multiply(a)), rel=1e-10)


def test_at_rest_the_nodes_have_the_stiffness_of_quadratic_elements(free, bind):
    mesh, correction = free
    correction.linearize(mesh.node_positions)
    move = np.random.default_rng(4).standard_normal((mesh.node_count, 3))
    bound = bind((lambda *given: small_displacement(*given[:2], LAME), mesh, 1.0, 0.0))
    forces, _ = bound.forces(mesh.node_positions + move)
    whole = np.concatenate([move, np.zeros((correction.bubble_count, 3))])
    np.testing.assert_allclose(correction.multiply(whole)[: mesh.node_count], -forces, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("at_rest", [True, False], ids=["at rest", "turned"])
def test_the_stiffness_is_the_derivative_of_the_forces_on_the_bubbles(free, at_rest):
    mesh, correction = free
    positions = mesh.node_positions if at_rest else turned(mesh)[1]
    move = 0.1 * np.random.default_rng(5).standard_normal((mesh.node_count, 3))
    step = 1e-6
    forward, backward = (
        correction.linearize(positions + sign * step * move).copy() for sign in (1.0, -1.0)
    )
    correction.linearize(positions)
    whole = np.concatenate([move, np.zeros((correction.bubble_count, 3))])
    expected = -correction.multiply(whole)[mesh.node_count :]
    difference = (forward - backward) / (2.0 * step)
    np.testing.assert_allclose(difference, expected, atol=1e-6 * np.abs(expected).max())


def test_the_correction_solves_its_equations(block):
    mesh = add_mid_edge_nodes(block(cells=(1, 1, 2)))
    cubic = add_bubbles(mesh)
    held = mesh.node_positions[:, 2] < 1e-9
    bubbles_held = held[cubic.bubble_corners].all(axis=1)
    free = np.concatenate([~held, ~bubbles_held])
    index = np.where(free, np.cumsum(free) - 1, -1)
    correction = CubicCorrection([CubicPart(cubic, 0, LAME, 1000.0, True)], index, int((~held).sum()))
    correction.linearize(mesh.node_positions)
    size, nodes = 3 * int(free.sum()), correction.node_unknowns
    whole = np.stack([correction.multiply(unit.reshape(-1, 3)).ravel() for unit in np.eye(size)])
    soft = whole[: 3 * nodes, : 3 * nodes]

    def solve_nodes(forces):
        return np.linalg.solve(soft, forces.ravel()).reshape(-1, 3)

    weight = correction.weight(np.array([0.0, 0.0, -9.81]))
    right = np.concatenate([np.zeros(3 * nodes), weight.ravel()])
    expected = np.linalg.solve(whole, right)[3 * nodes :].reshape(-1, 3)
    found = correction.solve(weight, solve_nodes)
    # Conjugate gradients end where the energy is known to some thousandths.
    assert np.vdot(weight, found) == pytest.approx(np.vdot(weight, expected), rel=5e-3)
