"""What Python and the twin add to a step: calls, the share of kernels, and the time beside a step.

`bench_robots.py` prints them, writes them into bench.csv and compares them with an earlier run. Calls of
Python are the same on any machine, which times are not.
"""

from __future__ import annotations

import cProfile
import csv
from collections.abc import Callable, Iterator, Sequence
from itertools import repeat
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numba.core.registry import CPUDispatcher
from rich.table import Table

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.force_observer import USUAL_NOISE, ForceObserver
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.harness.terminal import report_activity, table
from softrobot_twin.harness.timing import without_garbage_collection
from softrobot_twin.simulation import FollowTargets, Simulation
from softrobot_twin.study.bench_measurement import WHOLE_STEP, BenchCase
from softrobot_twin.tables.input_tables import TableFileError
from superlu_reference import BesideSuperLU

UNCOUNTED_STEPS = 10
"""Steps before those that are counted: the first ones on a path take more linearizations."""
COUNTED_STEPS = 40
"""Steps whose calls are counted, and whose times are taken."""
SLOWER, MORE_CALLS = 1.1, 1.02
"""A step that is slower by more than this than an earlier one, or makes more calls, is marked."""


class Overhead(NamedTuple):
    """What Python and the twin add to a step of one case; medians, NaN where a case has no such part.

    Attributes:
        calls: Calls of Python functions in a step, those that are written in C too, in the mean.
        kernel_share: Share of a step's time that kernels take.
        tick: Time of the twin's tick beside its step, without ROS [s].
        observer: Time of an observer beside a step [s].
        control: Time of `control` in a tick [s].
    """

    calls: float
    kernel_share: float
    tick: float
    observer: float
    control: float

    @property
    def columns(self) -> dict[str, float]:
        """Its cells of bench.csv."""
        return {"python_calls": self.calls, "kernel_share": self.kernel_share, "beside_step_ms": 1e3 * self.tick,
                "observer_ms": 1e3 * self.observer, "control_ms": 1e3 * self.control}


def overhead_of(case: BenchCase) -> Overhead:
    """Builds a case and measures what is added to its steps.

    Args:
        case: The case.

    Raises:
        SoftRobotTwinError: The scene cannot be built or has nothing to follow.
    """
    report_activity(f"{case.name}: calls of Python")
    simulation = Simulation(case.scene)
    simulation.warm_up()
    commands = case.drive(simulation)
    with without_garbage_collection():
        for _ in range(UNCOUNTED_STEPS):
            simulation.step(next(commands))
        return Overhead(
            calls_in_a_step(simulation, commands), _share_of_kernels(simulation, commands),
            _time_beside_steps(simulation, commands), _time_of_observer(simulation, commands),
            _time_of_control(simulation))


def overhead_table(found: dict[str, Overhead]) -> Table:
    """Table of what is added, a row for each case.

    Args:
        found: By the name of the case.
    """
    return table(
        "Beside the kernels of a step", "case", "calls of Python", "share of kernels", "tick [ms]",
        "observer [ms]", "control [ms]",
        rows=([name, f"{one.calls:.0f}", f"{100.0 * one.kernel_share:.0f} %",
               *("-" if time != time else f"{1e3 * time:.3f}" for time in one[2:])]
              for name, one in found.items()))


def read_earlier(path: Path) -> dict[str, tuple[float, float]]:
    """Ratio of a whole step to one SuperLU factorization, and its calls, of an earlier run.

    Args:
        path: A ``bench.csv``.

    Returns:
        Both by the scene's name; a ratio is NaN where SuperLU was not timed.

    Raises:
        TableFileError: The file cannot be used.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["stage"] == WHOLE_STEP]
        return {row["scene"]: (float(row["ratio_to_superlu"] or "nan"), float(row["python_calls"]))
                for row in rows}  # fmt: skip
    except OSError as error:
        raise TableFileError(path, error.strerror or str(error)) from error
    except (KeyError, ValueError) as error:
        raise TableFileError(path, f"is no bench.csv of this version: {error!r}") from error


def compared(
    sizes: Sequence[BesideSuperLU], found: dict[str, Overhead], earlier: dict[str, tuple[float, float]],
) -> Table:  # fmt: skip
    """Each step beside that of an earlier run, by SuperLU's time in the same run and by calls.

    Args:
        sizes: What was measured.
        found: What is added to their steps, by the name of the case.
        earlier: See `read_earlier`.
    """
    made = table("An earlier run", "scene", "step / SuperLU", "then", "calls", "then", "")
    for size in sizes:
        name = size.case.name
        if name in earlier:
            ratio, calls = earlier[name]
            # Without SuperLU the ratio is NaN, which is above nothing.
            marks = ["slower"] * (size.ratio > SLOWER * ratio)
            marks += ["more calls"] * (found[name].calls > MORE_CALLS * calls)
            made.add_row(name, f"{size.ratio:.3f}", f"{ratio:.3f}", f"{found[name].calls:.0f}",
                         f"{calls:.0f}", ", ".join(marks))
    return made


def calls_in_a_step(simulation: Simulation, commands) -> float:
    """Calls of Python functions in a step, which no other program changes."""
    profile = cProfile.Profile()
    for _ in range(COUNTED_STEPS):
        command = next(commands)
        with profile:
            simulation.step(command)
    return sum(entry.callcount for entry in profile.getstats()) / COUNTED_STEPS


class _TimeWithin:
    """Adds up the time that is spent within a function [s]."""

    def __init__(self) -> None:
        self.total = 0.0

    def of(self, function: Callable) -> Callable:
        """The function, whose time is added."""

        def timed(*given, **options):
            start = perf_counter()
            try:
                return function(*given, **options)
            finally:
                self.total += perf_counter() - start

        return timed


def _share_of_kernels(simulation: Simulation, commands) -> float:
    """Share of a step's time in the kernels that Python calls; the rest is Python's own."""
    within, shares = _TimeWithin(), []
    CPUDispatcher.__call__ = within.of(CPUDispatcher.__call__)
    try:
        for _ in range(COUNTED_STEPS):
            command, within.total = next(commands), 0.0
            start = perf_counter()
            simulation.step(command)
            shares.append(within.total / (perf_counter() - start))
    finally:
        # What is inherited from numba's compiled base class is used again.
        del CPUDispatcher.__call__
    return float(np.median(shares))


def _time_beside_steps(simulation: Simulation, commands) -> float:
    """Time of a tick beside its step [s], in the median; NaN where no targets lead."""
    if not isinstance(next(commands), FollowTargets):
        return float("nan")
    loop, within = TwinLoop(simulation, LoopSettings()), _TimeWithin()
    simulation.step = within.of(simulation.step)
    try:
        targets = (command.targets for command in commands)
        times = [time - within.total for time in _tick_times(loop, targets, within)]
    finally:
        del simulation.step
    return float(np.median(times))


def _tick_times(loop: TwinLoop, targets: Iterator[np.ndarray], within: _TimeWithin) -> Iterator[float]:
    """Times of ticks that follow targets [s]; `within` counts from the begin of each anew."""
    for number, places in zip(range(COUNTED_STEPS), targets):
        now = number / loop.settings.rate
        arrival = Arrival("base_link", 0, round(NANOSECONDS * now), now)
        for effector, place in enumerate(places):
            loop.targets.accept_point(effector, place, arrival)
        within.total, start = 0.0, perf_counter()
        loop.tick(now, arrival.ros_time)
        yield perf_counter() - start


def _time_of_observer(simulation: Simulation, commands) -> float:
    """Time of an observer beside a step [s], with markers where the model has them; NaN without one."""
    if simulation.scene.observer is None:
        return float("nan")
    observer, times = ForceObserver(simulation), []
    for number in range(1, COUNTED_STEPS + 1):
        simulation.step(next(commands), None, observer.found)
        start = perf_counter()
        observer.look()
        model = observer.moment(simulation.marker_positions(), simulation.effector_positions())
        observer.update(simulation.marker_positions(), model, USUAL_NOISE, number * NANOSECONDS)
        times.append(perf_counter() - start)
    return float(np.median(times))


def _time_of_control(simulation: Simulation) -> float:
    """Time in a tick of what predicts and commands motion [s]; NaN in a scene without `control`."""
    if simulation.scene.control is None:
        return float("nan")
    loop, within = TwinLoop(simulation, LoopSettings()), _TimeWithin()
    for method in ("measure", "command", "end"):
        setattr(loop.dynamic, method, within.of(getattr(loop.dynamic, method)))
    ticks = _tick_times(loop, repeat(simulation.effector_positions()), within)
    return float(np.median([within.total for _ in ticks]))
