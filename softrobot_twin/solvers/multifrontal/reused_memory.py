"""Room for the updates: taken when a front makes its update, free again once its parent has it."""

from __future__ import annotations

from bisect import insort

import numpy as np


class FirstFit:
    """Free stretches of a memory without end; a request gets the lowest that is long enough."""

    def __init__(self):
        self.size = 0  # of what was ever in use
        self._free = [(0, 1 << 62)]

    def take(self, size: int) -> int:
        """Reserve a stretch; returns its start."""
        for number, (start, length) in enumerate(self._free):
            if length >= size:
                self._free[number] = (start + size, length - size)
                self.size = max(self.size, start + size)
                return start
        raise MemoryError(f"no room for an update of {size} doubles")

    def give_back(self, start: int, size: int) -> None:
        """Free a stretch, and join it with free neighbours."""
        insort(self._free, (start, size))
        joined = []
        for piece in self._free:
            if joined and sum(joined[-1]) == piece[0]:
                joined[-1] = (joined[-1][0], joined[-1][1] + piece[1])
            else:
                joined.append(piece)
        self._free = joined


def plan_updates(
    sizes: np.ndarray, fronts: np.ndarray, children: np.ndarray
) -> tuple[np.ndarray, int]:
    """Offsets of all updates.

    Args:
        sizes: Doubles of each front's update, shape (front_count,).
        fronts: The fronts' `child_start` and `child_end` in `children`.
        children: Fronts whose updates a front takes up.

    Returns:
        Offsets, shape (front_count,), and the size of the memory.
    """
    offsets = np.zeros(len(sizes), dtype=np.int64)
    memory = FirstFit()
    for s in range(len(sizes)):
        # A front writes its own update while its children's are still being added.
        if sizes[s]:
            offsets[s] = memory.take(int(sizes[s]))
        for child in children[fronts[s]["child_start"] : fronts[s]["child_end"]]:
            if sizes[child]:
                memory.give_back(int(offsets[child]), int(sizes[child]))
    return offsets, memory.size
