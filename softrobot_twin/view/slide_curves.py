"""Slides as rerun curves: where each stands, and the force that holds it.

Importing this module imports rerun.
"""

from __future__ import annotations

from collections.abc import Sequence

from softrobot_twin.view.frame import Frame
from softrobot_twin.view.recording import Recording

SLIDE_PLOT = "/plots/slides"

_COLOURS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167))


class SlideCurves:
    """Draws two curves for each slide.

    Args:
        recording: Where to.
        names: Names of the slides.
    """

    def __init__(self, recording: Recording, names: Sequence[str]):
        self._recording = recording
        curves = [f"{name} [{unit}]" for name in names for unit in ("mm", "N")]
        colours = [_COLOURS[index % len(_COLOURS)] for index in range(len(curves))]
        recording.name_series(SLIDE_PLOT, curves, colours)

    def log(self, frame: Frame) -> None:
        """Draw the slides of a frame."""
        pairs = zip(frame.slide_positions, frame.slide_forces, strict=True)
        values = [value for position, force in pairs for value in (1e3 * position, force)]
        self._recording.log_series(SLIDE_PLOT, values)
