"""Points along helices, such as the threads that are wound around a tube."""

from __future__ import annotations

import numpy as np


def helix_points(
    point: np.ndarray, direction: np.ndarray, radius: float, pitch: float,
    reach: tuple[float, float], phase: float, turn: int, segments_per_turn: int,
) -> np.ndarray:  # fmt: skip
    """Points of one helix, at equal distances.

    Args:
        point: A point of the axis [m], shape (3,).
        direction: Direction of the axis, of any length, shape (3,).
        radius: Distance of the points from the axis [m].
        pitch: Advance along the axis in one turn [m], positive.
        reach: First and last place along the axis, measured from `point` [m].
        phase: Angle at which it begins [rad], about the axis from `across`.
        turn: 1 for a right-handed helix, -1 for a left-handed one.
        segments_per_turn: Straight segments in one turn; at least two are made.

    Returns:
        The points in order [m], shape (segment_count + 1, 3).
    """
    along = np.asarray(direction, float) / np.linalg.norm(direction)
    first = across(along)
    second = np.cross(along, first)
    begin, end = reach
    turns = (end - begin) / pitch
    count = max(2, int(np.ceil(segments_per_turn * turns)))
    places = np.linspace(0.0, 1.0, count + 1)[:, None]
    angles = phase + turn * 2.0 * np.pi * turns * places
    round_axis = np.cos(angles) * first + np.sin(angles) * second
    return np.asarray(point, float) + (begin + (end - begin) * places) * along + radius * round_axis


def across(along: np.ndarray) -> np.ndarray:
    """Unit vector from which angles about an axis are measured.

    It is the part across the axis of the first coordinate axis, or of the second one where the
    first is within 45° of the axis: for an axis along z angles begin at x.

    Args:
        along: Unit vector of the axis, shape (3,).
    """
    start = np.eye(3)[0] if abs(along[0]) < np.sqrt(0.5) else np.eye(3)[1]
    start = start - (start @ along) * along
    return start / np.linalg.norm(start)
