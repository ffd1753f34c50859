"""A cable without tension forbids nothing, wherever the limit of its winch is."""

import numpy as np
import pytest

import softrobot_twin as st
from test.cable_bar import LENGTH, WIDTH, cable_bar
from test.scene_changes import repeat_step

LIMITED, RATE = 0.002, 0.01


def bar(places=(0.4, 0.6), effector=None, **of_other):
    """A bar with two cables on the same side, at these shares of its width.

    Args:
        places: Where the cables are.
        effector: Further entries of the effector.
        **of_other: Limits of the second cable.
    """
    def cable(name, y, **limits):
        points = [[share * LENGTH, y, 0.9 * WIDTH] for share in (0.25, 0.5, 0.75, 1.0)]
        return dict(name=name, pull_point=[0, y, 0.9 * WIDTH], points=points, **limits)

    cables = [cable("long", places[0] * WIDTH, shortening=[0, 0.02]),
              cable("other", places[1] * WIDTH, **of_other)]  # fmt: skip
    tip = dict(name="tip", points=[[LENGTH, WIDTH / 2, WIDTH / 2]], directions=["z"])
    return cable_bar(cables, [tip | (effector or {})], 8, 3e5, newton_iterations=20, residual_tolerance=1e-8)


def tensions(result):
    return np.array([result["long_tension_N"], result["other_tension_N"]])


@pytest.fixture(scope="module")
def limited():
    return bar(shortening=[0, LIMITED])


def test_a_pose_that_commanded_lengths_reach_is_reached_past_a_slack_cable_at_its_limit(limited, drawn_rng):
    long = drawn_rng.uniform(0.003, 0.012)
    limited.reset()
    goal = limited.settle(st.setpoints(long_shortening_m=long, other_shortening_m=0.0)).tip.copy()
    limited.reset()
    result = limited.settle(st.targets(tip=goal.tolist()))
    assert result.status.value == "ok"
    assert abs(result.tip[2] - goal[2]) <= 1e-7
    assert result["other_tension_N"] <= 1e-9 * result["long_tension_N"]
    assert result["other_shortening_m"] == pytest.approx(LIMITED)
    assert result.active_limits == ()


def test_it_comes_back_to_a_pose_where_both_cables_pull(limited):
    limited.reset()
    near = tensions(limited.settle(st.targets(tip=[LENGTH, 0.01, 0.0105])))
    far = limited.settle(st.targets(tip=[LENGTH, 0.01, 0.036]))
    assert far.status.value == "ok" and far["other_tension_N"] == 0.0
    again = limited.settle(st.targets(tip=[LENGTH, 0.01, 0.0105]))
    assert again.status.value == "ok"
    np.testing.assert_allclose(tensions(again), near, rtol=1e-3)
    assert near.min() > 0.0


def test_commands_stay_within_limits_and_rates_on_the_way():
    robot, step_time = bar(shortening=[0, LIMITED], rate=RATE), 0.01
    last, slack = 0.0, 0

    def goal(step):
        return [LENGTH, 0.01, 0.03 if step < 30 else 0.012]

    for step in range(60):
        result = robot.step(st.targets(tip=goal(step)), time_step=step_time)
        own = result["other_shortening_m"]
        assert 0.0 <= own <= LIMITED * (1 + 1e-12)
        assert abs(own - last) <= RATE * step_time * (1 + 1e-9)
        last, slack = own, slack + (result["other_tension_N"] == 0.0)
        assert not [name for name in result.active_limits
                    if name.startswith("other.") and result["other_tension_N"] == 0.0]
    assert slack > 0
    assert result.status.value == "ok"


def test_a_cable_without_commanded_tension_holds_nothing_back(limited):
    limited.reset()
    result = limited.settle(st.setpoints(long_shortening_m=0.008, other_shortening_m=0.0))
    tension = result["long_tension_N"]
    limited.reset()
    for _ in range(30):
        by_effort = limited.step(st.efforts(long_tension_N=tension, other_tension_N=0.0))
    assert by_effort["long_tension_N"] == pytest.approx(tension, rel=1e-6)
    assert by_effort.tip[2] == pytest.approx(result.tip[2], abs=1e-6)


def test_results_tell_the_winch_and_the_path_apart(limited):
    limited.reset()
    commanded = limited.settle(st.setpoints(long_shortening_m=0.008, other_shortening_m=0.0))
    limited.reset()
    found = limited.settle(st.targets(tip=commanded.tip.tolist()))
    for result, own in ((commanded, 0.0), (found, LIMITED)):
        assert result["other_length_m"] == pytest.approx(result["other_rest_length_m"] - own)
        assert result["other_path_m"] < result["other_length_m"] - 0.001
        assert result["long_path_m"] == pytest.approx(result["long_length_m"], abs=1e-7)
    assert found["other_path_m"] == pytest.approx(commanded["other_path_m"], abs=1e-6)


def test_a_nearer_place_with_a_cable_slack_is_found_where_it_rests_taut_at_its_limit():
    """Between both it is further away: the other cable alone leads aside at the same height."""
    robot = bar((0.75, 0.5), dict(directions=["y", "z"]), shortening=[0, LIMITED])
    goal = np.array([LENGTH, WIDTH / 2, 0.03])

    def missed(command):
        robot.reset()
        result = repeat_step(robot, command, 150)
        return np.linalg.norm((result.tip - goal)[1:]), tensions(result)

    own, pulling = missed(st.targets(tip=goal.tolist()))
    taut, _ = missed(st.setpoints(long_shortening_m=0.00225, other_shortening_m=LIMITED))
    slack, _ = missed(st.setpoints(long_shortening_m=0.0049, other_shortening_m=LIMITED))
    assert slack < 0.9 * taut
    assert own <= 1.001 * slack and pulling[1] == 0.0


def test_a_stiffness_is_reached_that_only_a_slack_cable_gives(drawn_rng):
    """In most draws both cables share the load, until one alone is found to be as soft as wanted."""
    wanted = dict(stiffness=dict(weight=1.0, length=0.01, target=[None] * 3))
    robot, long = bar((0.1, 0.9), wanted, shortening=[0, 0.02]), drawn_rng.uniform(0.004, 0.008)
    given = dict(long_shortening_m=long, other_shortening_m=0.0)
    goal = robot.settle(st.setpoints(**given)).tip.tolist()
    told = robot.step(
        st.targets(tip=goal, tip_stiffness_N_per_m=[None, 5.0, None], **given)
    ).outcome.effector_stiffness[0, 1]
    robot.reset()
    for _ in range(300):
        result = robot.step(st.targets(tip=goal, tip_stiffness_N_per_m=[None, float(told), None]))
    assert result.status.value == "ok"
    assert result.outcome.effector_stiffness[0, 1] == pytest.approx(told, rel=0.01)
    # What a finger's push by 0.01 mm takes away counts as slack.
    assert tensions(result).min() <= 1e-3 * tensions(result).max()
