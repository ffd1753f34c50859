"""A direct run at a fixed rate: cables, motors and guided bodies go as a commands file says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.rotation import quaternion_from_rotation
from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.study.offline.commands_file import CommandTable


class DirectRow(NamedTuple):
    """One step of a direct run.

    Attributes:
        step: Steps before this one.
        time: The commands' time at its end [s].
        result: What the simulation answered.
        rigid_poses: Position of each rigid body's origin [m] and quaternion x, y, z, w, shape
            (rigid_body_count, 7).
        pair_resultants: Sum of the contact forces on the first body of each pair of `pair_names`
            [N], shape (pair_count, 3).
        pair_magnitude_sums: Sum of those forces' magnitudes [N], shape (pair_count,).
        observed: What an onlooker saw, in the order of its columns.
    """

    step: int
    time: float
    result: StepResult
    rigid_poses: np.ndarray
    pair_resultants: np.ndarray
    pair_magnitude_sums: np.ndarray
    observed: tuple[float, ...] = ()


def step_times(table: CommandTable, rate: float) -> np.ndarray:
    """Ends of the steps [s]: as even as the rate, and no step is longer than its period.

    Args:
        table: Commands.
        rate: Steps a second [Hz].
    """
    begin, end = table.times[0], table.times[-1]
    # Rounding of seconds times rate must not make one more step.
    count = max(1, int(np.ceil((end - begin) * rate - 1e-9)))
    return begin + (end - begin) * np.arange(1, count + 1) / count


def run_commands(
    simulation: Simulation, table: CommandTable, rate: float
) -> Iterator[DirectRow]:
    """Runs a commands file from the simulation's present state.

    Args:
        simulation: Warmed up, so that the first row's compute time is a step's and no more.
        table: Commands; its first row is where the run begins.
        rate: Steps a second [Hz].

    Yields:
        One row a step.
    """
    names = pair_names(simulation)
    times = step_times(table, rate)
    time_step = float(times[-1] - table.times[0]) / len(times)
    for step, time in enumerate(times):
        for name, pose in table.poses.items():
            simulation.model.guides.aim(name, *pose.at(time))
        result = simulation.step(table.command(time, time_step))
        yield DirectRow(step, float(time), result, rigid_poses(simulation),
                        *_pair_forces(result, names))


def rigid_poses(simulation: Simulation) -> np.ndarray:
    """Origin [m] and quaternion x, y, z, w of each rigid body, shape (rigid_body_count, 7)."""
    poses = np.empty((len(simulation.model.rigid), 7))
    for pose, part in zip(poses, simulation.model.rigid, strict=True):
        origin, rotation = part.entry_pose(simulation.state.positions)
        pose[:3], pose[3:] = origin, quaternion_from_rotation(rotation)
    return poses


def pair_names(simulation: Simulation) -> tuple[tuple[str, str], ...]:
    """Names of what may touch, each pair once."""
    if simulation.model.contacts is None:
        return ()
    return tuple(dict.fromkeys(tuple(pair.names) for pair in simulation.model.contacts.pairs))


def _pair_forces(result: StepResult, names: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Resultant and sum of magnitudes of each pair [N]."""
    if result.contacts is None:
        return np.zeros((len(names), 3)), np.zeros(len(names))
    forces = result.contacts.of_pairs()
    return forces.resultants, forces.magnitude_sums
