"""Shows the twin in rerun from separate threads; rerun is imported when a mirror is made.

A control loop makes a `Stage` once, a `RerunMirror` for it, and offers a `Frame` at each tick.
"""

from softrobot_twin.view.frame import Drawn, Entity, Frame, Plot, Stage, ViewError
from softrobot_twin.view.mirror import RerunMirror

__all__ = ["Drawn", "Entity", "Frame", "Plot", "RerunMirror", "Stage", "ViewError"]
