"""Names and units of commands, and what is said about wrong ones."""

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Touched,
)

STEP = 0.02


def refusal(call) -> str:
    """The message by which something is refused."""
    with pytest.raises(st.SoftRobotTwinError) as caught:
        call()
    return str(caught.value)


def same(robot, result, command, touched=None) -> bool:
    """Whether a command in arrays, from rest, leads to the same state, to the bit."""
    robot.reset()
    other = robot.simulation.step(command, None, touched).state
    return np.array_equal(result.positions, other.positions) and np.array_equal(
        result.outcome.efforts, other.efforts)


def test_targets_by_name_are_those_in_arrays(finger):
    result = finger.step(st.targets(tip=[0.1, 0.01, 0.012]))
    assert same(finger, result, FollowTargets(np.array([[0.1, 0.01, 0.012]]), STEP))


def test_an_actuator_is_commanded_while_the_others_are_optimised(finger):
    result = finger.step(st.targets(tip=[0.1, 0.01, 0.012], lower_shortening_m=0.0005))
    rest = finger.simulation.rest_setpoints[1]
    assert same(finger, result, FollowTargets(
        np.array([[0.1, 0.01, 0.012]]), STEP, np.array([np.nan, rest - 0.0005])))
    assert result["lower_shortening_m"] == pytest.approx(0.0005, abs=1e-12)


def test_an_orientation_is_a_part_of_targets(held):
    turn = np.array([0.0, -np.sin(0.05), 0.0, np.cos(0.05)])
    result = held.step(st.targets(tip=[0.1, 0.01, 0.012], tip_quaternion=turn))
    assert same(held, result, FollowTargets(
        np.array([[0.1, 0.01, 0.012]]), STEP, None, turn[None] / np.linalg.norm(turn)))
    assert result.orientations["tip"][3] == pytest.approx(1.0, abs=0.01)


def test_a_stiffness_is_a_part_of_targets_and_none_leaves_an_axis_free(entries):
    entries["effectors"][0]["stiffness"] = {"weight": 0.1}
    robot = st.build(**entries)
    assert robot.target_names == ("tip", "tip_stiffness_N_per_m")
    result = robot.step(st.targets(tip=[0.1, 0.01, 0.012], tip_stiffness_N_per_m=[None, None, 50.0]))
    assert result["tip_target_kz_N_per_m"] == 50.0
    assert "tip_target_kx_N_per_m" not in result.values
    assert same(robot, result, FollowTargets(
        np.array([[0.1, 0.01, 0.012]]), STEP, None, None, np.array([[np.nan, np.nan, 50.0]])))
    assert "must be positive" in refusal(
        lambda: robot.step(st.targets(tip_stiffness_N_per_m=[None, None, -1.0])))


def test_what_setpoints_do_not_name_keeps_its_setpoint(finger):
    first = finger.step(st.setpoints(upper_shortening_m=0.001))
    second = finger.step(st.setpoints(lower_shortening_m=0.001))
    assert second["upper_length_m"] == first["upper_length_m"]
    rest = finger.simulation.rest_setpoints
    assert first["upper_length_m"] == rest[0] - 0.001


def test_lengths_and_shortenings_are_the_same_setpoints(finger):
    length = float(finger.simulation.rest_setpoints[0]) - 0.0005
    by_length = finger.step(st.setpoints(upper_length_m=length))
    rest = finger.simulation.rest_setpoints
    assert same(finger, by_length, CommandSetpoints(np.array([length, rest[1]]), STEP))


def test_efforts_by_name_are_those_in_arrays(finger):
    result = finger.step(st.efforts(upper_tension_N=1.0))
    assert same(finger, result, CommandEfforts(np.array([1.0, np.nan]), STEP))


def test_hold_is_the_default(finger):
    assert same(finger, finger.step(), Hold(STEP))


def test_guided_bodies_go_to_poses_by_name(held):
    result = held.step(poses={"palm": [-0.009, 0.01, 0.01]})
    assert result.poses["palm"].position == pytest.approx([-0.009, 0.01, 0.01])
    # No faster than 0.1 m/s, and on its way without being told again.
    held.step(poses={"palm": ([0.01, 0.01, 0.01], [0, 0, 0, 1])})
    assert held.step().poses["palm"].position[0] == pytest.approx(-0.005)


def test_a_touch_by_force_is_that_in_arrays(held):
    result = held.step(touches={"fingertip_force_N": [0, 0, -0.2]})
    none = np.full((1, 3), np.nan)
    assert same(held, result, Hold(STEP), Touched(np.array([[0, 0, -0.2]]), none))
    assert result["fingertip_force_z_N"] == pytest.approx(-0.2)


def test_a_displacement_of_a_touch_counts_from_where_it_began(held):
    assert held.settle().is_at_rest
    held.step(touches={"fingertip_displacement_m": [0, 0, -0.0005]})
    result = held.step(touches={"fingertip_displacement_m": [0, 0, -0.001]})
    force, displacement = result.touches["fingertip"]
    assert displacement[2] == pytest.approx(-0.001, abs=1e-4)
    assert force[2] < 0.0


@pytest.mark.parametrize(("wrong", "said"), [
    (st.setpoints(upper_shortening_mm=10), "is upper_shortening_m meant?"),
    (st.setpoints(uper_shortening_m=0.01), "is upper_shortening_m meant?"),
    (st.targets(tipp=[0, 0, 0]), "is tip meant?"),
    (st.targets(nose=[0, 0, 0]), "nose: is unknown here; "),
    (st.targets(tip=[0, 0]), "must be 3 numbers, not 2"),
    (st.targets(tip_x_m=0.1), "tip_x_m: is unknown here; "),
    (st.targets(tip_quaternion=[0, 0, 0, 1]), "asks for no orientation"),
    (st.targets(tip_stiffness_N_per_m=[1, None, None]), "asks for no stiffness"),
    (st.setpoints(tip=[0, 0, 0.1]), "is an effector: use targets(tip=[x, y, z])"),
    (st.setpoints(upper_tension_N=1), "use efforts(upper_tension_N=...)"),
    (st.efforts(upper_shortening_m=0.01), "use setpoints(upper_shortening_m=...)"),
    (st.efforts(upper_tension_N=-1), "a cable cannot push"),
    (st.setpoints(upper_length_m=-1), "-1 m must not be negative"),
    (st.setpoints(upper_length_m=0.1, upper_shortening_m=0.0), "drives upper, as upper_length_m"),
    (st.setpoints(upper_length_m=[0.1, 0.1]), "must be one number, not 2"),
    ("tip", "is no command"),
])  # fmt: skip
def test_a_command_that_does_not_fit_is_refused_by_name_and_moves_nothing(finger, wrong, said):
    before = finger.state
    assert said in refusal(lambda: finger.step(wrong))
    assert finger.state is before


@pytest.mark.parametrize(("call", "said"), [
    *((lambda odd=odd: st.targets(tip=[0, 0, odd]), "tip: holds nan") for odd in (float("nan"), None)),
    *((lambda odd=odd: st.targets(tip=[odd] * 3), "tip: must be a number or") for odd in ("1", 1j, True)),
    (lambda: st.setpoints(upper_length_m=float("inf")), "upper_length_m: holds inf"),
    (lambda: st.targets(tip="up"), "must be a number or a list of numbers, not 'up'"),
    (lambda: st.targets(tip=np.zeros((2, 3))), "not an array of shape (2, 3)"),
    (lambda: st.setpoints(upper_length_m=True), "not True"),
    (lambda: st.targets([0, 0, 0]), "takes names"),
    (lambda: st.setpoints(), "names nothing; hold() keeps"),
    (lambda: st.setpoints({"upper_length_m": 0.1}, upper_length_m=0.1), "is given twice"),
])
def test_numbers_are_checked_before_there_is_a_robot(call, said):
    assert said in refusal(call)


@pytest.mark.parametrize(("more", "said"), [
    ({"poses": {"plam": [0, 0, 0]}}, "is palm meant?"),
    ({"poses": {"palm": [0, 0]}}, "a pose is a position of 3 numbers"),
    ({"poses": {"palm": ([0, 0, 0], [0, 0, 0, 2])}}, "is no quaternion"),
    ({"poses": {"palm": [0, 0, float("nan")]}}, "palm: holds nan"),
    ({"touches": {"fingertip_force_mN": [0, 0, 1]}}, "is fingertip_force_N meant?"),
    ({"touches": {"fingertip_force_N": 1.0}}, "must be 3 numbers, not 1"),
    ({"touches": {"fingertip_force_N": [0, 0, 1], "fingertip_place_m": [0, 0, 0]}},
     "fingertip is given twice"),
    ({"poses": [0, 0, 0]}, "poses: takes names"), ({"touches": 1.0}, "touches: takes names"),
    ({"time_step": -1.0}, "must be above 0"), ({"time_step": float("nan")}, "time_step: holds nan"),
    ({"time_step": "fast"}, "time_step: must be a number"),
])
def test_what_surrounds_a_step_is_checked_before_anything_moves(held, more, said):
    before = held.state
    assert said in refusal(lambda: held.step(**more))
    assert held.state is before


def test_a_scene_without_guided_bodies_and_touches_says_so(finger):
    assert "guided bodies: none" in refusal(lambda: finger.step(poses={"palm": [0, 0, 0]}))
    assert "touches: none" in refusal(lambda: finger.step(touches={"hand_force_N": [0, 0, 0]}))


def test_targets_in_millimetres_are_warned_of_once(finger):
    with pytest.warns(st.SceneWarning, match="are the targets in metres"):
        finger.step(st.targets(tip=[100.0, 10.0, 12.0]))


def test_a_robot_tells_the_names_that_it_takes(held):
    assert held.setpoint_names == (
        "upper_shortening_m", "upper_length_m", "lower_shortening_m", "lower_length_m")
    assert held.effort_names == ("upper_tension_N", "lower_tension_N")
    assert held.target_names == ("tip", "tip_quaternion")
