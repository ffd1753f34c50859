"""Draws triangles as seen by a parallel camera, so that what lies inside bodies shows through.

There are three layers: solid surfaces, marks and lines, and clear surfaces. Each has a depth of its
own at every pixel, the nearest surface there. A mark in front of the solid surfaces has its own
colour; a mark behind them shows through; a clear surface is laid over whatever lies behind it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.compilation import KERNEL, njit

LAYERS = {"mesh": "solid", "rigid": "solid", "thin": "marks", "clear": "clear"}
"""Layer of each look of a solid."""
# Pixels of the drawing per pixel of the image, in each direction.
_FINER = 2
# How strongly marks behind a surface show through it.
_THROUGH = 0.45
# Opacity of clear surfaces, and of their edges and outlines.
_CLEAR, _CLEAR_EDGE = 0.26, 0.6
# Factors of the colour at edges of the mesh and at outlines.
_EDGE, _OUTLINE = 0.82, 0.5
# Half the width of edges, in pixels of the drawing; triangles of less than the second number have
# weaker edges, or small ones would become dark.
_EDGE_HALF_WIDTH, _EDGE_FADES = 0.75, 14.0
# An outline is drawn where the depth jumps by more than this share of the picture's size.
_JUMP = 0.02


class Camera(NamedTuple):
    """A parallel projection: three unit vectors, each of shape (3,).

    Attributes:
        right: To the right in the picture.
        up: Upwards in the picture.
        eye: Towards the viewer.
    """

    right: np.ndarray
    up: np.ndarray
    eye: np.ndarray

    def project(self, points) -> np.ndarray:
        """Places in the picture, and nearness: larger is nearer.

        Args:
            points: In space, shape (..., 3), in any unit of length.

        Returns:
            To the right, upwards and towards the viewer, same shape and unit.
        """
        return np.asarray(points, float) @ np.column_stack(self)


def camera_at(elevation: float, azimuth: float) -> Camera:
    """The camera that looks at the scene from a direction [degrees].

    Args:
        elevation: Angle above the horizon [degrees].
        azimuth: Angle about z, from x to y [degrees].
    """
    rise, turn = np.radians([elevation, azimuth])
    outward = np.array([np.cos(turn), np.sin(turn), 0.0])
    upward = np.array([0.0, 0.0, 1.0])
    return Camera(
        np.array([-np.sin(turn), np.cos(turn), 0.0]),
        np.cos(rise) * upward - np.sin(rise) * outward,
        np.cos(rise) * outward + np.sin(rise) * upward,
    )  # fmt: skip


class Triangles(NamedTuple):
    """Triangles of one layer.

    Attributes:
        corners: In the picture, see `Camera.project`, shape (triangle_count, 3, 3).
        colours: Lit colours in 0..1, shape (triangle_count, 3).
        has_edges: Whether each shows its edges, shape (triangle_count,).
    """

    corners: np.ndarray
    colours: np.ndarray
    has_edges: np.ndarray


class _Layer(NamedTuple):
    """What is nearest at each pixel of the drawing.

    Attributes:
        nearness: Of the surface, -inf for nothing, shape (rows, columns).
        colour: With edges and outlines, shape (rows, columns, 3).
        is_line: Where edges and outlines are, shape (rows, columns).
    """

    nearness: np.ndarray
    colour: np.ndarray
    is_line: np.ndarray


def rasterize(layers: dict[str, Triangles], window, shape: tuple[int, int]) -> np.ndarray:
    """Draws all layers.

    Args:
        layers: Triangles of the layers ``solid``, ``marks`` and ``clear``.
        window: Left, right, bottom and top of the image, in the unit of the corners.
        shape: Rows and columns of the image.

    Returns:
        Red, green, blue and opacity in 0..1, top row first, shape (rows, columns, 4).
    """
    size = max(window[1] - window[0], window[3] - window[2])
    solid, marks, clear = (
        _draw(layers[name], window, shape, _JUMP * size if name != "marks" else np.inf)
        for name in ("solid", "marks", "clear")
    )  # fmt: skip
    opacity = np.isfinite(solid.nearness).astype(np.float32)
    colour = solid.colour * opacity[..., None]
    nearest = solid.nearness
    is_mark = np.isfinite(marks.nearness)
    share = np.where(is_mark, np.where(marks.nearness >= nearest, 1.0, _THROUGH), 0.0)
    # Where nothing lies in front of a mark it has its own colour.
    share[is_mark & (opacity == 0.0)] = 1.0
    colour, opacity = _over(colour, opacity, marks.colour, share)
    nearest = np.maximum(nearest, marks.nearness)
    share = np.where(clear.is_line, _CLEAR_EDGE, _CLEAR)
    share[~(np.isfinite(clear.nearness) & (clear.nearness > nearest))] = 0.0
    colour, opacity = _over(colour, opacity, clear.colour, share)
    image = np.dstack([colour, opacity]).astype(np.float32)
    rows, columns = shape
    image = image.reshape(rows, _FINER, columns, _FINER, 4).mean(axis=(1, 3))
    # Colours were multiplied by their opacity.
    image[..., :3] /= np.maximum(image[..., 3:], 1e-6)
    return np.clip(image, 0.0, 1.0)


def _over(colour: np.ndarray, opacity: np.ndarray, above: np.ndarray, share: np.ndarray):
    """Lays a colour over an image whose colours are multiplied by their opacity."""
    share = share.astype(np.float32)
    below = 1.0 - share
    return above * share[..., None] + colour * below[..., None], share + opacity * below


def _draw(triangles: Triangles, window, shape: tuple[int, int], jump: float) -> _Layer:
    """Draws one layer with its edges and, where the depth jumps, outlines."""
    rows, columns = _FINER * shape[0], _FINER * shape[1]
    nearness = np.full((rows, columns), -np.inf, np.float32)
    index = np.full((rows, columns), -1, np.int32)
    edge = np.ones((rows, columns), np.float32)
    left, right, bottom, top = window
    placed = triangles.corners.copy()
    placed[..., 0] = (placed[..., 0] - left) * (columns / (right - left))
    placed[..., 1] = (top - placed[..., 1]) * (rows / (top - bottom))
    fill_triangles(placed, triangles.has_edges, nearness, index, edge)
    # The last colour is that of nothing.
    colour = np.vstack([triangles.colours, np.zeros((1, 3))]).astype(np.float32)[index]
    colour *= edge[..., None]
    is_line = edge < 1.0
    if np.isfinite(jump):
        outlines = _outlines(nearness, jump)
        colour[outlines] *= _OUTLINE
        is_line |= outlines
    return _Layer(nearness, colour, is_line)


def _outlines(nearness: np.ndarray, jump: float) -> np.ndarray:
    """Pixels from which the depth falls by more than a jump to a neighbour, bool."""
    with np.errstate(invalid="ignore"):  # nothing beside nothing: -inf - -inf
        down = nearness[:-1] - nearness[1:]
        across = nearness[:, :-1] - nearness[:, 1:]
    found = np.zeros(nearness.shape, bool)
    found[:-1] |= down > jump
    found[1:] |= down < -jump
    found[:, :-1] |= across > jump
    found[:, 1:] |= across < -jump
    return found


@njit(**KERNEL)
def fill_triangles(corners, has_edges, nearness, index, edge):
    """Keep at each pixel the triangle that is nearest there.

    Args:
        corners: In pixels to the right and downwards, and nearness, shape (triangle_count, 3, 3).
        has_edges: Whether each triangle shows its edges, shape (triangle_count,).
        nearness: Of what is drawn so far, shape (rows, columns); changed.
        index: Triangle at each pixel, -1 for none, same shape; changed.
        edge: Factor of the colour at edges, same shape; changed.
    """
    rows, columns = nearness.shape
    for t in range(len(corners)):
        ax, ay, az = corners[t, 0]
        bx, by, bz = corners[t, 1]
        cx, cy, cz = corners[t, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1.0e-12:
            continue
        first_row = max(0, int(np.ceil(min(ay, by, cy) - 0.5)))
        last_row = min(rows - 1, int(np.floor(max(ay, by, cy) - 0.5)))
        first_column = max(0, int(np.ceil(min(ax, bx, cx) - 0.5)))
        last_column = min(columns - 1, int(np.floor(max(ax, bx, cx) - 0.5)))
        # Height of the triangle over each of its sides.
        over_a = abs(area) / np.hypot(bx - cx, by - cy)
        over_b = abs(area) / np.hypot(cx - ax, cy - ay)
        over_c = abs(area) / np.hypot(ax - bx, ay - by)
        strength = min(1.0, min(over_a, over_b, over_c) / _EDGE_FADES)
        for i in range(first_row, last_row + 1):
            y = i + 0.5
            for j in range(first_column, last_column + 1):
                x = j + 0.5
                a = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                b = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                c = 1.0 - a - b
                if a < 0.0 or b < 0.0 or c < 0.0:
                    continue
                z = a * az + b * bz + c * cz
                if z <= nearness[i, j]:
                    continue
                nearness[i, j], index[i, j], edge[i, j] = z, t, 1.0
                if has_edges[t] and min(a * over_a, b * over_b, c * over_c) < _EDGE_HALF_WIDTH:
                    edge[i, j] = 1.0 - strength * (1.0 - _EDGE)
