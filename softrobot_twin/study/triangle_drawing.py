"""Draws triangles as seen by a parallel camera, so that what lies inside bodies shows through.

matplotlib draws them from the farthest to the nearest, and marks and lines once more over all, by which
those behind a surface show through it. Closed surfaces show the sides that face the viewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.harness.figure import load_pyplot

# How strongly marks behind a surface show through it, opacity of clear surfaces and of their edges, and the
# colour of the edges of a mesh as a share of its own.
_THROUGH, _CLEAR, _CLEAR_EDGE, _EDGE = 0.4, 0.26, 0.6, 0.82


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


class Solid(NamedTuple):
    """Triangles of one colour.

    Attributes:
        triangles: Corners [m], shape (triangle_count, 3, 3).
        colour: Red, green, blue in 0..1, shape (3,).
        look: ``mesh`` with edges and strong shading, ``clear`` the same but translucent, ``rigid``
            without edges, ``thin`` with weak shading, seen through what lies in front of it.
        kind: What it shows, as named in the legend of a picture; empty where it names none.
        value: Tension of a cable [N] or gauge pressure of a cavity [kPa], by which a picture
            colours it.
    """

    triangles: np.ndarray
    colour: np.ndarray
    look: str
    kind: str = ""
    value: float = 0.0


def unit_normals(triangles: np.ndarray) -> np.ndarray:
    """Unit normals of triangles, shape (triangle_count, 3).

    Args:
        triangles: Corners, shape (triangle_count, 3, 3).
    """
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def draw_solids(axes, solids: Sequence[Solid], camera: Camera, scale: float = 1.0) -> None:
    """Draws solids, lit from the viewer's upper left.

    Args:
        axes: matplotlib's axes.
        solids: What is drawn.
        camera: The view.
        scale: Unit of the axes [1/m].
    """
    counts = [len(solid.triangles) for solid in solids]
    triangles = np.concatenate([np.empty((0, 3, 3)), *(solid.triangles for solid in solids)])
    look = np.repeat(np.array([solid.look for solid in solids], str), counts)
    own = np.repeat(np.array([solid.colour for solid in solids]).reshape(-1, 3), counts, axis=0)
    share = _brightness(unit_normals(triangles), camera)
    share = np.where(look == "thin", 0.6 + 0.4 * share, share)
    colours = np.clip(own * share[:, None], 0.0, 1.0)
    # An edge in the colour of the face closes the gap to the next one.
    edges = np.where(np.isin(look, ("mesh", "clear")), _EDGE, 1.0)[:, None] * colours
    places = camera.project(scale * triangles)
    sides = places[:, 1:, :2] - places[:, :1, :2]
    front = np.linalg.det(sides) > 0.0
    is_clear, marks = look == "clear", front & (look == "thin")
    _add(axes, places[front], np.insert(colours, 3, np.where(is_clear, _CLEAR, 1.0), axis=1)[front],
         np.insert(edges, 3, np.where(is_clear, _CLEAR_EDGE, 1.0), axis=1)[front])
    _add(axes, places[marks], np.insert(colours[marks], 3, _THROUGH, axis=1),
         np.insert(edges[marks], 3, 0.0, axis=1))


def image_of(solids: Sequence[Solid], camera: Camera, window, shape: tuple[int, int]) -> np.ndarray:
    """An image of solids; see `draw_solids`.

    Args:
        solids: What is seen.
        camera: The view.
        window: Left, right, bottom and top of the image [m].
        shape: Rows and columns of the image.

    Returns:
        Red, green and blue, 0 to 255, top row first, shape (rows, columns, 3).

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    load_pyplot()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = FigureCanvasAgg(Figure((shape[1] / 100, shape[0] / 100), dpi=100))
    axes = canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=window[:2], ylim=window[2:])
    axes.set_axis_off()
    draw_solids(axes, solids, camera)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def _brightness(normals: np.ndarray, camera: Camera) -> np.ndarray:
    """Share of light reflected by triangles with these unit normals, shape (triangle_count,)."""
    light = 0.75 * camera.eye - 0.45 * camera.right + 0.5 * camera.up
    light /= np.linalg.norm(light)
    return 0.62 + 0.42 * np.clip(normals @ light, 0.0, None) + 0.08 * normals[:, 2]


def _add(axes, triangles: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> None:
    """Adds triangles in colours with their opacity, the nearest last."""
    from matplotlib.collections import PolyCollection

    order = np.argsort(triangles[..., 2].mean(axis=1), kind="stable")
    axes.add_collection(PolyCollection(
        triangles[order, :, :2], facecolors=faces[order], edgecolors=edges[order],
        linewidths=0.3, zorder=2), autolim=False)
