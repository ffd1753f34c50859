"""Where the effectors have just been."""

from __future__ import annotations

from collections import deque

import numpy as np


class EffectorTrail:
    """The effectors' path over the last seconds, in a bounded number of points.

    Args:
        duration: How far back the trail reaches [s].
        point_count: How many points it may have; they are this much of the duration apart.
    """

    def __init__(self, duration: float, point_count: int = 200):
        self._duration_ns = int(duration * 1e9)
        self._spacing_ns = self._duration_ns // point_count
        self._points: deque[tuple[int, np.ndarray]] = deque(maxlen=point_count + 1)

    def extend(self, time_ns: int, positions: np.ndarray) -> list[np.ndarray]:
        """Add where the effectors are now and return the trail up to there.

        A clock that steps back starts the trail anew.

        Args:
            time_ns: Time of the positions [ns].
            positions: Effectors [m], shape (effector_count, 3).

        Returns:
            A polyline for each effector [m], oldest point first, each of shape (point_count, 3).
        """
        points = self._points
        if points and time_ns < points[-1][0]:
            points.clear()
        while points and time_ns - points[0][0] > self._duration_ns:
            points.popleft()
        path = np.array([past for _, past in points] + [positions], dtype=np.float32)
        if not points or time_ns - points[-1][0] >= self._spacing_ns:
            points.append((time_ns, np.array(positions)))
        return [path[:, effector] for effector in range(path.shape[1])]
