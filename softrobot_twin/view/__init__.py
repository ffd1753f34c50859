"""The mirror to rerun, in threads of its own; rerun is imported when a mirror is made.

What a control loop needs: a `Stage` once, a `Frame` each tick, and a `RerunMirror` to offer it to.
"""

from softrobot_twin.view.frame import Frame, Stage, Surface, ViewError
from softrobot_twin.view.mirror import RerunMirror

__all__ = ["Frame", "RerunMirror", "Stage", "Surface", "ViewError"]
