"""A path that cables follow at a speed and a rate: what one linearization a step costs on it."""

from __future__ import annotations

from collections.abc import Callable
from time import thread_time
from typing import NamedTuple

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.simulation import FollowTargets, CommandSetpoints, Simulation, State
from softrobot_twin.study.accuracy.load_cases import exact_simulation, shortenings
from softrobot_twin.study.accuracy.scene_variant import with_newton, without_rate_limits
from softrobot_twin.study.bench.size_measurement import without_garbage_collection
from softrobot_twin.study.offline.run_summary import Spread, spread

# Half of how fast a cable may run; this where there is no limit [m/s].
_SPEED_SHARE, _SPEED = 0.5, 0.02
# Radius of the circle in shortenings, of the largest one about which it runs.
_RADIUS_SHARE = 0.25
# Newton's convergence is quadratic, and a step begins near: so many reach rounding.
_EXACT_ITERATIONS = 6
# A time may take no longer than this [s], but has at least so many steps.
_SECONDS, _FEWEST_STEPS = 3.0, 8
# The same for one round of several.
_ROUND_SECONDS = 1.0


class LengthPath(NamedTuple):
    """Shortenings of all cables, step by step.

    Attributes:
        shortenings: [m], shape (step_count + 1, actuator_count); the first is the start.
        time_step: From one to the next [s].
    """

    shortenings: np.ndarray
    time_step: float


class Followed(NamedTuple):
    """How a path was followed.

    Attributes:
        positions: Effectors after each step [m], shape (step_count, effector_count, 3).
        times: Time of a step [s].
    """

    positions: np.ndarray
    times: Spread


def length_path(scene: Scene, rate: float, step_count: int) -> LengthPath:
    """Every actuated cable swings about its first pose, one after the other.

    Args:
        scene: The scene.
        rate: Steps a second [Hz].
        step_count: Steps.
    """
    middle = shortenings(scene)[0]
    radius = _RADIUS_SHARE * middle.max()
    limits = [
        cable.rate for cable in scene.cables if cable.rate is not None and np.isfinite(cable.rate)
    ]
    speed = _SPEED_SHARE * min(limits) if limits else _SPEED
    angles = speed / radius / rate * np.arange(step_count + 1)[:, None]
    phases = 2.0 * np.pi * np.arange(len(middle)) / max(1, len(middle) - 1)
    # Rigid cables are not driven into slack: each swings by no more than its own middle.
    swing = np.minimum(radius, middle) * np.sin(angles + phases)
    return LengthPath(middle + swing, 1.0 / rate)


def follow_exactly(scene: Scene, path: LengthPath) -> tuple[np.ndarray, State]:
    """Every step converged: effectors [m], shape (step_count, effector_count, 3), and the start."""
    simulation = exact_simulation(scene)
    for share in (0.0, 0.5, 1.0):
        setpoints = simulation.rest_setpoints - share * path.shortenings[0]
        simulation.step(CommandSetpoints(setpoints, 1.0))
    start = simulation.state
    return follow_lengths(scene, path, start, _EXACT_ITERATIONS).positions, start


def follow_lengths(
    scene: Scene, path: LengthPath, start: State, iterations: int, **parts
) -> Followed:
    """So many linearizations a step, wound along a path from an equilibrium at its start."""
    simulation = _ready(scene, start, iterations, parts)
    commands = [CommandSetpoints(simulation.rest_setpoints - wound, path.time_step)
                for wound in path.shortenings[1:]]
    return _follow(simulation, commands, None)


def follow_targets(
    scene: Scene, path: LengthPath, targets: np.ndarray, start: State, **parts
) -> Followed:
    """One linearization a step, the inverse problem solved for targets [m]."""
    simulation = _ready(scene, start, 1, parts)
    return _follow(simulation, [FollowTargets(target, path.time_step) for target in targets], None)


def time_steps(scene: Scene, path: LengthPath, iterations: int) -> Spread:
    """Time of a step along a path, as often as a few seconds allow [s]."""
    simulation = _ready(scene, None, iterations, {})
    simulation.step(CommandSetpoints(simulation.rest_setpoints - path.shortenings[0], 1.0))
    commands = [CommandSetpoints(simulation.rest_setpoints - wound, path.time_step)
                for wound in path.shortenings[1:]]
    return _follow(simulation, commands, _SECONDS).times


def rounds_of(scene: Scene, path: LengthPath, iterations: int) -> Callable[[], np.ndarray]:
    """Makes rounds of the same steps along a path; each gives the times of its steps [s].

    What counts is the time of this thread, not what it waits while others have the processor.
    """
    simulation = _ready(scene, None, iterations, {"now": thread_time})
    simulation.step(CommandSetpoints(simulation.rest_setpoints - path.shortenings[0], 1.0))
    start = simulation.state
    commands = [CommandSetpoints(simulation.rest_setpoints - wound, path.time_step)
                for wound in path.shortenings[1:]]

    def steps() -> np.ndarray:
        simulation.restore(start)
        times: list[float] = []
        with without_garbage_collection():
            for command in commands:
                times.append(simulation.step(command).report.compute_time)
                if sum(times) > _ROUND_SECONDS and len(times) >= _FEWEST_STEPS:
                    break
        return np.array(times)

    return steps


def _ready(scene: Scene, start: State | None, iterations: int, parts: dict) -> Simulation:
    # A tolerance that is never met: every step takes all its iterations.
    tuned = with_newton(without_rate_limits(scene), iterations, 1.0e-300)
    simulation = Simulation(tuned, **parts)
    simulation.warm_up()
    if start is not None:
        simulation.restore(start)
    return simulation


def _follow(simulation: Simulation, commands: list, seconds: float | None) -> Followed:
    positions, times = [], []
    with without_garbage_collection():
        for command in commands:
            result = simulation.step(command)
            positions.append(result.effector_positions)
            times.append(result.report.compute_time)
            if seconds is not None and sum(times) > seconds and len(times) >= _FEWEST_STEPS:
                break
    return Followed(np.array(positions), spread(np.array(times)))
