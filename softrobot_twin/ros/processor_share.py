"""How much of the processor other programs took while the demo ran."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import NamedTuple

MUCH = 0.1
"""Share of the processor from which on what others took shows in a demo's figures."""
_IDLE, _IOWAIT, _GUEST = 3, 4, 8
"""Places in a line of /proc/stat: two that are no work, and the first that is counted already."""
_SESSION, _USER, _SYSTEM = 3, 11, 12
"""Places in /proc/<process>/stat after the program's name."""


class ProcessorTimes(NamedTuple):
    """Times since the machine started [s].

    Attributes:
        moment: When they were read, on a clock that never goes back.
        busy: Time that the cores asked for spent on anything, summed.
        own: Time that the sessions asked for spent, summed.
        cores: How many cores that is.
    """

    moment: float
    busy: float
    own: float
    cores: int


def processor_times(
    sessions: Iterable[int], cores: Collection[int], proc: Path = Path("/proc")
) -> ProcessorTimes:
    """Reads what the processor did so far.

    Args:
        sessions: Ids of the sessions whose time is our own; this process is counted too.
        cores: The cores that count.
        proc: The folder of the kernel's tables.

    Raises:
        OSError: There are no such tables here.
    """
    tick = os.sysconf("SC_CLK_TCK")
    allowed = {f"cpu{core}" for core in cores}
    busy = 0
    for line in (proc / "stat").read_text().splitlines():
        name, *words = line.split()
        if name in allowed:
            counts = [int(word) for word in words[:_GUEST]]
            busy += sum(counts) - counts[_IDLE] - counts[_IOWAIT]
    wanted, own, here = set(sessions), 0, os.getpid()
    for entry in proc.glob("[0-9]*"):
        try:
            # The program's name may hold anything, also spaces and brackets.
            words = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(entry.name) == here or int(words[_SESSION]) in wanted:
            own += int(words[_USER]) + int(words[_SYSTEM])
    return ProcessorTimes(time.monotonic(), busy / tick, own / tick, len(cores))


def share_of_others(before: ProcessorTimes, after: ProcessorTimes) -> float:
    """Share of the processor that others took between two readings, 0 to 1.

    What a process of ours that ended meanwhile had spent is not counted as theirs twice: read
    while all of them run.
    """
    whole = (after.moment - before.moment) * after.cores
    others = (after.busy - before.busy) - (after.own - before.own)
    return min(1.0, max(0.0, others / whole)) if whole > 0.0 else 0.0
