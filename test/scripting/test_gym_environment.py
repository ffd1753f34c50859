"""The environment in which an effector reaches for targets."""

import importlib
import sys
import types
import warnings

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.errors import CommandError

pytestmark = pytest.mark.libraries

gymnasium = pytest.importorskip("gymnasium")

from softrobot_twin.harness.figure import MissingExtraError  # noqa: E402
from softrobot_twin.scripting import gym_environment  # noqa: E402
from softrobot_twin.scripting.gym_environment import ENVIRONMENT_ID, ReachingEnvironment  # noqa: E402
from test.places import ROOT
from test.scripting.conftest import FINGER as ENTRIES

FINGER = ROOT / "config" / "scenes" / "finger.yaml"
LENGTH_RATE, TIME_STEP = 0.05, 0.1  # m/s as in the scene, s


# A small finger with two cables along it.
SMALL = ENTRIES | {"name": "small", "cables": [
    cable | {"name": f"cable_{i}", "shortening": [-0.01, 0.02]} for i, cable in enumerate(ENTRIES["cables"])]}


def small_finger(**more):
    return st.build(**SMALL | more)


@pytest.fixture(scope="module")
def environment():
    return ReachingEnvironment(FINGER, most_steps=20)


def play(environment, seed, steps=6):
    """Observations and rewards of an episode with actions of its own seed."""
    random = np.random.default_rng(seed)
    observation, info = environment.reset(seed=seed)
    seen, rewards = [observation], []
    for _ in range(steps):
        step = environment.step(random.uniform(-1.0, 1.0, environment.action_space.shape))
        seen.append(step[0])
        rewards.append(step[1])
    return np.array(seen), np.array(rewards), environment.target.copy()


def test_gymnasium_finds_no_fault(environment):
    from gymnasium.utils.env_checker import check_env
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment, skip_render_check=True)


def test_it_is_made_by_its_name():
    made = gymnasium.make(ENVIRONMENT_ID, scene=small_finger(), most_steps=3)
    made.reset(seed=0)
    ends = [made.step(0.2 * made.action_space.high)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_the_same_seed_is_the_same_episode_and_another_seed_another(environment):
    first, other, again = (play(environment, seed) for seed in (3, 4, 3))
    for one, same in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, same)
    assert np.linalg.norm(first[2] - other[2]) > 1e-4


def test_steps_that_were_prepared_are_the_same_episode(environment, monkeypatch):
    plain, step = play(environment, 4), environment.step
    monkeypatch.setattr(environment, "step", lambda action: environment.prepare() or step(action))
    for one, other in zip(plain, play(environment, 4), strict=True):
        np.testing.assert_array_equal(one, other)


def test_random_targets_are_reachable_places(environment):
    environment.reset(seed=5)
    for _ in range(3):
        environment.reset()
        result = environment.robot.settle(st.targets(tip=environment.target), time_step=TIME_STEP)
        assert result.errors["tip"] < 1e-5


def test_actions_are_shares_of_the_rates_within_the_limits(environment):
    environment.reset(options={"target": [0.08, 0.0, 0.0]})
    simulation = environment.robot.simulation

    def lengths():
        return simulation.actuators.drives(simulation.state.setpoints).copy()

    before = lengths()
    environment.step(np.array([0.4, -0.2]))
    np.testing.assert_allclose(lengths() - before, np.array([0.4, -0.2]) * LENGTH_RATE * TIME_STEP)
    for _ in range(8):
        observation, *_ = environment.step(np.array([-1.0, -1.0]))
    np.testing.assert_allclose(lengths(), [-0.015, -0.015])
    np.testing.assert_allclose(observation[:2], [-1.0, -1.0])


def test_the_reward_is_minus_the_distance_and_the_observation_leads_there(environment):
    observation, _ = environment.reset(seed=6)
    size = environment.robot.simulation.model.nodes.size
    observation, reward, terminated, truncated, info = environment.step(np.zeros(2))
    place = environment.robot.effectors["tip"]
    distance = np.linalg.norm(environment.target - place)
    assert reward == -info["distance"] == pytest.approx(-distance)
    np.testing.assert_allclose(place + observation[5:] * size, environment.target, atol=1e-7)
    assert environment.observation_space.contains(observation)
    assert not terminated and not truncated and info["status"] in ("ok", "linearized")


def test_an_episode_ends_at_the_target_and_is_cut_after_its_steps(environment):
    environment.reset(options={"target": environment.place})
    environment.reset(options={"target": environment.place})
    *_, terminated, truncated, info = environment.step(np.zeros(2))
    assert terminated and info["is_success"] and not truncated
    environment.reset(options={"target": [0.5, 0.0, 0.0]})
    ends = [environment.step(np.zeros(2))[2:4] for _ in range(20)]
    assert ends == [(False, False)] * 19 + [(False, True)]


def test_a_motor_is_one_drive():
    one = small_finger(motors=[{"name": "grip", "cables": ["cable_0", "cable_1"]}])
    environment = ReachingEnvironment(one)
    assert [drive.name for drive in environment.drives] == ["grip"]
    environment.reset(seed=0)
    environment.step(np.array([1.0]))
    drives = one.simulation.actuators.drives(one.simulation.state.setpoints)
    np.testing.assert_allclose(drives, LENGTH_RATE * TIME_STEP)


def test_a_pressure_is_driven_between_its_limits():
    springy = st.build(
        name="springy",
        body={"mesh": {"file": ROOT / "meshes" / "springy_400.msh"}, "element": "linear",
              "material": {"young_modulus": 50e3, "poisson_ratio": 0.3, "density": 1070.0},
              "fixed": [{"box": {"minimum": [-1, -1, -0.001], "maximum": [1, 1, 0.0001]}}]},
        cavities=[{"name": "air", "walls": [{"part": "cavity"}], "pressure": [-100.0, 300.0],
                   "rate": 1000.0}],
        effectors=[{"name": "tip", "points": [[0.0, 0.0, 0.05]]}],
    )  # fmt: skip
    environment = ReachingEnvironment(springy, time_step=0.1)
    assert environment.drives[0][2:] == (-100.0, 300.0, 1000.0)
    start, _ = environment.reset(seed=0)
    assert start[0] == pytest.approx(-0.5)  # 0 Pa
    height = environment.place[2]
    observation, *_ = environment.step(np.array([1.0]))
    assert observation[0] == pytest.approx(0.0)  # 100 Pa
    assert environment.place[2] > height


@pytest.mark.parametrize(("limit", "words"), [
    ("shortening", "cable_0.*finite limits: give shortening"), ("rate", "cable_0.*has no rate")])
def test_actuators_without_limits_are_refused_by_name(limit, words):
    cables = [{key: cable[key] for key in cable if key != limit} for cable in SMALL["cables"]]
    with pytest.raises(CommandError, match=words):
        ReachingEnvironment(small_finger(cables=cables))


def test_what_it_cannot_use_is_refused_by_name(environment):
    robot = environment.robot
    with pytest.raises(CommandError, match="tup.*effectors: tip"):
        ReachingEnvironment(robot, effector="tup")
    with pytest.raises(CommandError, match="blind: has no effector"):
        ReachingEnvironment(st.build(**SMALL | {"name": "blind", "effectors": []}))
    for name, value in (("time_step", 0.0), ("most_steps", 0), ("most_steps", 2.5), ("travel", 1.5),
                        ("travel", [0.5, 9]), ("reached_within", -1.0), ("render_mode", "human")):
        with pytest.raises(CommandError, match=name):
            ReachingEnvironment(robot, **{name: value})
    with pytest.raises(CommandError, match="step: an episode begins with reset"):
        ReachingEnvironment(robot).step(np.zeros(2))
    for bad, words in (("goal", "is no option"), ("target", "has 2 numbers"), ("state", "must be a state")):
        with pytest.raises(CommandError, match=f"{bad}: {words}"):
            environment.reset(options={bad: [0.0, 0.0]})
    environment.reset(seed=1)
    for bad in (np.zeros(3), np.array([np.nan, 0.0]), ["fast", "slow"], np.array([1j, 0.0])):
        with pytest.raises(CommandError, match="action"):
            environment.step(bad)


def test_it_draws_robot_and_target():
    environment = ReachingEnvironment(small_finger(), render_mode="rgb_array")
    with pytest.raises(CommandError, match="render: an episode begins"):
        environment.render()
    environment.reset(options={"target": [0.08, 0.0, 0.03]})
    picture = environment.render()
    assert picture.dtype == np.uint8 and picture.shape == (480, 640, 3)
    is_background = (picture == 255).all(axis=2)
    assert 0.3 < is_background.mean() < 0.95
    assert is_background[[0, -1]].all() and is_background[:, [0, -1]].all(), "nothing is cut off"
    environment.target = np.array([0.08, 0.0, -0.03])
    lower = environment.render()
    red = [np.argwhere(image[..., 0] > image[..., 1:].max(axis=2) + 90.0).mean(axis=0)[0]
           for image in (picture, lower)]
    assert red[1] > red[0] + 50.0, "the target is drawn further down"
    assert ReachingEnvironment(environment.robot).render() is None


def test_a_missing_gymnasium_is_named_with_its_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, gym_environment.__name__)
    with pytest.raises(MissingExtraError, match="pip install gymnasium"):
        importlib.import_module(gym_environment.__name__)


def test_actions_out_of_range_are_cut_and_counted(environment):
    environment.reset(options={"target": [0.08, 0.0, 0.0]})
    before = environment.clipped_count
    seen = environment.step(np.array([1.5, -1.0]))
    assert seen[4]["clipped"] == 1 and environment.clipped_count == before + 1
    environment.reset(options={"target": [0.08, 0.0, 0.0]})
    np.testing.assert_array_equal(environment.step(np.array([1.0, -1.0]))[0], seen[0])


def test_a_step_without_solution_ends_the_episode_and_costs_all_that_are_left(environment, monkeypatch):
    environment.reset(seed=2)
    failed = types.SimpleNamespace(status=st.Status.DIVERGED)
    monkeypatch.setattr(environment.robot.simulation, "step", lambda command: failed)
    _, reward, terminated, truncated, info = environment.step(np.zeros(2))
    assert terminated and not truncated and info["is_failure"] and info["status"] == "diverged"
    assert reward == pytest.approx(-20 * info["distance"])


def test_parameters_are_drawn_for_episodes_within_their_range_and_change_the_robot():
    environment = ReachingEnvironment(small_finger(gravity=[0.0, 0.0, -9.81]), redraw_every=2, randomize={
        "body.material.young_modulus": (100e3, 300e3),
        st.load(FINGER).parameters("gravity[2]")[0]: lambda random: -random.choice([5.0, 10.0])})

    def episodes(seed):
        environment.reset(seed=seed)
        found = []
        for _ in range(3):
            found.append((*environment.parameters.values(), environment.place[2] - 0.01))
            info = environment.reset()[1]
        assert info["parameters"] == environment.parameters
        return np.array(found)

    first = episodes(3)
    np.testing.assert_array_equal(first, episodes(3))
    moduli, weights, heights = first.T
    assert moduli[0] == moduli[1] != moduli[2] and ((moduli > 100e3) & (moduli < 300e3)).all()
    assert set(weights) <= {-5.0, -10.0}
    # Beam theory: the sag of a cantilever goes with weight over modulus.
    sag = heights * moduli / weights
    np.testing.assert_allclose(sag, sag[0], rtol=0.05)


def test_episodes_begin_at_saved_states_and_lead_to_others():
    environment = ReachingEnvironment(small_finger())
    states = environment.sample_states(3, seed=1)
    places = []
    for state in states:
        environment.robot.state = state
        places.append(environment.place)
    environment = ReachingEnvironment(environment.robot, states=states)
    begun, aimed = set(), set()
    for seed in range(20):
        environment.reset(seed=seed)
        start, target = (next(i for i, one in enumerate(places) if (one == place).all())
                         for place in (environment.place, environment.target))
        assert start != target and environment.robot.state is states[start]
        begun.add(start), aimed.add(target)
    assert begun == aimed == {0, 1, 2}
    environment.reset(options={"state": states[2], "target": places[0]})
    np.testing.assert_array_equal(environment.place, places[2])
    np.testing.assert_array_equal(environment.target, places[0])


@pytest.mark.parametrize(("randomized", "error", "words"), [
    ({"body.material.young_modulus": (2e5, 1e5)}, CommandError, "young_modulus: is drawn from .*Pa"),
    ({"body.material.young_modulus": (-1e5, 1e5)}, st.SoftRobotTwinError, "young_modulus = -100000.0"),
    ({"cables.*.rat": (0.1, 0.2)}, st.SoftRobotTwinError, "cables.*rat"),
])  # fmt: skip
def test_what_cannot_be_drawn_is_refused_when_it_is_made(randomized, error, words):
    with pytest.raises(error, match=words):
        ReachingEnvironment(small_finger(), randomize=randomized)


def test_states_of_another_scene_and_a_single_one_are_refused(environment):
    state = small_finger().state
    with pytest.raises(CommandError, match="not of this scene"):
        ReachingEnvironment(environment.robot, states=[state, state])
    with pytest.raises(CommandError, match="states: has 1 state"):
        ReachingEnvironment(environment.robot, states=[environment.robot.state])
