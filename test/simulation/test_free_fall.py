"""Bodies that nothing holds fall as backward Euler says: z_n = -g h² n (n + 1) / 2."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold

G = 9.81
HOUSE = {"centre": [0.0, 0.0, 0.0], "size": [0.02, 0.03, 0.04]}


def fallen(simulation, time_step, count):
    """Moves of all nodes against rest after each step [m], shape (count, node_count, 3)."""
    rest = simulation.model.nodes.rest_positions
    return np.array([simulation.step(Hold(time_step)).state.positions - rest for _ in range(count)])


def closed_form(time_step, count):
    n = np.arange(1, count + 1)
    return -0.5 * G * time_step**2 * n * (n + 1)


def check_fall(moves, tolerance):
    """All nodes fall alike, as long as ten steps of 10 ms."""
    expected = closed_form(0.01, 10)[:, None, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(moves, np.broadcast_to(expected, moves.shape), atol=tolerance)


@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_a_soft_body_falls_undeformed(simulate, body_of, block, element, mass):
    mesh = block(size=(0.04, 0.04, 0.06), cells=(2, 2, 3))
    soft = simulate(body=body_of(mesh, element=element, mass=mass), integration="dynamic")
    check_fall(fallen(soft, 0.01, 10), 1e-11)


def test_a_rigid_body_falls_without_rotation(simulate):
    falling = simulate(
        rigid_bodies=[
            {"name": "box", "box": HOUSE, "density": 1000.0, "rotation": [0.3, 0.2, 0.1]}
        ],
        integration="dynamic",
    )  # fmt: skip
    check_fall(fallen(falling, 0.01, 10), 1e-13)


def test_the_distance_fallen_converges_to_half_g_t_squared_with_the_time_step(simulate):
    errors = []
    for count in (10, 20, 40):
        falling = simulate(
            mass_springs=[{"name": "point", "points": [[0, 0, 0]], "masses": [0.1]}],
            integration="dynamic",
        )
        errors.append(fallen(falling, 0.4 / count, count)[-1, 0, 2] + 0.5 * G * 0.4**2)
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0, rtol=1e-9)
