"""What a step of many robots that learn costs, against their simulations alone, and by two workers.

Both are measured in rounds, one after the other, so that other programs disturb all alike:

- processor time of a step of a robot in one worker, divided by that of its simulation alone with the
  same commands, whose status is read;
- robots' steps per second in two workers, divided by those in one; and the same of two processes of
  simulations alone, which is what the machine gives meanwhile. Where other programs need the cores,
  processor times say what free ones would give: all time of one worker, divided by that of the
  busier of two in each step, for which the other waits, and of what the main process does between.

    python tools/measure_learning.py [SCENE ...] [--robots 32] [--steps 25] [--rounds 7]
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


def worker_times(count=2):
    """Processor time of each worker, the newest processes [s], shape (count,)."""
    newest = sorted(multiprocessing.active_children(), key=lambda one: one.pid)[-count:]
    return np.array([1e-9 * int(Path(f"/proc/{one.pid}/schedstat").read_text().split()[0])
                     for one in newest])


def together(one, two, actions):
    """Of a robot's step, in one worker and in two: wall time, and processor time of this process
    and of the busiest worker [s], shape (2, 3). Both take each step in turn: others disturb alike."""
    for robots in (one, two):
        robots.reset(seed=0, options={"target": [0.0, 0.0, 0.0]})
    spent = np.zeros((2, 3))
    for action in actions:
        for robots, times in zip((one, two), spent, strict=True):
            before, begin, own = worker_times(), time.perf_counter(), time.process_time()
            robots.step(action)
            ended = time.perf_counter(), time.process_time()
            # All wait for the busiest worker of this step, which is another one in the next.
            times += ended[0] - begin, ended[1] - own, (worker_times() - before).max()
    return spent / (actions.shape[0] * actions.shape[1])


def measure(path, count, steps, rounds):
    """Prints the figures of a scene."""
    scene = load_scene(path)
    actions, setpoints = commands_of(scene, count, steps)
    keep(scene, setpoints)
    spawn, half = multiprocessing.get_context("spawn"), count // 2
    one_alone, *two_alone = (ProcessPoolExecutor(1, spawn, keep, (scene, part)) for part in (
        setpoints, setpoints[:half], setpoints[half:]))
    alone_in([one_alone, *two_alone])
    one, two = (st.vector_env(scene, count, workers, **ENDLESS) for workers in (1, 2))
    costs, gains, free_gains, bare, machine = [], [], [], [], []
    for _ in range(rounds):
        bare.append(run_kept())
        machine.append(alone_in([one_alone]) / alone_in(two_alone))
        (wall, busy, _), (wall_of_two, own, busiest) = together(one, two, actions)
        costs.append(busy / bare[-1])
        gains.append(wall / wall_of_two)
        free_gains.append(busy / (busiest + own))
    two.close()
    for process in (one_alone, *two_alone):
        process.shutdown()
    print(f"{scene.name}: {count} robots, {one.model}")
    for name, values, unit in (
        ("simulation alone, processor time of a step", 1e3 * np.array(bare), " ms"),
        ("a step / the simulation alone", costs, ""),
        ("two workers / one, by the clock", gains, ""),
        ("two processes of simulations alone / one, by the clock", machine, ""),
        ("two workers / one, by processor time", free_gains, ""),
    ):
        print(f"  {name}: median {np.median(values):.3f}{unit}, "
              f"{np.min(values):.3f} to {np.max(values):.3f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="scene files")
    parser.add_argument("--robots", type=int, default=32)
    parser.add_argument("--steps", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    folder = Path(__file__).resolve().parents[1] / "config" / "scenes"
    warnings.simplefilter("ignore", st.SceneWarning)
    for path in given.scenes or [folder / f"{name}.yaml" for name in SCENES]:
        measure(path, given.robots, given.steps, given.rounds)
