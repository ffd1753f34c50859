"""Many robots at once: the same episodes in any number of workers, and nothing left of them."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.harness.worker_process import WorkerError
from softrobot_twin.scene import load_scene

gymnasium = pytest.importorskip("gymnasium")

from softrobot_twin.scripting.gym_environment import ReachingEnvironment  # noqa: E402
from test.places import ROOT, SCENES

COUNT, STEPS = 3, 7
OPTIONS = dict(most_steps=3, states=4, randomize={"cables.*.pull_point[2]": (0.002, 0.018)})


def play(environments, seed, steps=STEPS, pause=0.0):
    """All that a run gives, with actions of its own seed, some of them out of range.

    Before each step workers have a pause [s], in which they prepare it."""
    random = np.random.default_rng(seed)
    found = [environments.reset(seed=seed)]
    for _ in range(steps):
        time.sleep(pause)
        found.append(environments.step(random.uniform(-1.2, 1.2, environments.action_space.shape)))
    return found


def assert_same(one, other):
    """Both are equal to the bit: arrays, or dictionaries or tuples of these."""
    if isinstance(one, dict):
        assert list(one) == list(other)
        one, other = one.values(), other.values()
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
        return
    for own, same in zip(one, other, strict=True):
        assert_same(own, same)


def test_one_worker_gives_what_gymnasium_gives(built):
    alone = st.vector_env(built, COUNT, 1, **OPTIONS)
    by_hand = gymnasium.vector.SyncVectorEnv([
        lambda: ReachingEnvironment(built.scene, **OPTIONS | {"states": alone.states})] * COUNT)
    assert (alone.action_space, alone.observation_space, alone.metadata) == (
        by_hand.action_space, by_hand.observation_space, by_hand.metadata)
    found = play(alone, 3)
    assert_same(found, play(by_hand, 3))
    assert alone.clipped_count == sum(by_hand.get_attr("clipped_count")) > 0


@pytest.mark.exhaustive
def test_two_workers_give_what_one_gives(built):
    alone = st.vector_env(built, COUNT, 1, **OPTIONS)
    found = play(alone, 3)
    with contextlib.closing(st.vector_env(built, COUNT, 2, **OPTIONS)) as both:
        assert_same(found, play(both, 3, pause=0.1))
        assert both.clipped_count == alone.clipped_count
        assert "workers: 2" in repr(both) and both.num_envs == COUNT


def test_an_ended_episode_begins_again_in_the_next_step_or_in_the_same_one(built):
    environments = st.vector_env(built, 2, 1, most_steps=2, states=3)
    assert environments.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    found = play(environments, 1, 3)
    assert [one[3].tolist() for one in found[1:]] == [[False] * 2, [True] * 2, [False] * 2]
    np.testing.assert_array_equal(found[3][1], 0.0)
    same = st.vector_env(built, 2, 1, most_steps=2, states=3, autoreset_mode="SameStep")
    infos = play(same, 1, 2)[-1][-1]
    np.testing.assert_array_equal(np.stack(infos["final_obs"]), found[2][0])
    np.testing.assert_array_equal(infos["final_info"]["distance"], found[2][-1]["distance"])


def test_only_the_robots_of_a_mask_begin_an_episode(built):
    environments = st.vector_env(built, 3, 1, states=3)
    before = play(environments, 2, 2)[-1][0]
    mask = np.array([False, True, False])
    after, infos = environments.reset(seed=9, options={"reset_mask": mask})
    assert (after != before).any(axis=1).tolist() == mask.tolist() == infos["_distance"].tolist()
    with pytest.raises(CommandError, match="reset_mask: must be 3 booleans"):
        environments.reset(options={"reset_mask": np.zeros(3, bool)})


@pytest.mark.exhaustive
def test_a_lost_worker_is_named_with_its_scene_and_no_process_is_left(built):
    environments = st.vector_env(built, 4, 2, states=2)
    pids = [one.pid for one in multiprocessing.active_children()]
    assert len(pids) == 2
    environments.reset(seed=0)
    os.kill(max(pids), signal.SIGKILL)
    with pytest.raises(WorkerError, match=r"<python>: worker . of 2, robots . to .: .*all workers are closed"):
        for _ in range(2):
            environments.step(np.zeros((4, 2)))
    assert not any(map(is_running, pids))
    with pytest.raises(CommandError, match="finger: its robots are closed"):
        environments.reset()


def test_what_fails_in_a_worker_is_told_with_its_cause(built):
    draw = lambda random, values=iter([0.01, np.nan]): next(values)
    environments = st.vector_env(built, 2, 1, randomize={"cables[0].pull_point[2]": draw}, redraw_every=1)
    with pytest.raises(WorkerError, match="worker 1 of 1, robots 0 to 1: SceneError: .*nan m: must be finite"):
        environments.reset()
    assert environments.closed


def is_running(pid):
    """Whether a process runs; one that ended and nobody has asked for does not."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.mark.exhaustive
def test_a_killed_program_leaves_no_worker(tmp_path):
    script = tmp_path / "learn.py"
    script.write_text(
        "import multiprocessing, time\nimport softrobot_twin as st\n"
        "if __name__ == '__main__':\n"
        f"    made = st.vector_env({str(SCENES / 'finger.yaml')!r}, 2, 2)\n"
        "    print(*[one.pid for one in multiprocessing.active_children()], flush=True)\n"
        "    time.sleep(600)\n")
    program = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True,
                               env={**os.environ, "PYTHONPATH": str(ROOT)})
    pids = [int(word) for word in program.stdout.readline().split()]
    assert len(pids) == 2 and all(map(is_running, pids))
    program.kill()
    program.wait()
    program.stdout.close()
    end = time.monotonic() + 30.0
    while any(map(is_running, pids)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(is_running, pids))


@pytest.mark.exhaustive
def test_a_cluster_gives_what_this_process_gives_and_names_a_lost_worker(built):
    distributed = pytest.importorskip("distributed")
    found = play(st.vector_env(built, COUNT, 1, **OPTIONS), 3)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True,
                                  dashboard_address=None) as cluster, distributed.Client(cluster) as client:
        environments = st.vector_env(built, COUNT, client, **OPTIONS)
        assert_same(found, play(environments, 3))
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        with pytest.raises(WorkerError, match="<python>: worker . of 2, robots"):
            for _ in range(2):
                environments.step(np.zeros((COUNT, 2)))


def test_the_reduced_model_beside_a_scene_is_taken_and_said():
    with pytest.warns(st.SceneWarning, match=r"diamond.yaml: the reduced model diamond_reduced.yaml"):
        environments = st.vector_env(SCENES / "diamond.yaml", 1, 1, travel=0.3)
    assert environments.model == f"reduced model of 42 unknowns, {SCENES / 'diamond_reduced.yaml'}"
    full = st.vector_env(SCENES / "finger.yaml", 1, 1)
    assert full.model == (f"full model of 1500 unknowns, {SCENES / 'finger.yaml'}; there is no "
                          "finger_reduced.yaml beside it")


@pytest.mark.exhaustive
def test_reduced_robots_in_motion_play_the_same_in_two_workers():
    """By a file that was made for statics."""
    scene = load_scene(SCENES / "diamond_reduced.yaml").changed(integration="dynamic")
    runs = []
    for workers in (1, 2):
        environments = st.vector_env(scene, 2, workers, most_steps=3, states=4, travel=0.3)
        runs.append(play(environments, 5))
        environments.close()
    assert_same(*runs)
    places = np.array([step[0] for step in runs[0]])
    assert np.isfinite(places).all() and np.ptp(places, axis=0).max() > 0.0


@pytest.mark.parametrize(("key", "ends", "error", "said"), [
    ("body.material.young_modulus", (150e3, 210e3), SceneError, "was made of another material"),
    # They would give it other unknowns.
    ("cables[0].points[0][0]", (0.004, 0.005), CommandError, r"cannot be drawn: .*draw from the full")])
def test_what_a_reduced_model_cannot_take_is_refused_before_any_worker_starts(key, ends, error, said):
    with pytest.raises(error, match=said):
        st.vector_env(SCENES / "diamond_reduced.yaml", 2, 2, travel=0.3, randomize={key: ends})


def test_what_it_cannot_use_is_refused_by_name(built, entries):
    for name, value in (("count", 0), ("count", 2.5), ("workers", 0), ("workers", "two")):
        with pytest.raises(CommandError, match=f"{name}: .*must be a whole number"):
            st.vector_env(built, **{"count": 2, "workers": 1} | {name: value})
    with pytest.raises(CommandError, match="blind: has no effector"):
        st.vector_env(st.build(**entries | {"name": "blind", "effectors": []}), 2, 2)
    environments = st.vector_env(built, 2, 1)
    for seed, said in (([1, 2, 3], "has 3 numbers for 2 robots"), ([1, -1], "-1 must be a whole number")):
        with pytest.raises(CommandError, match=f"seed: {said}"):
            environments.reset(seed=seed)
    environments.reset(seed=1)
    for bad in ({"goal": 1.0}, {"target": [0.0, 0.0]}, {"state": "rest"}, {"reset_mask": [1, 0]}):
        with pytest.raises(CommandError, match=next(iter(bad))):
            environments.reset(options=bad)
    for bad in (np.zeros((3, 2)), np.full((2, 2), np.nan), np.full((2, 2), "fast")):
        with pytest.raises(CommandError, match=r"actions: must be finite numbers of shape \(2, 2\)"):
            environments.step(bad)
