"""Measurements of ``bench``: the cases, their commands, and the timing of their steps.

A case moves its effectors on a circle, moves its actuators over their limits, or repeats the longest
constant part of a commands file.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, repeat
from pathlib import Path
from time import perf_counter, thread_time
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import NamedError, SoftRobotTwinError
from softrobot_twin.harness.machine_facts import resident_bytes
from softrobot_twin.harness.timing import Spread, spread, without_garbage_collection
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.shared_files import shared_folders
from softrobot_twin.simulation import (
    CommandSetpoints,
    FollowTargets,
    Simulation,
    Status,
    StepReport,
)
from softrobot_twin.simulation.building.deformable_body import of_kind
from softrobot_twin.simulation.building.reduced_body import ReducedBody
from softrobot_twin.simulation.command import Command
from softrobot_twin.solvers.dense_stiffness import without_rows
from softrobot_twin.study.accuracy_study import OPEN_SHARE
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.tables.input_tables import read_commands


CIRCLE_TIME_STEP = 0.01
"""Time from one target to the next [s]."""
# Initial shortening of every cable and pressure of every cavity as a share of its limit, so that no
# cable is slack.
_PRETENSION_SHARE = 0.25
# A displacement of more than this multiple of its scale is that at which a cavity bursts.
_BURST_SHARE = 10.0
_PRETENSION_STEPS = 60
_STEPS_A_ROUND = 500
# Radius of the circle, as a share of the body's size.
_RADIUS_SHARE = 0.03
_APPROACH_STEPS = 30


class NothingToFollowError(NamedError):
    """A scene has no actuator, none with a limit, or has contact."""

    def __init__(self, scene: str, reason: str):
        super().__init__(scene, "a benchmark moves effectors on a circle, or actuators over their "
                         f"limits where there is no effector; {reason}")


def largest_drives(simulation: Simulation) -> np.ndarray:
    """What the setpoints hold at most: displacements, or efforts, shape (actuator_count,).

    Args:
        simulation: The scene. A displacement without a limit is limited to a share of its scale.

    Raises:
        NothingToFollowError: A pressure has no limit.
    """
    limits, actuators = simulation.limits, simulation.actuators
    # A cable without a limit is limited by its length at rest, a cavity by where it bursts.
    scales = np.where(actuators.one_sided, 1.0, _BURST_SHARE) * limits.displacement_scale
    is_open = ~actuators.is_effort_driven & (limits.drive_max >= scales)
    most = np.where(is_open, OPEN_SHARE * limits.displacement_scale, limits.drive_max)
    for index in np.flatnonzero(~np.isfinite(most)):
        word = actuators.driven_quantities(actuators.is_effort_driven)[index].word
        raise NothingToFollowError(
            simulation.scene.name, f"{actuators.names[index]}.{word} has no upper limit")
    return most


def circle_targets(simulation: Simulation) -> Iterator[FollowTargets]:
    """Targets on a horizontal circle of all effectors about their position with pretensioned
    cables.

    Moves the actuators, and the effectors onto the circle; these steps are not timed.

    Args:
        simulation: At rest; stays at the beginning of the circle.

    Raises:
        NothingToFollowError: The scene has no actuators, none with a limit, or has contact.
    """
    _check_can_be_driven(simulation)
    setpoints = simulation.actuators.setpoints(_PRETENSION_SHARE * largest_drives(simulation))
    for _ in range(_PRETENSION_STEPS):
        simulation.step(CommandSetpoints(setpoints, 5.0 * CIRCLE_TIME_STEP))
    centre = simulation.effector_positions()
    radius = _RADIUS_SHARE * simulation.model.nodes.size

    def command(number: int) -> FollowTargets:
        angle = 2.0 * math.pi * number / _STEPS_A_ROUND
        offset = radius * np.array([math.cos(angle), math.sin(angle), 0.0])
        return FollowTargets(centre + offset, CIRCLE_TIME_STEP)

    for _ in range(_APPROACH_STEPS):
        simulation.step(command(0))
    return map(command, count(1))


def swept_setpoints(simulation: Simulation) -> Iterator[CommandSetpoints]:
    """Setpoints that oscillate between the limits of their actuators, each with another phase.

    Moves the actuators to the beginning; these steps are not timed.

    Args:
        simulation: At rest.

    Raises:
        NothingToFollowError: See `circle_targets`.
    """
    _check_can_be_driven(simulation)
    actuators, limits = simulation.actuators, simulation.limits
    most = largest_drives(simulation)
    # What has no vacuum, or a lower limit of a displacement, begins at rest.
    by_effort = actuators.is_effort_driven
    least = np.where(by_effort & np.isfinite(limits.drive_min), limits.drive_min, 0.0)
    middle, swing = 0.5 * (most + least), 0.5 * (most - least)
    phases = 2.0 * math.pi * np.arange(actuators.count) / max(1, actuators.count)

    def command(number: int) -> CommandSetpoints:
        angles = 2.0 * math.pi * number / _STEPS_A_ROUND + phases
        return CommandSetpoints(actuators.setpoints(middle - swing * np.cos(angles)), CIRCLE_TIME_STEP)

    for _ in range(_PRETENSION_STEPS):
        simulation.step(command(0))
    return map(command, count(1))


def _check_can_be_driven(simulation: Simulation) -> None:
    """Refuses scenes without actuators, and with contact."""
    if not simulation.actuator_names:
        raise NothingToFollowError(simulation.scene.name, "this scene has no actuators")
    if simulation.model.contacts is not None:
        raise NothingToFollowError(
            simulation.scene.name, "in contact neither is done: 'bench --commands FILE.csv' times "
            "this scene along a commands file")


RATE = 250.0
"""Steps a second [Hz]."""
# Oscillations after the motion decay during this share of the hold.
_SETTLING_SHARE = 0.25


class NoHoldError(NamedError):
    """A commands file has no part with constant commands."""


def held_commands(simulation: Simulation, path: Path) -> Iterator[Command]:
    """Commands of the longest hold of a commands file, for any number of steps; guided bodies keep
    their poses.

    Runs the file up to the hold; these steps are not timed.

    Args:
        simulation: At rest; stays in the hold, after the motion before it has decayed.
        path: The commands file.

    Raises:
        NoHoldError: The file has no hold.
        TableFileError: The file does not fit the scene.
    """
    commanded = read_commands(path, simulation)
    begin, end = commanded.longest_hold
    if math.isnan(begin):
        raise NoHoldError(path, "a benchmark times the longest hold, an interval in which no "
                          "command changes; there is none")
    time = begin + _SETTLING_SHARE * (end - begin)
    for row in run_commands(simulation, commanded, RATE):
        if row.time >= time:
            break
    return repeat(commanded.command(time, 1.0 / RATE))


class NoDefaultSceneError(SoftRobotTwinError):
    """The Diamond's scene file is not where the package keeps it."""

    def __init__(self, looked: list[Path]):
        super().__init__("the Diamond's scene was not found; give a scene. Looked for "
                         + ", ".join(map(str, looked)))


def default_scene_path() -> Path:
    """The Diamond's scene file.

    Raises:
        NoDefaultSceneError: It is not there.
    """
    candidates = [folder / "config" / "scenes" / "diamond.yaml" for folder in shared_folders()]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise NoDefaultSceneError(candidates)


class BenchCase(NamedTuple):
    """One scene to measure.

    Attributes:
        name: Name in tables.
        scene: The scene.
        drive: Brings the simulation to where it is timed, and gives the commands from there on.
    """

    name: str
    scene: Scene
    drive: Callable[[Simulation], Iterator[Command]]


def given_cases(paths: Sequence[Path], commands: Path | None = None) -> list[BenchCase]:
    """Cases of a user's scenes.

    Args:
        paths: Scene files.
        commands: Commands file whose longest hold is timed, or None.
    """
    drive = usual_commands if commands is None else partial(held_commands, path=commands)
    return [BenchCase(path.stem, load_scene(path), drive) for path in paths]


def usual_commands(simulation: Simulation) -> Iterator[Command]:
    """Targets on a circle, or, of a robot without effectors, setpoints over their limits.

    Args:
        simulation: At rest; see `circle_targets` and `swept_setpoints`.

    Raises:
        NothingToFollowError: See `circle_targets`.
    """
    return circle_targets(simulation) if simulation.effector_names else swept_setpoints(simulation)


WHOLE_STEP = "whole step"
OUTSIDE = "outside the stages"
"""Time outside the stages: checks of commands, copies of states, reports."""
INTERRUPTION = 1.0e-4
"""A step that waited longer than this for the processor was interrupted [s]."""


@dataclass(frozen=True)
class SizeMeasurement:
    """Measurements of one case.

    Attributes:
        case: The measured case.
        factorization: Name of the factorization.
        thread_count: Threads that factorize.
        node_count: Nodes of the mesh.
        tet_count: Its tetrahedra.
        dof_count: Unknowns.
        mode_count: Modes of reduced bodies, 0 without any.
        point_count: Sampled quadrature points of these.
        row_count: Rows of H, median.
        contact_count: Contacts with force, median.
        stages: Time of each stage [s], of what is outside them, and of the whole step.
        step_count: Steps timed.
        interrupted_share: Share of steps during which another program took the processor.
        resident: Memory of the process [B].
        statuses: Number of timed steps by status.
        qp_solvers: Number of timed steps by solver of the inverse problem.
    """

    case: BenchCase
    factorization: str
    thread_count: int
    node_count: int
    tet_count: int
    dof_count: int
    mode_count: int
    point_count: int
    row_count: float
    contact_count: float
    stages: dict[str, Spread]
    step_count: int
    interrupted_share: float
    resident: int | None
    statuses: Counter[str]
    qp_solvers: Counter[str]

    @property
    def is_reduced(self) -> bool:
        """Whether a body is reduced to modes."""
        return self.mode_count > 0

    @property
    def tail(self) -> float:
        """99th percentile of the whole step over its median."""
        return self.stages[WHOLE_STEP].p99 / self.stages[WHOLE_STEP].median


def measure(case: BenchCase, steps: int) -> SizeMeasurement:
    """Builds a case and times its steps.

    Args:
        case: The case.
        steps: Steps to time.

    Raises:
        SoftRobotTwinError: The scene cannot be built or has nothing to follow.
    """
    simulation = Simulation(case.scene)
    simulation.warm_up()
    commands = case.drive(simulation)
    resident, model = resident_bytes(), simulation.model
    with without_garbage_collection():
        made = [_timed(simulation, next(commands)) for _ in range(steps)]
    factorization = without_rows(model.factorization)
    reductions = [body.reduction for body in of_kind(model.bodies, ReducedBody)]
    reports = [step.report for step in made]
    return SizeMeasurement(
        case, factorization.name, getattr(factorization, "thread_count", 1),
        simulation.node_count, simulation.tet_count, simulation.dof_count, sum(one.mode_count for one in reductions),
        sum(len(one.sampled.cells) for one in reductions),
        spread([step.row_count for step in made]).median,
        spread([report.contact_count for report in reports]).median, _stages(made, simulation.stages), steps,
        sum(step.time - step.worked > INTERRUPTION for step in made) / steps,
        resident, Counter(step.status.value for step in made),
        Counter(report.qp_solver for report in reports))


class _TimedStep(NamedTuple):
    """A step: elapsed and processor time [s], what it reported, and the number of rows of H."""

    time: float
    worked: float
    report: StepReport
    status: Status
    row_count: int


def _stages(steps: Sequence[_TimedStep], names: Sequence[str]) -> dict[str, Spread]:
    """Times of each stage, of what is outside them, and of the whole step [s]."""
    whole = np.array([step.time for step in steps])
    booked = np.array([[step.report.stage_times.get(name, 0.0) for name in names]
                       for step in steps])
    spreads = {name: spread(booked[:, index]) for index, name in enumerate(names)}
    return {**spreads, OUTSIDE: spread(whole - booked.sum(axis=1)), WHOLE_STEP: spread(whole)}


def _timed(simulation: Simulation, command: Command) -> _TimedStep:
    worked, start = thread_time(), perf_counter()
    result = simulation.step(command)
    time = perf_counter() - start
    return _TimedStep(time, thread_time() - worked, result.report, result.status, simulation.model.rows.row_count)
