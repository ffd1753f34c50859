"""Draws triangles as seen by a parallel camera, so that what lies inside bodies shows through.

matplotlib draws them from the farthest to the nearest, and marks and lines once more over all, by which
those behind a surface show through it. Closed surfaces show the sides that face the viewer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.harness.figure import load_pyplot

LAYERS = {"mesh": "solid", "rigid": "solid", "thin": "marks", "clear": "clear"}
"""Layer of each look of a solid."""
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


def draw_triangles(axes, layers: dict[str, Triangles]) -> None:
    """Draws all layers.

    Args:
        axes: matplotlib's axes, in the unit of the corners.
        layers: Triangles of the layers ``solid``, ``marks`` and ``clear``.
    """
    _draw(axes, [(layers["solid"], 1.0, 1.0), (layers["marks"], 1.0, 1.0), (layers["clear"], _CLEAR, _CLEAR_EDGE)])
    _draw(axes, [(layers["marks"], _THROUGH, 0.0)])


def image_of(layers: dict[str, Triangles], window, shape: tuple[int, int]) -> np.ndarray:
    """An image of all layers; see `draw_triangles`.

    Args:
        layers: Triangles of each layer.
        window: Left, right, bottom and top of the image, in the unit of the corners.
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
    draw_triangles(axes, layers)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def _draw(axes, parts: list[tuple[Triangles, float, float]]) -> None:
    """Draws triangles with the opacity of their faces and of their edges, the nearest last."""
    from matplotlib.collections import PolyCollection

    corners, faces, edges = [np.empty((0, 3, 3))], [np.empty((0, 4))], [np.empty((0, 4))]
    for triangles, face, edge in parts:
        sides = triangles.corners[:, 1:, :2] - triangles.corners[:, :1, :2]
        places, colours, has_edges = (one[np.linalg.det(sides) > 0.0] for one in triangles)
        corners.append(places)
        faces.append(np.insert(colours, 3, face, axis=1))
        # An edge in the colour of the face closes the gap to the next one.
        shares = np.where(has_edges, _EDGE, 1.0)[:, None]
        edges.append(np.insert(shares * colours, 3, edge, axis=1))
    every = np.concatenate(corners)
    order = np.argsort(every[..., 2].mean(axis=1), kind="stable")
    axes.add_collection(PolyCollection(
        every[order, :, :2], facecolors=np.concatenate(faces)[order],
        edgecolors=np.concatenate(edges)[order], linewidths=0.3, zorder=2), autolim=False)
