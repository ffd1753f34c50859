"""Facts of obstacles in the inverse: between two of them, inside one, and past a thin one."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets
from test.scene_changes import repeat_step


def follow(simulation, target, steps, time_step=0.05):
    return repeat_step(simulation, FollowTargets(np.atleast_2d(target), time_step), steps)


def gap(simulation, x, z, radius) -> float:
    """Least distance of points all over the surface from a rod along y [m]."""
    grid = [(i / 12, j / 12) for i in range(13) for j in range(13 - i)]
    weights = np.array([(a, b, 1 - a - b) for a, b in grid])
    corners = simulation.surface_positions()[simulation.surface_triangles]
    points = np.einsum("gk,tki->gti", weights, corners).reshape(-1, 3)
    return float(np.linalg.norm(points[:, [0, 2]] - [x, z], axis=1).min() - radius)


@pytest.mark.sampled
@pytest.mark.parametrize("way", [[0.02, 0.0, -0.01], [-0.02, 0.0, -0.01], [0.0, 0.008, -0.012]])
def test_a_beam_between_two_rods_crosses_neither(beam, rod, way):
    """Row 26: 1 mm is free on one side, 0.5 mm on the other."""

    def wedge(mapping):
        rod(mapping, x=0.026, z=0.05, name="right")
        rod(mapping, x=-0.0055, z=0.07, name="left")

    simulation = beam(wedge)
    target = simulation.effector_positions()[0] + way
    touched = 0
    for _ in range(60):
        result = follow(simulation, target, 1)
        gaps = simulation.model.contacts.gaps(simulation.state.positions)
        assert gaps.min(initial=0.0) > -1e-8
        assert gap(simulation, 0.026, 0.05, 0.005) > -2e-5
        assert gap(simulation, -0.0055, 0.07, 0.005) > -2e-5
        touched = max(touched, len(result.contacts.forces))
    assert touched > 0
    before = result.setpoints
    result = follow(simulation, target, 100)
    np.testing.assert_allclose(result.setpoints, before, atol=1e-6)


@pytest.mark.parametrize("way", [[0.01, 0.0, -0.002], [-0.01, 0.0, -0.002]])
def test_an_overlap_of_5_mm_with_a_rod_ends_at_the_push_out_speed(beam, rod, way):
    """Row 27, while the tip is driven further in or out."""
    speed, time_step, radius = 0.02, 0.01, 0.02
    x = 0.02 + radius - 0.005
    simulation = beam(lambda m: rod(m, x=x, z=0.08, radius=radius, push_out_speed=speed))
    target = simulation.effector_positions()[0] + way
    depth = [gap(simulation, x, 0.08, radius)]
    assert depth[0] == pytest.approx(-5e-3, abs=1e-4)
    for _ in range(60):
        before = simulation.effector_positions()
        result = follow(simulation, target, 1, time_step)
        assert not result.status.is_failure
        depth.append(gap(simulation, x, 0.08, radius))
        # Cables and push-out may add up, but nothing is thrown.
        assert np.linalg.norm(result.effector_positions - before) < 4e-3
    assert depth[-1] > -5e-5
    if way[0] > 0.0:
        assert np.diff(depth).max() < 1.2 * speed * time_step


@pytest.mark.parametrize("distance", [0.03, 0.3])
def test_a_fast_target_beyond_a_thin_rod_does_not_pull_the_tip_through(beam, rod, distance):
    """Row 28: the rod is 1 mm thick, the cables move by 20 mm in a step."""
    simulation = beam(lambda m: rod(m, x=0.024, z=0.08, radius=0.0005))
    home = simulation.effector_positions()[0]
    for step in range(40):
        way = distance if step % 4 < 2 else -distance
        follow(simulation, home + [way, 0.0, -0.01], 1, 10.0)
        corners = simulation.surface_positions()
        # Ways are long against the rod, so a linearization dents it; a fifth of its thickness is
        # the bar. The beam's right side is still on the left of the rod, at the rod's height.
        assert gap(simulation, 0.024, 0.08, 0.0005) > -2e-4
        near = corners[np.abs(corners[:, 2] - 0.08) < 0.011]
        assert near[:, 0].mean() < 0.024


def test_the_inverse_solution_is_an_equilibrium_with_its_lengths_held(beam, rod):
    inverse, direct = beam(rod), beam(rod)
    target = inverse.effector_positions()[0] + [0.02, 0.002, -0.008]
    found = follow(inverse, target, 80)
    same = repeat_step(direct, CommandSetpoints(found.setpoints, 0.05), 60)
    np.testing.assert_allclose(same.state.positions, found.state.positions, atol=1e-7)
    np.testing.assert_allclose(same.efforts, found.efforts, atol=1e-3)
    np.testing.assert_allclose(same.contacts.forces.sum(axis=0), found.contacts.forces.sum(axis=0), atol=1e-4)
