"""Springs whose ends leave little to pull at, or nothing."""

import numpy as np

from softrobot_twin.mechanics.barycentric import BarycentricMapping

POINTS = np.array([[0.05, -0.1, 0.2], [0.0, 0.0, 0.0], [-0.2, 0.1, 0.1]])


def test_a_spring_between_two_points_of_one_rigid_body_has_no_effect(world):
    points = world.frames.points(0, POINTS)
    first, second = (BarycentricMapping(points.nodes[i], points.barycentric_weights[i])
                     for i in ([0, 1], [1, 2]))  # fmt: skip
    term, matrix = world.springs(first, second, 60.0, 0.01)
    x = world.shaken()
    assert term.energy(x) > 0.1
    np.testing.assert_allclose(world.forces(term, x), 0.0, atol=1e-13)
    np.testing.assert_allclose(world.stiffness(term, matrix, x), 0.0, atol=1e-13)


def test_a_spring_without_length_and_rest_length_is_a_linear_one(world):
    x = world.positions
    term, matrix = world.springs(world.nodes(1), None, 60.0, 0.0, offsets=x[[1]])
    np.testing.assert_array_equal(world.forces(term, x), 0.0)
    K = world.stiffness(term, matrix, x)
    np.testing.assert_array_equal(K[:3, :3], 60.0 * np.eye(3))
    away = x.copy()
    away[1] += [1e-12, 2e-12, 0.03]
    np.testing.assert_allclose(world.forces(term, away)[0], 60.0 * (x - away)[1], rtol=1e-12)
    np.testing.assert_allclose(world.stiffness(term, matrix, away), K, atol=1e-12)


def test_a_spring_compressed_to_zero_length_has_zero_and_finite_force(world):
    term, matrix = world.springs(world.nodes(1), None, 60.0, 0.5, offsets=world.positions[[1]])
    np.testing.assert_array_equal(world.forces(term, world.positions), 0.0)
    K = world.stiffness(term, matrix, world.positions)
    np.testing.assert_array_equal(K[:3, :3], 60.0 * np.eye(3))


def test_a_spring_at_the_centre_of_a_body_gives_no_torque(world):
    term, _ = world.springs(
        world.frames.points(0, [[0.0, 0.0, 0.0]]), None, 60.0, 0.1, offsets=[[1.0, 1.0, 1.0]]
    )
    forces = world.forces(term, world.positions)
    assert np.linalg.norm(forces[world.frames.translations[0]]) > 1.0
    np.testing.assert_array_equal(forces[world.frames.rotations], 0.0)
