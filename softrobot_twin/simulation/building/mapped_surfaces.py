"""Surfaces and lines on the bodies that carry them, split to the size of the elements there.

A surface moves by its points alone: pressure, contact and pictures see what its points follow.
A large triangle of a file would span many elements, whatever the body does between its corners. So
each surface that is mapped onto bodies is split here, once, where its edges are longer than the
elements along them; and so is each tube and thread that a body carries all along.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softrobot_twin.geometry.cubic_bubbles import CubicMesh
from softrobot_twin.geometry.point_location import extrapolated_weights, locate_points
from softrobot_twin.geometry.surface_splitting import MOST_ROUNDS, split_triangles
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.deformable_body import SNAP_SHARE, Body

# Largest distance of a carried surface from its body, and its smallest size, as shares of the
# body's size.
STAND_OFF, LEAST_SHARE = 0.1, 0.5
# Longest edge of a mapped surface, in widths of the element along it; with room for surfaces that
# are as fine as the mesh, but not made of its faces.
LONGEST = 1.25
# Edges whose middle is off all bodies are reported, and parts of lines are split, where they span
# more elements than these: a line adds stiffness, and needs only to follow the bends of its body.
SPANNED = 3.0
# Places on an edge where the size of elements is asked for: its middle first, its ends last.
_ALONG = np.array([0.5, 0.25, 0.75, 0.0, 1.0])


def surface_on_mesh(
    body: Body, points: np.ndarray, triangles: np.ndarray, entry, key: str, scene: Scene,
    notes: list[str],
) -> tuple[BarycentricMapping, np.ndarray]:  # fmt: skip
    """Map a surface onto the mesh of the body that carries it.

    A point outside the mesh is carried by the nearest cell, with negative weights: at rest it is at
    its position, and it moves with that cell.

    Args:
        body: The body.
        points: Points at rest [m], shape (point_count, 3).
        triangles: Indices of them, shape (triangle_count, 3).
        entry: Entry with the surface's file.
        key: Key of this entry.
        scene: The scene.
        notes: List to which is appended what was split.

    Returns:
        The points of the split surface on the nodes of the mesh, numbered from 0, and its
        triangles.

    Raises:
        SceneError: The surface stands too far off the body, or is far smaller.
    """
    mesh = body.mesh.corner_mesh
    furthest = float(body.distances(points).max())
    if furthest > STAND_OFF * body.size:
        raise scene.error(f"{key}.file", str(entry.file),
                          f"stands off its body by {1e3 * furthest:.2f} mm, more than a tenth of "
                          f"the body's {1e3 * body.size:.1f} mm: is its scale right?")
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if size < LEAST_SHARE * body.size:
        raise scene.error(f"{key}.file", str(entry.file),
                          f"has a box of {1e3 * size:.3g} mm across, less than half of the body's "
                          f"{1e3 * body.size:.1f} mm: is its scale right?")
    points, triangles = split_to_elements([body], points, triangles, f"{key}.file", notes, STAND_OFF)
    found = locate_points(mesh, points)
    return body.on_mesh(found.cells, extrapolated_weights(mesh, found, points)), triangles


def split_to_elements(
    bodies: Sequence[Body], points: np.ndarray, triangles: np.ndarray, key: str, notes: list[str],
    stand_off: float = SNAP_SHARE,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Split the triangles of a file to the size of the elements that carry them.

    An edge whose middle is off all bodies, as across the mouth of a cup, is not split: nothing
    there carries it but its ends.

    Args:
        bodies: The bodies that carry it.
        points: Points [m], shape (point_count, 3).
        triangles: Indices of them, shape (triangle_count, 3).
        key: Key of the surface's entry.
        notes: List to which is appended what was split.
        stand_off: Distance up to which a body carries a point, as a share of its size.

    Returns:
        The points, those given first, and the triangles.
    """
    is_long, before = _LongEdges(bodies, stand_off), len(triangles)
    points, triangles = split_triangles(points, triangles, is_long)
    told = []
    if len(triangles) > before:
        told.append(f"{key}: its {before} triangles are split into {len(triangles)}, to the size of "
                    "the elements that carry them")
    if is_long.off_count:
        told.append(f"{key}: {is_long.off_count} edges that span several elements run off the body, so "
                    "that they are not split: the surface follows the body at their ends only")
    notes.extend(line for line in told if line not in notes)
    return points, triangles


def path_on_elements(body: Body, points, key: str, notes: list[str]) -> np.ndarray:
    """Points of a line in a body, more of them where its parts span several elements.

    Args:
        body: The body.
        points: Points in order [m], shape (point_count, 3).
        key: Key of the points.
        notes: List to which is appended what was split.

    Returns:
        The points [m], shape (at least point_count, 3).
    """
    points, is_long = np.asarray(points, float), _LongEdges([body], SNAP_SHARE, SPANNED)
    before = len(points)
    for _ in range(MOST_ROUNDS):
        cut = np.flatnonzero(is_long(np.stack([points[:-1], points[1:]], axis=1)))
        if not len(cut):
            break
        points = np.insert(points, cut + 1, 0.5 * (points[cut] + points[cut + 1]), axis=0)
    if len(points) > before:
        notes.append(f"{key}: the line is split at {len(points) - before} more points, so that it bends "
                     "as the elements that carry it")
    return points


class _LongEdges:
    """Tells which edges are longer than some elements that carry their middles.

    Attributes:
        off_count: How many edges so far span several elements, with a middle that no body carries.
    """

    def __init__(self, bodies: Sequence[Body], stand_off: float, longest: float = LONGEST):
        """Take the bodies, how far off they carry a point, and how many elements are some."""
        self.off_count, self._stand_off, self._longest = 0, stand_off, longest
        self._bodies = [(body, _shortest_edges(body)) for body in bodies]

    def __call__(self, ends: np.ndarray) -> np.ndarray:
        """Whether each is long, shape (edge_count,), by its ends [m], shape (edge_count, 2, 3)."""
        along = ends[:, 1] - ends[:, 0]
        lengths = np.linalg.norm(along, axis=1)
        places = ends[:, :1] + _ALONG[:, None] * along[:, None]
        directions = along / np.maximum(lengths, 1e-300)[:, None]
        spanned, is_on = np.zeros(len(ends)), np.zeros(len(ends), bool)
        for body, shortest in self._bodies:
            widths, away = _element_widths(body, shortest, places, directions)
            off_ends = away[:, -2:].max(axis=1)
            furthest = np.minimum(self._stand_off, SNAP_SHARE + off_ends / body.size) * body.size
            near = away <= furthest[:, None]
            spanned = np.maximum(spanned, lengths * (near / widths).max(axis=1))
            is_on |= near[:, 0]
        self.off_count += int(np.count_nonzero((spanned > SPANNED) & ~is_on))
        return (spanned > self._longest) & is_on


def _element_widths(
    body: Body, shortest: np.ndarray, places: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance between nodes along edges, and distance of places on them from the body [m].

    Each is of shape (edge_count, place_count).

    Args:
        body: The body.
        shortest: Shortest edge of each of its cells [m], shape (cell_count,).
        places: On each edge [m], shape (edge_count, place_count, 3).
        directions: Of the edges, shape (edge_count, 3).
    """
    mesh, count = body.mesh.corner_mesh, places.shape[1]
    found = locate_points(mesh, places.reshape(-1, 3))
    corners = mesh.node_positions[found.nodes]
    across = np.einsum("pai,pi->pa", corners, np.repeat(directions, count, axis=0))
    # Across a sliver the width vanishes; between its nodes a body cannot bend.
    widths = np.maximum(np.ptp(across, axis=1), shortest[found.cells])
    widths /= 2 ** nodes_between(body.mesh)
    return widths.reshape(-1, count), found.distances.reshape(-1, count)


def _shortest_edges(body: Body) -> np.ndarray:
    """Shortest edge of each cell of a body [m], shape (cell_count,)."""
    mesh = body.mesh.corner_mesh
    corners = mesh.node_positions[mesh.cells]
    first, second = np.triu_indices(corners.shape[1], 1)
    lengths = np.linalg.norm(corners[:, first] - corners[:, second], axis=2)
    # A tetrahedron among hexahedra repeats its last corner.
    return np.where(lengths > 0.0, lengths, np.inf).min(axis=1)


def nodes_between(mesh) -> int:
    """How often an edge of a cell is halved so that its parts end at nodes, or sample bubbles.

    Args:
        mesh: Mesh of a body.
    """
    if isinstance(mesh, CubicMesh):
        return 2
    return int(len(mesh.mid_edge_ends) > 0)
