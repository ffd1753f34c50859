"""What a step of many robots that learn costs, against their simulations alone, and by two workers.

Both are measured in rounds, one after the other, so that other programs disturb all alike:

- processor time of a step of a robot in one worker, divided by that of its simulation alone with
  the same commands, whose status is read;
- robots' steps per second in two workers, divided by those in one; and the same of two processes of
  simulations alone, which is what the machine gives meanwhile. Rounds in which no process waits for
  a core count apart;
- the same on free cores, by calculation: the processor times of what can be prepared of each step,
  of its rest, and of the main process, in the order in which two workers and it wait for each
  other.

    python tools/measure_learning.py [SCENE ...] [--robots N] [--steps N] [--rounds N] [--policy MS]
"""

import argparse
import multiprocessing
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

import softrobot_twin as st
from softrobot_twin.scene import load_scene
from softrobot_twin.scripting.gym_environment import ReachingEnvironment
from softrobot_twin.simulation import CommandSetpoints, Simulation

SCENES = ("diamond_reduced", "finger")
TIME_STEP = 0.1  # s
# A round is quiet where processes wait for a core no longer than this share of its time.
QUIET = 0.02
# An episode without end, so that only steps are measured.
ENDLESS = dict(time_step=TIME_STEP, most_steps=10**9, reached_within=0.0, travel=0.3)


def actions_of(shape, steps, seed):
    """Random actions, shape (steps, *shape)."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, *shape))


def commands_of(scene, count, steps):
    """What each of some robots is commanded: setpoints, shape (count, steps, actuator_count)."""
    environment = ReachingEnvironment(scene, **ENDLESS)
    actions = actions_of((count, len(environment.drives)), steps, 0)
    setpoints = []
    for robot in range(count):
        environment.reset(options={"target": [0.0, 0.0, 0.0]})
        own = []
        for action in actions[:, robot]:
            environment.step(action)
            own.append(environment.robot.state.setpoints)
        setpoints.append(own)
    return actions, np.array(setpoints)


def alone(simulations, setpoints):
    """Processor time of a step of simulations without environment [s]."""
    for simulation in simulations:
        simulation.reset()
        for _ in range(5):
            simulation.step(CommandSetpoints(simulation.state.setpoints, TIME_STEP))
    begin = time.process_time()
    for step in range(setpoints.shape[1]):
        for simulation, own in zip(simulations, setpoints, strict=True):
            simulation.step(CommandSetpoints(own[step], TIME_STEP)).status.value
    return (time.process_time() - begin) / setpoints[..., 0].size


kept: list = []


def keep(scene, setpoints):
    """Builds simulations in a process of their own; see `alone_in`."""
    kept[:] = [Simulation(scene) for _ in setpoints], setpoints
    for simulation in kept[0]:
        simulation.warm_up()


def run_kept():
    """Steps the simulations of this process."""
    return alone(*kept)


def alone_in(processes):
    """Wall time in which processes step their simulations, all at once [s]."""
    begin = time.perf_counter()
    for running in [process.submit(run_kept) for process in processes]:
        running.result()
    return time.perf_counter() - begin


def spent(count):
    """Time on a core and time in wait for one, of this process and of its newest children [s].

    Shape (count + 1, 2)."""
    newest = sorted(multiprocessing.active_children(), key=lambda one: -one.pid)[:count]
    paths = [Path(f"/proc/{one}/schedstat") for one in ("self", *(one.pid for one in newest))]
    return 1e-9 * np.array([path.read_text().split()[:2] for path in paths], dtype=float)


def think(duration):
    """Computes for a processor time [s], as a policy does."""
    end = time.process_time() + duration
    while time.process_time() < end:
        pass


def run(robots, count, actions, policy):
    """Wall time of all steps, and what this process and its `count` workers `spent` on them [s].

    Workers prepare while they wait: no other robots are stepped in between."""
    robots.reset(seed=0, options={"target": [0.0, 0.0, 0.0]})
    before, begin = spent(count), time.perf_counter()
    for action in actions:
        think(policy)
        robots.step(action)
    return time.perf_counter() - begin, spent(count) - before


def times_of_steps(robots, actions):
    """Processor times of what can be prepared of each robot's steps, and of their rest [s].

    Shape (2, steps, count)."""
    times = []
    for robot in robots:
        robot.reset(options={"target": [0.0, 0.0, 0.0]})
    for each in actions:
        for robot, action in zip(robots, each, strict=True):
            begin = time.process_time()
            robot.prepare()
            prepared = time.process_time()
            robot.step(action)
            times.append((prepared - begin, time.process_time() - prepared))
    return np.moveaxis(np.array(times).reshape(*actions.shape[:2], 2), 2, 0)


def on_free_cores(times, between, prepares):
    """Wall time of all steps of two workers, where all processes have a core of their own [s].

    Args:
        times: See `times_of_steps`.
        between: Time of the main process between two steps, for messages and the policy [s].
        prepares: Whether workers prepare while they wait.
    """
    to_prepare, rest = times.reshape(*times.shape[:2], 2, -1)
    asked, free, ahead = 0.0, np.zeros(2), np.zeros(rest.shape[1:])
    for step, own in enumerate(rest):
        free = np.maximum(free, asked) + (to_prepare[step] - ahead + own).sum(axis=1)
        asked, ahead = free.max() + between, np.zeros_like(own)
        coming = to_prepare[step + 1] if prepares and step + 1 < len(rest) else ()
        for worker, each in enumerate(coming):
            for robot, duration in enumerate(each):
                if free[worker] >= asked:
                    break
                ahead[worker, robot] = duration
                free[worker] += duration
    return asked - between


def measure(path, count, steps, rounds, policy):
    """Prints the figures of a scene."""
    scene = load_scene(path)
    actions, setpoints = commands_of(scene, count, steps)
    keep(scene, setpoints)
    spawn, half = multiprocessing.get_context("spawn"), count // 2
    one_alone, *two_alone = (ProcessPoolExecutor(1, spawn, keep, (scene, part)) for part in (
        setpoints, setpoints[:half], setpoints[half:]))
    alone_in([one_alone, *two_alone])
    one, two = (st.vector_env(scene, count, workers, **ENDLESS) for workers in (1, 2))
    robots = [ReachingEnvironment(scene, **ENDLESS) for _ in range(count)]
    costs, gains, quiet, bare, machine, shares, free, waiting = [], [], [], [], [], [], [], []
    for _ in range(rounds):
        bare.append(run_kept())
        machine.append(alone_in([one_alone]) / alone_in(two_alone))
        wall, (own,) = run(one, 0, actions, policy)
        wall_of_two, of_two = run(two, 2, actions, policy)
        costs.append((own[0] - policy * steps) / actions[..., 0].size / bare[-1])
        gains.append(wall / wall_of_two)
        if max(own[1] / wall, of_two[:, 1].max() / wall_of_two) < QUIET:
            quiet.append(gains[-1])
        times = times_of_steps(robots, actions)
        shares.append(times[0].sum() / times.sum())
        whole, between = times.sum() + policy * steps, of_two[0, 0] / steps
        for found, prepares in ((free, True), (waiting, False)):
            found.append(whole / on_free_cores(times, between, prepares))
    two.close()
    for process in (one_alone, *two_alone):
        process.shutdown()
    print(f"{scene.name}: {count} robots, {one.model}")
    for name, values, unit in (
        ("simulation alone, processor time of a step", 1e3 * np.array(bare), " ms"),
        ("a step / the simulation alone", costs, ""),
        ("share of a step that can be prepared", shares, ""),
        ("two workers / one, by the clock", gains, ""),
        (f"two workers / one, by the clock in {len(quiet)} quiet rounds", quiet or [np.nan], ""),
        ("two processes of simulations alone / one, by the clock", machine, ""),
        ("two workers / one, on free cores by calculation", free, ""),
        ("two workers / one, the same if they did not prepare", waiting, ""),
    ):
        print(f"  {name}: median {np.median(values):.3f}{unit}, "
              f"{np.min(values):.3f} to {np.max(values):.3f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="scene files")
    parser.add_argument("--robots", type=int, default=32)
    parser.add_argument("--steps", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--policy", type=float, default=0.0, help="its time in each step [ms]")
    given = parser.parse_args()
    folder = Path(__file__).resolve().parents[1] / "config" / "scenes"
    warnings.simplefilter("ignore", st.SceneWarning)
    for path in given.scenes or [folder / f"{name}.yaml" for name in SCENES]:
        measure(path, given.robots, given.steps, given.rounds, 1e-3 * given.policy)
