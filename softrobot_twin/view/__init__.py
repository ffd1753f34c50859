"""Shows the twin in rerun from separate threads; rerun is imported when a mirror is made.

A control loop makes a `Stage` once, a `RerunMirror` for it, and offers a `Frame` at each tick.
"""

from softrobot_twin.view.frame import Frame, Stage, Surface, ViewError
from softrobot_twin.view.mirror import RerunMirror

__all__ = ["Frame", "RerunMirror", "Stage", "Surface", "ViewError"]
