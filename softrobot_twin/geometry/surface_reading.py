"""Reading and repair of triangle surfaces: obstacles, rigid bodies and appearances of bodies."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import flatten_regions
from softrobot_twin.geometry.mass_properties import MassProperties, surface_mass_properties
from softrobot_twin.geometry.mesh_file_checks import check_file, check_positions, check_size
from softrobot_twin.geometry.mesh_repair import first_of_duplicates
from softrobot_twin.geometry.point_location import closest_on_triangles
from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.geometry.vtu_reading import read_vtu


@dataclass(frozen=True, eq=False)
class SolidSurface:
    """A closed surface in the frame of its carrier, an obstacle or a rigid body.

    Attributes:
        points: Its points [m], shape (point_count, 3).
        triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).
    """

    points: np.ndarray
    triangles: np.ndarray

    def surface(self, resolution: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Returns points and triangles; the resolution has no effect.

        Args:
            resolution: Wanted length of edges [m]; not read, because the triangles are given.
        """
        return self.points, self.triangles

    def mass_properties(self) -> MassProperties:
        """Returns volume, centroid and inertia about the centroid at unit density."""
        return surface_mass_properties(self.points, self.triangles)

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Computes the distances of points from the solid, zero inside [m].

        Args:
            points: Points in the frame of the carrier [m], shape (count, 3).

        Returns:
            Shape (count,).
        """
        corners = self.points[self.triangles]
        found = np.zeros(len(points))
        for index, point in enumerate(np.asarray(points, float)):
            if _is_inside(point, corners):
                continue
            weights = closest_on_triangles(np.tile(point, (len(corners), 1)), corners)
            nearest = np.einsum("tc,tci->ti", weights, corners)
            found[index] = np.linalg.norm(nearest - point, axis=1).min()
        return found


def _is_inside(point: np.ndarray, corners: np.ndarray) -> bool:
    """Whether a closed surface is wound around a point: by the sum of its solid angles."""
    a, b, c = np.moveaxis(corners - point, 1, 0)
    p, q, r = (np.linalg.norm(arm, axis=1) for arm in (a, b, c))
    volume = np.einsum("ti,ti->t", a, np.cross(b, c))
    product = p * q * r + r * np.sum(a * b, axis=1) + p * np.sum(b * c, axis=1)
    product += q * np.sum(c * a, axis=1)
    return float(np.arctan2(volume, product).sum()) > np.pi


# Tolerance relative to the size of the surface: points nearer to an edge lie on it, and triangles
# of a smaller height have no area. Files store six or seven digits.
ON_EDGE = 1.0e-6
# Each round cuts an edge at one point; parts of it are cut again in the next round.
_MOST_ROUNDS = 50


class RepairedSurface(NamedTuple):
    """A surface, and how it was repaired.

    Attributes:
        triangles: Indices of the points, shape (triangle_count, 3).
        notes: One sentence for each repair.
    """

    triangles: np.ndarray
    notes: list[str]


def repair_surface(points: np.ndarray, triangles: np.ndarray) -> RepairedSurface:
    """Repairs common errors in files of closed surfaces.

    Triangles without area and repeated ones are dropped, triangles are cut where points of others lie on their edges
    (T-junctions), and triangles with the wrong orientation are reversed, so that neighbours have
    opposite directions along their common edge and normals point outwards.

    Args:
        points: Points [m], coincident ones merged, shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        The surface. Errors that cannot be repaired remain.
    """
    notes: list[str] = []
    tolerance = ON_EDGE * float(np.linalg.norm(np.ptp(points[np.unique(triangles)], axis=0)))
    flat = _heights(points, triangles) <= tolerance
    if flat.any() and not flat.all():
        triangles = triangles[~flat]
        notes.append(f"dropped {flat.sum()} triangles without area")
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    if len(first) < len(triangles):
        notes.append(f"dropped {len(triangles) - len(first)} triangles that the file contains more "
                     "than once")  # fmt: skip
        triangles = triangles[np.sort(first)]
    cut = _cut_at_junctions(points, triangles, tolerance)
    if len(cut) > len(triangles):
        notes.append(
            f"cut {len(cut) - len(triangles)} times where points lie on edges of larger "
            "triangles (T-junctions)"
        )
        triangles = cut
    consistent = _with_consistent_orientation(triangles)
    count = int((consistent != triangles).any(axis=1).sum())
    outward, was_inward = _outward(points, consistent)
    if was_inward and not (outward != triangles).any():
        # The two corrections cancel: the file was right.
        return RepairedSurface(outward, notes)
    if count and not was_inward:
        notes.append(
            f"reversed {count} triangles whose orientation was opposite to that of their neighbours"
        )
    elif was_inward:
        notes.append("reversed all triangles: their normals pointed inwards")
    return RepairedSurface(outward, notes)


def _heights(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Least height of each triangle [m]."""
    corners = points[triangles]
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    areas = np.linalg.norm(np.cross(sides[:, 1], sides[:, 2]), axis=1)
    return np.where(longest > 0.0, areas / np.where(longest > 0.0, longest, 1.0), 0.0)


def _open_halves(triangles: np.ndarray) -> np.ndarray:
    """Triangle and corner of each edge that belongs to one triangle only, shape (count, 2)."""
    _, _, place, counts = half_edges(triangles)
    single = np.flatnonzero(counts[place] == 1)
    return np.column_stack([single // 3, single % 3])


def _cut_at_junctions(points, triangles, tolerance: float) -> np.ndarray:
    """Cuts triangles at points on their open edges; one point per edge in each round."""
    for _ in range(_MOST_ROUNDS):
        places = _open_halves(triangles)
        if not len(places):
            break
        border = np.unique(triangles[places[:, 0]][np.arange(len(places)), places[:, 1]])
        ends = triangles[places[:, 0]][np.arange(len(places)), (places[:, 1] + 1) % 3]
        border = np.union1d(border, ends)
        tree = cKDTree(points[border])
        cut, whole = [], np.ones(len(triangles), dtype=bool)
        for t, corner in places:
            if not whole[t]:
                continue
            i, j, k = np.roll(triangles[t], -corner)
            middle = _first_between(points, border, tree, i, j, tolerance)
            if middle >= 0 and middle != k:
                whole[t] = False
                cut += [[i, middle, k], [middle, j, k]]
        if not cut:
            break
        triangles = np.vstack([triangles[whole], np.array(cut, dtype=np.int64)])
    return triangles


def _first_between(points, border, tree, i: int, j: int, tolerance: float) -> int:
    """Border point on the edge from i to j that is nearest to i, -1 for none."""
    start, along = points[i], points[j] - points[i]
    length = float(np.linalg.norm(along))
    near = border[tree.query_ball_point(start + 0.5 * along, 0.5 * length)]
    distances = (points[near] - start) @ along / length
    off = np.linalg.norm(points[near] - start - distances[:, None] * along / length, axis=1)
    on = (off <= tolerance) & (distances > tolerance) & (distances < length - tolerance)
    on &= (near != i) & (near != j)
    return int(near[on][distances[on].argmin()]) if on.any() else -1


def _with_consistent_orientation(triangles: np.ndarray) -> np.ndarray:
    """Gives all triangles of each connected component the orientation of most of them."""
    halves, _, place, counts = half_edges(triangles)
    order = np.argsort(place, kind="stable")
    pairs = order[np.repeat(counts == 2, counts)].reshape(-1, 2)
    same = (halves[pairs[:, 0]] == halves[pairs[:, 1]]).all(axis=1)
    if not same.any():
        return triangles
    count = len(triangles)
    links = coo_array(
        (np.where(same, 2.0, 1.0), ((pairs[:, 0] // 3), (pairs[:, 1] // 3))), shape=(count, count)
    ).tocsr()
    links = links.maximum(links.T).tocsr()
    component_count, components = connected_components(links, directed=False)
    turned = np.zeros(count, dtype=bool)
    for component in range(component_count):
        members = np.flatnonzero(components == component)
        order, before = breadth_first_order(links, members[0], directed=False)
        for t in order[1:]:
            turned[t] = turned[before[t]] ^ (links[t, before[t]] == 2.0)
        if 2 * turned[members].sum() > len(members):
            turned[members] = ~turned[members]
    return np.where(turned[:, None], triangles[:, ::-1], triangles)


def _outward(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, bool]:
    """Reverses all triangles if they enclose a negative volume; also returns whether they did."""
    corners = points[triangles] - points[np.unique(triangles)].mean(axis=0)
    if np.linalg.det(corners).sum() >= 0.0:
        return triangles, False
    return triangles[:, ::-1], True


SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtu", ".msh")
# Distance, relative to the size of the surface, below which points are merged: STL files repeat
# the corners of every triangle, and CAD programs round the corners of two faces differently.
_COINCIDENT = 1.0e-5


def read_surface(
    path: Path, *, scale: float = 1.0,
    rotation: Sequence[float] = (0.0, 0.0, 0.0), translation: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Reads triangles and places them: x = translation + Rz Ry Rx (scale · x_file).

    Args:
        path: File of triangles: .stl, .obj, .ply, .vtk, .vtu or .msh.
        scale: Metres in one unit of the file.
        rotation: Angles about the fixed x, then y, then z axis [rad], shape (3,).
        translation: Shift after scale and rotation [m], shape (3,).

    Returns:
        Points [m], shape (point_count, 3), and triangles, shape (triangle_count, 3).

    Raises:
        MeshError: The file cannot be read, or contains no triangles.
    """
    path = Path(path)
    check_file(path, SUFFIXES, "surface")
    check_size(path)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            content = read_vtu(str(path)) if path.suffix.lower() == ".vtu" else meshio.read(path)
        except (Exception, SystemExit) as error:  # a damaged file may raise any exception
            detail = " ".join(str(error).split()) or "no reason given"
            raise MeshError(path, f"cannot be read ({type(error).__name__}: {detail})") from None
    triangles = [block.data for block in content.cells if block.type == "triangle"]
    if sum(map(len, triangles)) == 0:
        raise MeshError(path, "has no triangles")
    points = np.asarray(content.points, float)
    check_positions(path, points, scale, "point")
    placed = Rotation.from_euler("xyz", rotation).apply(scale * points) + translation
    return _merged(placed, np.concatenate(triangles).astype(np.int64))


def _merged(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merges coincident points, and drops unused ones."""
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    triangles = first_of_duplicates(points, _COINCIDENT * size)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    used, index = np.unique(triangles, return_inverse=True)
    return points[used], index.reshape(-1, 3)


def read_solid_surface(path: Path, *, notes: list[str], **placement) -> SolidSurface:
    """Reads a closed surface and repairs it.

    Args:
        path: File of triangles.
        notes: List to which a note on each repair is appended.
        **placement: See `read_surface`.

    Returns:
        The surface, with outward triangles.

    Raises:
        MeshError: The file cannot be read, or its surface is open, intersects itself or encloses
            no volume.
    """
    path = Path(path)
    points, triangles = read_surface(path, **placement)
    repaired = repair_surface(points, triangles)
    used, index = np.unique(repaired.triangles, return_inverse=True)
    points, triangles = points[used], np.ascontiguousarray(index.reshape(-1, 3))
    try:
        surface_mass_properties(points, triangles)
    except MeshError as error:
        raise MeshError(path, error.reason) from None
    for note in repaired.notes:
        line = f"{path.name}: {note}."
        if line not in notes:
            notes.append(line)
    return SolidSurface(flatten_regions(points, triangles), triangles)
