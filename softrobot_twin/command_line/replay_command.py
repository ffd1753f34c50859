"""``python -m softrobot_twin replay``: runs a recorded run again and says where it differs.

This module connects `record`, which reads and repeats a run, with `study`, which prints and writes
results, and with `view`. None of the three imports another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from datetime import datetime, timezone
from pathlib import Path

from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.harness.output_file import csv_output
from softrobot_twin.harness.terminal import console, table, terminal_status, warn
from softrobot_twin.record.replay import Comparison, Difference, Replay
from softrobot_twin.record.run_description import machine
from softrobot_twin.record.run_file import RunFile
from softrobot_twin.record.tick_table import TickTable
from softrobot_twin.view import RerunMirror
from softrobot_twin.view.simulation_frames import SimulationFrames

DIFFERS = 1
Taker = Callable[[TickOutcome, int, float], None]
# How long a frame may take to be drawn [s].
_LONGEST_DRAWING = 10.0


def replay(
    run: Path, scene: Path | None = None, changes: Sequence[str] = (), output: Path | None = None,
    view_file: Path | None = None,
) -> int:  # fmt: skip
    """Replays a run, prints whether all is equal to the bit, and where it is not.

    Args:
        run: The file of the run.
        scene: Another scene in place of the recorded one.
        changes: Other values of entries of the recorded scene, each as KEY=VALUE.
        output: CSV file of what the replay gave, one row per tick; None for none.
        view_file: File of pictures of the replay, .rrd, for rerun; None for none.

    Returns:
        Exit code: 0; 1 when the run with its own scene differs, or entries of it were dropped.

    Raises:
        SoftRobotTwinError: The file or the scene cannot be used.
    """
    file = RunFile(run)
    _print_head(file)
    with ExitStack() as stack:
        with terminal_status("building and compiling"):
            again = Replay(file, scene, changes)
        takers: list[Taker] = []
        if output is not None:
            takers.append(_writer(again, output, stack))
        if view_file is not None:
            takers.append(_drawer(again, view_file, stack))

        def take(*tick) -> None:
            for taker in takers:
                taker(*tick)

        with terminal_status("replaying"):
            found = again.all_ticks(take)
    _print_result(again, found)
    for path in filter(None, (output, view_file)):
        print(f"wrote {path}")
    is_whole = not file.lost and found.is_equal
    return 0 if is_whole or not again.is_of_its_scene else DIFFERS


def _writer(again: Replay, path: Path, stack: ExitStack) -> Taker:
    """A function that writes a tick as a row."""
    ticks = TickTable(again.loop)
    append = stack.enter_context(csv_output(path, ticks.header))

    def write(outcome: TickOutcome, ros_time: int, seconds: float) -> None:
        append(ticks.texts(outcome, again.comparison.ticks - 1, seconds))

    return write


def _drawer(again: Replay, path: Path, stack: ExitStack) -> Taker:
    """A function that draws a tick, and waits for the thread that does it: none is left out."""
    frames = SimulationFrames(again.loop.simulation)
    mirror = stack.enter_context(RerunMirror(frames.stage, serve=False, record=path))

    def draw(outcome: TickOutcome, ros_time: int, seconds: float) -> None:
        mirror.offer(frames.frame(again.comparison.ticks, ros_time, outcome.result, **outcome.shown()))
        mirror.wait(_LONGEST_DRAWING)

    return draw


def _print_head(file: RunFile) -> None:
    description = file.description
    began = datetime.fromtimestamp(description.began / NANOSECONDS, timezone.utc)
    print(f"{file.path}: {description.scene_name} ({description.scene_path}), node "
          f"{description.node}, {began:%Y-%m-%d %H:%M:%S} UTC")  # fmt: skip


def _print_result(again: Replay, found: Comparison) -> None:
    """What was replayed, and the differences."""
    file = again.run
    if file.lost:
        warn(f"{file.lost} entries were dropped after tick {found.ticks - 1}, because the disk did "
             "not follow: from there on the run cannot be replayed")  # fmt: skip
    elif not file.is_complete:
        why = f" ({file.damage})" if file.damage else ""
        where = f"after tick {found.ticks - 1}" if found.ticks else "before its first tick"
        warn(f"the file has no end{why}: the recording was cut off {where}")
    elif file.damage:
        warn(f"the file is damaged where a replay does not read ({file.damage}); all its ticks "
             "are replayed")  # fmt: skip
    print(f"{found.ticks} ticks, {found.seconds:.2f} s, {found.calls} messages, services and "
          "changes of parameters")  # fmt: skip
    if not found.ticks:
        return
    if found.is_equal:
        print(f"{found.ticks} ticks, all equal to the bit")
        return
    for sentence in found.refused:
        warn(f"could not be repeated: {sentence}")
    if found.first is not None:
        print(f"first difference: {found.first.in_words()}")
        _print_differences(found)
    if again.is_of_its_scene:
        for name, (then, now) in _other_machine(file).items():
            warn(f"{name} was {then or 'unset'}, here it is {now or 'unset'}: "
                 "bits are the same only with the same libraries and instructions")  # fmt: skip


def _print_differences(found: Comparison) -> None:
    shown = table("largest differences", "quantity", "ticks", "of", "difference", "recorded",
                  "replayed", "at [s]")  # fmt: skip
    for name, differences in found.by_quantity.items():
        largest = differences.largest
        shown.add_row(
            name, str(differences.ticks), largest.place, _size(largest),
            _brief(largest.recorded), _brief(largest.replayed),
            f"{largest.time:.3f}",
        )  # fmt: skip
    console().print(shown)


def _size(difference: Difference) -> str:
    return f"{difference.size:.3g}" if math.isfinite(difference.size) else "–"


def _brief(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    text = "–" if value is None else str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _other_machine(file: RunFile) -> dict[str, tuple[str, str]]:
    """What decided the rounding of the recorded run and is different here, by name."""
    then, now = file.description.machine, machine()
    return {
        name: (then.get(name, ""), now.get(name, ""))
        for name in sorted(then.keys() | now.keys())
        # Of the processor, only the instructions that variables name decide.
        if then.get(name) != now.get(name) and name != "processor"
    }  # fmt: skip
