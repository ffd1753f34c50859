"""Sums of normal forces as sensors: what they show, how commands change them, and targets for them."""

import numpy as np
import pytest

from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.simulation import CommandSetpoints, FollowTargets
from softrobot_twin.study.offline_run import columns_of, run
from softrobot_twin.tables.input_tables import read_targets
from test.builder import builder
from test.scene_changes import built, repeat_step

TOUCH = {"name": "touch", "contact": ["wall", "finger"], "full_scale": 1.0, "weight": 1.0}
BENT = np.array([0.004, 0.001])


@builder
def finger(sensor=TOUCH, effector=(), contact=()):
    """Makes a slim finger with two cables before a wall 3 mm away."""
    cables = [{"name": name, "pull_point": [x, 0.005, -0.01], "points": [[x, 0.005, 0.02], [x, 0.005, 0.055]],
               "shortening": [0.0, 0.02]} for name, x in (("near", 0.009), ("far", 0.001))]  # fmt: skip
    return built({
        "name": "finger", "gravity": [0.0, 0.0, 0.0], "cables": cables, "sensors": [dict(sensor)],
        "body": {"name": "finger", "mesh": {"box": {"size": [0.01, 0.01, 0.06], "cells": [2, 2, 10]}},
                 "material": {"young_modulus": 3e5, "poisson_ratio": 0.3, "density": 1000.0}, "element": "smoothed",
                 "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}]},
        "obstacles": [{"name": "wall", "plane": {"point": [0.013, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]}}],
        "contact": {"between": [{"pair": ["finger", "wall"]}], "alarm_distance": 0.01, **dict(contact)},
        "effectors": [{"name": "tip", "points": [[0.005, 0.005, 0.06]], "directions": ["x"], **dict(effector)}],
        "solver": {"newton_iterations": 20},
    })  # fmt: skip


def bend(robot, shortening=BENT, steps=10):
    result = repeat_step(robot, CommandSetpoints(robot.rest_setpoints - shortening, 1.0), steps)
    return result, robot.state.memory["sensors.force"][0, 0]


def follow(robot, force, x=np.nan, steps=8):
    target = FollowTargets(np.array([[x, np.nan, np.nan]]), 1.0, sensors=np.array([force]))
    return repeat_step(robot, target, steps).status.value, robot.state.memory["sensors.force"][0, 0]


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_the_force_of_a_pair_is_shown_with_friction_and_without(finger, friction):
    result, force = bend(finger({**TOUCH, "weight": None}, contact={"friction": friction}))
    normal = abs(result.contacts.of_pairs().resultants[0, 0])
    assert force == pytest.approx(normal, rel=1e-6) and force > 0.05


@pytest.mark.parametrize("bent, presses", [(BENT, True), (np.array([0.001, 0.0008]), False)])
def test_what_a_linearization_says_of_the_force_or_of_the_gap_is_its_slope(finger, bent, presses):
    robot = finger()
    bend(robot, bent)
    linear, (a, e, c) = robot.newton.tangent.linear, robot.newton.tangent.linear.groups
    pressing = c.start + np.flatnonzero(robot.model.contacts.memory.forces[:, 0] > 0.0)
    assert (len(pressing) > 0) == presses
    unknowns = np.concatenate([np.arange(a.stop), pressing])
    change = np.linalg.lstsq(linear.W[np.ix_(unknowns, unknowns)], np.eye(len(unknowns))[:, : a.stop], rcond=1e-12)[0]

    def shown(shortening):
        bend(robot, shortening)
        return robot.newton.tangent.linear.effectors_now[-1]

    ends = [[shown(bent + step * way) for step in (1e-6, -1e-6)] for way in np.eye(2)]
    np.testing.assert_allclose(linear.W[e.stop - 1, unknowns] @ change, -np.diff(ends, axis=1)[:, 0] / 2e-6, rtol=1e-5)


@pytest.mark.parametrize("sensor, contact, words", [
    ({**TOUCH, "contact": ["finger", "wal"]}, {}, "no pair of contact.between, which has finger with wall"),
    ({**TOUCH, "full_scale": None}, {}, "full_scale.*goes with contact"),
    (TOUCH, {"friction": 0.5}, "not built beside friction of contacts"),
])  # fmt: skip
def test_what_does_not_fit_is_refused(finger, sensor, contact, words):
    with pytest.raises(SceneError, match=words):
        finger(sensor, contact=contact)


def test_a_place_leads_to_the_touch_and_a_force_of_more_weight_decides_there_also_from_a_file(finger, tmp_path):
    robot, path = finger(effector={"weight": 0.01}), tmp_path / "targets.csv"
    for force in (0.05, 0.2):
        assert follow(robot, force, x=0.0085) == ("unreachable", pytest.approx(force, abs=2e-4))
    path.write_text("time_s,tip_x_m,tip_y_m,tip_z_m,touch_force_N\n0,0.0085,0.005,0.06,0.1\n5,0.0085,0.005,0.06,0.1\n")
    columns = columns_of(robot, table := read_targets(path, robot))
    told = dict(zip(columns.names, columns.cells(list(run(robot, table, 0, columns))[-1]), strict=True))
    assert (told["touch_force_N"], told["touch_target_force_N"]) == (pytest.approx(0.1, abs=2e-4), 0.1)


def test_a_force_alone_brings_the_finger_to_the_wall_and_is_reached_there(finger):
    robot = finger()
    for force in (0.05, 0.3, 0.1, 0.0):
        assert follow(robot, force) == ("ok", pytest.approx(force, abs=1e-5))


def test_a_force_where_nothing_touches_is_named_after_its_sensor(finger):
    robot = finger(contact={"alarm_distance": 0.002})
    result = repeat_step(robot, FollowTargets(np.full((1, 3), np.nan), 1.0, sensors=np.array([0.1])), 4)
    assert (result.status.value, result.report.active_limits) == ("saturated", ("touch.apart",))


def test_no_force_is_wanted_beside_a_place_away_from_the_wall_and_one_below_zero_is_refused(finger):
    assert follow(finger(), 0.0, x=0.006) == ("ok", 0.0)
    with pytest.raises(CommandError, match="contacts only press"):
        follow(finger(), -0.1)
