"""The PneuNet with gaps between its chambers."""

from itertools import pairwise

import numpy as np
import pytest

from meshes import make_fast_pneunet
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation, Status
from test.places import ROOT

SCENE = ROOT / "config" / "scenes" / "fast_pneunet.yaml"
GREATEST = 30.0e3


def curled(pressures, changes=None, **other):
    """Angle of the tip's face [rad] at each pressure, last result, nodes at rest."""
    finger = Simulation(load_scene(SCENE, changes or {}).changed(**other))
    rest = finger.state.positions
    face = np.flatnonzero(rest[:, 2] < rest[:, 2].min() + 1e-6)
    across = np.argmin(rest[face, 0]), np.argmax(rest[face, 0])
    for _ in range(10):
        finger.step(CommandSetpoints(np.zeros(1), 0.1))
    angles, pressure = [], 0.0
    for end in pressures:
        while pressure < end:
            pressure = min(pressure + 0.5e3, end)
            assert finger.step(CommandSetpoints(np.array([pressure]), 0.1)).status is Status.OK
        for _ in range(12):
            result = finger.step(CommandSetpoints(np.array([pressure]), 0.1))
        assert result.status is Status.OK
        positions = result.state.positions[face]
        run = positions[across[1]] - positions[across[0]]
        angles.append(np.arctan2(-run[2], run[0]))
    return np.unwrap(angles), result, rest


@pytest.fixture(scope="module")
def finger():
    return curled(np.linspace(0.0, GREATEST, 7)[1:])


@pytest.mark.exhaustive
def test_each_step_over_the_range_is_solved_and_more_pressure_curls_it_more(finger):
    angles = np.abs(finger[0])
    assert np.all(np.diff(angles) > np.radians(10.0))
    assert np.radians(160.0) < angles[-1] < np.radians(190.0)


@pytest.mark.exhaustive
def test_it_curls_in_its_plane_and_its_paper_keeps_its_length(finger):
    _, result, rest = finger
    assert abs(result.effector_positions[0, 1]) < 1e-3
    now = result.state.positions
    base = np.flatnonzero((rest[:, 0] < 2.1e-3) & (np.abs(rest[:, 1] - 9.5e-3) < 1e-6))
    heights = np.unique(rest[base, 2].round(6))
    middle = [positions[base[np.abs(rest[base, 2] - z) < 1e-6]].mean(axis=0)
              for positions in (rest, now) for z in heights]  # fmt: skip
    before, after = np.split(np.array(middle), 2)
    lengths = [sum(np.linalg.norm(b - a) for a, b in pairwise(line)) for line in (before, after)]
    assert lengths[1] == pytest.approx(lengths[0], rel=0.02)


@pytest.mark.exhaustive
def test_walls_that_touch_push_each_other_apart():
    touching, alone = (np.abs(curled([20.0e3], **other)[0][0])
                       for other in ({}, {"contact": None}))  # fmt: skip
    assert touching > 1.05 * alone


@pytest.mark.exhaustive
def test_dragon_skin_bends_further_than_elastosil():
    angles = [np.abs(curled([15.0e3], changes)[0][0])
              for changes in ({}, {"body.material": {"preset": "dragon_skin_30"}})]  # fmt: skip
    assert 1.1 * angles[0] < angles[1] < 1.5 * angles[0]


def test_the_chambers_hold_the_volume_of_their_dimensions():
    simulation = Simulation(load_scene(SCENE))
    chambers, channel = 7 * 8.0 * 15.0 * 25.0, 6 * (1.2 + 2.5 + 1.2) * 2.0 * 3.0
    volumes = simulation.model.actuators.terms[0].rest_volumes
    assert 1e9 * volumes == pytest.approx([chambers + channel])


@pytest.mark.exhaustive
def test_walls_of_three_times_as_many_nodes_that_touch_at_all_of_them_bend_it_as_far(tmp_path):
    """At 3, 10 and 20 kPa, where the walls are apart, touch, and press."""
    size, pressures = 3696, [3.0e3, 10.0e3, 20.0e3]
    assert make_fast_pneunet.main(["--size", str(size), "--output", str(tmp_path)]) == 0
    mesh = tmp_path / f"fast_pneunet_{size}.msh"
    rest = read_solid_mesh(mesh).mesh.node_positions
    points = []
    for gap in range(6):
        sides = 1e-3 * (10.4 + 12.9 * gap), 1e-3 * (12.9 + 12.9 * gap)
        on_wall = (np.abs(rest[:, 0] - sides[0]) < 1e-6) & (np.abs(rest[:, 1]) < 7.4e-3)
        on_wall &= (rest[:, 2] > 6.5e-3) & (rest[:, 2] < 26.5e-3)
        points += [{"point": [z, y, -sides[0]], "against": [z, y, -sides[1]]}
                   for _, y, z in rest[on_wall].tolist()]  # fmt: skip
    assert len(points) == 144
    fine = curled(pressures, {"body.mesh.file": str(mesh), "contact.points": points})[0]
    shipped = curled(pressures)[0]
    print(np.degrees(fine), np.degrees(shipped))
    np.testing.assert_allclose(shipped, fine, rtol=0.08)
