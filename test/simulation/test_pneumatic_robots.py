"""The robots of the package that gas drives: Springy, the PneuNet gripper, the segment."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from softrobot_twin.simulation import (
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    Status,
)
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.tables.input_tables import read_commands, read_targets
from test.places import CONFIG
from test.scene_changes import LEFT_OUT, built, changed, entries_of, repeat_step

SCENES = CONFIG / "scenes"
GROWTH = 8.0e-6
AT_REST = 5.47e-6


def robot(name, change=None) -> Simulation:
    """A robot of the package; a function may change its scene first."""
    path = SCENES / f"{name}.yaml"
    return built(entries_of(path), change, path=path)


def settled(simulation, setpoints, steps=60, time_step=1.0):
    """The result at rest with these setpoints, reached in steps with one linearization each."""
    for _ in range(steps):
        result = simulation.step(CommandSetpoints(np.asarray(setpoints, float), time_step))
        if result.status is Status.OK and result.report.residual < 1e-9:
            return result
    raise AssertionError(f"{result.status}, a residual of {result.report.residual:g} N is left")


# --- Springy -------------------------------------------------------------------------------------


quadratic = changed({"body.mesh.file": "../../meshes/springy_400.msh", "body.element": "quadratic"})


@pytest.mark.sampled
@pytest.mark.parametrize("change", [None, quadratic], ids=["smoothed_964", "quadratic_400"])
def test_an_accordion_grows_by_more_than_its_own_volume_and_stays_straight(change):
    springy = robot("springy", change)
    assert springy.rest_setpoints == pytest.approx([AT_REST], rel=1e-6)
    tips, pressures = [], []
    for growth in np.linspace(0.0, GROWTH, 21):
        result = settled(springy, springy.rest_setpoints + growth)
        assert result.displacements == pytest.approx([growth], abs=1e-12)
        assert not result.report.projected_tangent
        tips.append(result.effector_positions[0])
        pressures.append(result.efforts[0])
    tips, steps = np.array(tips), np.diff(pressures)
    # No limit point: the pressure rises all the way, from a vacuum, because the weight pulls.
    assert (steps > 0.0).all() and pressures[0] < -100.0 < pressures[-1] < 400.0
    # The file gives the rotation with seven digits. Patches of volume are not symmetric.
    assert np.abs(tips[:, :2]).max() < (2e-8 if change else 5e-4)
    assert (np.diff(tips[:, 2]) < 0.0).all() and 14e-3 < tips[0, 2] - tips[-1, 2] < 18e-3


@pytest.mark.exhaustive
@pytest.mark.parametrize("change", [None, quadratic], ids=["smoothed_964", "quadratic_400"])
def test_a_grown_accordion_returns_after_a_push_to_the_side(change):
    springy = robot("springy", change)
    for growth in np.linspace(0.0, GROWTH, 11):
        before = settled(springy, springy.rest_setpoints + growth)
    positions = before.state.positions.copy()
    # Bent by a tenth of its length, more at the free end.
    depth = -positions[:, 2].clip(max=0.0)
    positions[:, 0] += 0.005 * (depth / depth.max()) ** 2
    springy.restore(replace(before.state, positions=positions))
    after = settled(springy, springy.rest_setpoints + GROWTH)
    assert after.effector_positions == pytest.approx(before.effector_positions, abs=1e-8)
    assert after.efforts == pytest.approx(before.efforts, rel=1e-6)


# --- the PneuNet gripper -------------------------------------------------------------------------


def about_z(points, turn):
    return Rotation.from_rotvec([0.0, 0.0, turn]).apply(points)


symmetric = changed({"bodies.*.volume": "per_element"})


@pytest.mark.sampled
@pytest.mark.parametrize("change, aside", [(symmetric, 1e-7), (None, 1e-3)],
                         ids=["per element", "patches"])  # fmt: skip
def test_three_fingers_at_one_pressure_are_turned_by_a_third(change, aside):
    """Patches of volume are not symmetric: with them a finger leaves its plane by a hair."""
    hand = robot("pneunet_inverse", change)
    result = settled(hand, [25e3, 25e3, 25e3])
    first, second, third = result.effector_positions
    hand.reset()
    rest = settled(hand, [0.0, 0.0, 0.0]).effector_positions
    # The file gives places to a micrometre.
    assert second == pytest.approx(about_z(first, 2 * np.pi / 3), abs=1e-6)
    assert third == pytest.approx(about_z(first, 4 * np.pi / 3), abs=1e-6)
    assert abs(first[1]) < aside
    # All bend inwards.
    assert np.linalg.norm(rest[:, :2], axis=1).min() - np.linalg.norm(first[:2]) > 8e-3


@pytest.mark.exhaustive
def test_the_layer_keeps_the_inner_side_of_a_finger_from_stretching():
    def stretch(change):
        """Share by which the middle line of a finger's inner side grows."""
        hand = robot("pneunet_inverse", change)
        nodes = hand.model.nodes.rest_positions
        line = np.flatnonzero(np.abs(nodes - [0.030, 0.0, 0.0])[:, :2].max(axis=1) < 1e-6)
        line = line[np.argsort(nodes[line, 2])]
        assert len(line) >= 10
        lengths = [
            np.linalg.norm(np.diff(settled(hand, [pressure, 0, 0]).state.positions[line], axis=0),
                           axis=1).sum()
            for pressure in (0.0, 25e3)
        ]  # fmt: skip
        return lengths[1] / lengths[0] - 1.0

    with_layer, without_layer = stretch(None), stretch(changed({"bodies.*.materials": LEFT_OUT}))
    assert 0.0 < with_layer < 0.6 * without_layer


@pytest.mark.exhaustive
def test_tips_follow_targets_on_their_curves():
    """At 50 Hz, the rate of the shipped twin; rows of the file are 0.05 s apart."""
    hand = robot("pneunet_inverse")
    table = read_targets(CONFIG / "targets" / "pneunet_tips.csv", hand)
    times = np.arange(0.0, table.times[-1] + 1e-9, 0.02)
    path = make_interp_spline(table.times, table.values, k=1)(times)
    repeat_step(hand, Hold(), 20)
    errors = []
    for targets in path:
        result = hand.step(FollowTargets(targets, 0.02))
        assert result.status in (Status.OK, Status.LINEARIZED)
        errors.append(np.linalg.norm(result.effector_positions - targets, axis=1).max())
    assert np.mean(errors) < 1e-5 and max(errors) < 1e-4


@pytest.mark.exhaustive
def test_the_gripper_lifts_its_ball_and_holds_it():
    hand = robot("pneunet")
    table = read_commands(CONFIG / "commands" / "pneunet_lift.csv", hand)
    ball = hand.rigid_names.index("ball")
    heights = {}
    for row in run_commands(hand, table, 100.0):
        assert row.result.status.is_success
        heights[round(row.time, 2)] = hand.rigid_poses()[0][ball]
        if row.time > 7.0:
            break
    assert heights[4.5][2] - heights[0.2][2] > 0.045
    # Held by friction alone: it does not sink.
    assert heights[7.0] == pytest.approx(heights[4.5], abs=1e-4)


# --- the segment ---------------------------------------------------------------------------------


def chamber(number, pressure):
    return pressure * np.eye(4)[number]


@pytest.mark.exhaustive
def test_four_chambers_bend_the_segment_by_quarters_of_a_turn():
    segment = robot("segment")
    tips = []
    for number in range(4):
        segment.reset()
        settled(segment, chamber(number, 5e3))
        tips.append(settled(segment, chamber(number, 10e3)).effector_positions[0])
    # The segment is upside down: its chambers follow each other clockwise.
    for number in range(4):
        assert tips[number] == pytest.approx(about_z(tips[0], -0.5 * np.pi * number), abs=1e-7)
    # Chamber 1 lies at x > 0, y < 0, and the tip moves away from it.
    # The inner nodes of a hexahedron are not those of its mirror image.
    assert tips[0][0] == pytest.approx(-tips[0][1], rel=3e-4) and tips[0][0] < -4e-3


def test_all_chambers_lengthen_the_segment_and_keep_it_straight():
    segment = robot("segment")
    rest = settled(segment, np.zeros(4)).effector_positions[0]
    tip = settled(segment, np.full(4, 10e3)).effector_positions[0]
    assert np.abs(tip[:2]).max() < 1e-7 and 11.5e-3 < rest[2] - tip[2] < 13e-3


@pytest.mark.exhaustive
def test_hoops_more_than_double_the_bending_and_keep_the_wall_from_bulging():
    bare = changed({"fibres": LEFT_OUT})
    tips, growths = [], []
    for change in (None, bare):
        segment = robot("segment", change)
        settled(segment, chamber(0, 3e3))
        result = settled(segment, chamber(0, 6.667e3))
        tips.append(np.linalg.norm(result.effector_positions[0, :2]))
        growths.append(result.displacements[0])
    assert 2.2 < tips[0] / tips[1] < 2.6 and growths[0] < 0.7 * growths[1]


@pytest.mark.exhaustive
def test_the_tip_of_the_segment_follows_a_circle_by_four_pressures():
    segment = robot("segment")
    centre, radius, errors = np.array([0.0, 0.0, -0.108]), 0.006, []
    statuses = set()
    for row in range(300):
        angle, share = 2.0 * np.pi * row / 200, min(1.0, row / 100)
        target = centre + share * radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        result = segment.step(FollowTargets(target[None], 0.05))
        assert (result.efforts >= -1e-6).all()
        if row >= 100:
            statuses.add(result.status)
        errors.append(np.linalg.norm(result.effector_positions[0] - target))
    assert statuses <= {Status.OK, Status.LINEARIZED, Status.RATE_LIMITED}
    assert max(errors[100:]) < 2e-4
