"""Prints a table of what each effect of scenes costs."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from softrobot_twin.scene import load_scene
from softrobot_twin.study.effect_costs import effect_costs, told


def page_lines(scenes: Sequence[Path]) -> Iterator[str]:
    """The lines of the table.

    Args:
        scenes: Scene files.
    """
    yield "| scene | effect | µs a step | share | on the way, mm | at the end, mm | as a force, N |"
    yield "|---|---|---|---|---|---|---|"
    for scene in scenes:
        for row in effect_costs(load_scene(scene)):
            cells = told(row)
            cells[1] += " %" * bool(cells[1])
            reason = "cannot be left out" if row.cost != row.cost else row.reason
            yield f"| {scene.stem} | {row.name}{': ' * bool(reason)}{reason} | {' | '.join(cells)} |"


if __name__ == "__main__":
    for line in page_lines([Path(name) for name in sys.argv[1:]]):
        print(line, flush=True)
