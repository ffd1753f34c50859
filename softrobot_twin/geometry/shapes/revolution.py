"""Closed surfaces of revolution, made of rings of points between two poles."""

from __future__ import annotations

import numpy as np

# A round thing keeps its form with this many sides at least.
FEWEST_SIDES = 8


def side_count(radius: float, resolution: float) -> int:
    """Sides of a ring: enough for the resolution, an even number."""
    return max(FEWEST_SIDES, 2 * int(np.ceil(np.pi * radius / resolution)))


def revolve(radii: np.ndarray, heights: np.ndarray, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Turns a profile about the z axis.

    Args:
        radii: Radii of the rings from the bottom up [m], shape (ring_count,); the first and the
            last are zero, the poles.
        heights: Their heights [m], shape (ring_count,).
        sides: Points of a ring.

    Returns:
        Points [m], shape (point_count, 3), and triangles, counter-clockwise from outside, int64.
    """
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = [
        np.column_stack([radius * circle, np.full(sides, height)])
        for radius, height in zip(radii[1:-1], heights[1:-1], strict=True)
    ]
    poles = np.array([[0.0, 0.0, heights[0]], [0.0, 0.0, heights[-1]]])
    here = np.arange(sides)
    following = (here + 1) % sides
    top = 2 + (len(rings) - 1) * sides
    triangles = [
        np.column_stack([np.zeros(sides, np.int64), 2 + following, 2 + here]),
        np.column_stack([np.ones(sides, np.int64), top + here, top + following]),
    ]
    for ring in range(len(rings) - 1):
        low = 2 + ring * sides
        a, b, c, d = low + here, low + following, low + sides + here, low + sides + following
        triangles += [np.column_stack([a, b, d]), np.column_stack([a, d, c])]
    return np.vstack([poles, *rings]), np.vstack(triangles).astype(np.int64)
