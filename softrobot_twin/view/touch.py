"""Contacts as rerun entities: a point where bodies touch, an arrow for the force there.

Importing this module imports rerun.
"""

from __future__ import annotations

import numpy as np
import rerun as rr

from softrobot_twin.view.frame import Frame
from softrobot_twin.view.recording import Recording

CONTACT_POINTS = "/contacts/points"
CONTACT_FORCES = "/contacts/forces"
CONTACT_PLOT = "/plots/contacts"

_CURVES = ("count", "largest force [N]")
_POINT_COLOUR = (230, 60, 60)
_FORCE_COLOUR = (255, 110, 70)
_CURVE_COLOURS = ((86, 180, 233), (213, 94, 0))


class Touch:
    """Draws contacts; where there are none, nothing is left standing.

    Args:
        recording: Where to.
        force_scale: Length of the arrow of a force [m/N].
    """

    def __init__(self, recording: Recording, force_scale: float):
        self._recording, self._force_scale = recording, force_scale
        radius = rr.Radius.ui_points
        recording.log(CONTACT_POINTS, rr.Points3D.from_fields(
            colors=[_POINT_COLOUR], radii=[radius(3.0)]), static=True)
        recording.log(CONTACT_FORCES, rr.Arrows3D.from_fields(
            colors=[_FORCE_COLOUR], radii=[radius(1.5)]), static=True)
        recording.name_series(CONTACT_PLOT, _CURVES, _CURVE_COLOURS)

    def log(self, frame: Frame) -> None:
        """Draw the contacts of a frame: the force on the first body, where it acts."""
        positions = np.asarray(frame.contact_positions, dtype=np.float32)
        forces = np.asarray(frame.contact_forces, dtype=float)
        arrows = (self._force_scale * forces).astype(np.float32)
        self._recording.log(CONTACT_POINTS, rr.Points3D.from_fields(positions=positions))
        self._recording.log(CONTACT_FORCES,
                            rr.Arrows3D.from_fields(origins=positions, vectors=arrows))
        largest = np.linalg.norm(forces, axis=1).max(initial=0.0)
        self._recording.log_series(CONTACT_PLOT, [len(positions), largest])
