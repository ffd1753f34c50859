"""Reading and repair of triangle surfaces: obstacles, rigid bodies and appearances of bodies."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import meshio
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.box_tree import box_tree, nearest_distances
from softrobot_twin.geometry.closed_surface import flatten_regions
from softrobot_twin.geometry.ear_clipping import clip_ears
from softrobot_twin.geometry.mass_properties import MassProperties, surface_mass_properties
from softrobot_twin.geometry.mesh_file_checks import (
    check_file,
    check_positions,
    check_size,
    damage_told,
)
from softrobot_twin.geometry.mesh_parts import read_gmsh
from softrobot_twin.geometry.mesh_repair import first_of_duplicates
from softrobot_twin.geometry.solid_shells import (
    connected_shells,
    is_inside,
    nested,
    outward_shells,
    refuse_open,
)
from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.geometry.vtk_reading import read_legacy_vtk, read_vtk_xml


@dataclass(frozen=True, eq=False)
class SolidSurface:
    """A closed surface in the frame of its carrier, an obstacle or a rigid body.

    Attributes:
        points: Its points [m], shape (point_count, 3).
        triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).
        curvature_radius: Infinite: its facets are flat.
    """

    points: np.ndarray
    triangles: np.ndarray
    curvature_radius: ClassVar[float] = np.inf

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
        points, corners = np.asarray(points, float), self.points[self.triangles]
        found = nearest_distances(box_tree(corners), corners, points)
        found[[is_inside(point, corners) for point in points]] = 0.0
        return found


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
    unfolded = _unfolded(points, consistent)
    if unfolded is not consistent:
        notes.append("split polygons with inward corners anew: their triangles lay on each other")
        triangles = consistent = unfolded
    count = int((consistent != triangles).any(axis=1).sum())
    outward, was_inward = _outward(points, consistent)
    if was_inward and not (outward != triangles).any():
        # The two corrections cancel: the file was right.
        return RepairedSurface(outward, notes)
    if count and not was_inward:
        notes.append(f"reversed {count} triangles whose orientation was opposite to that of their neighbours")
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


def _cut_at_junctions(points, triangles, tolerance: float) -> np.ndarray:
    """Cuts triangles at points on their open edges; one point per edge in each round."""
    for _ in range(_MOST_ROUNDS):
        halves, _, place, counts = half_edges(triangles)
        is_open = counts[place] == 1
        if not is_open.any():
            break
        border = np.unique(halves[is_open])
        tree = cKDTree(points[border])
        cut, whole = [], np.ones(len(triangles), dtype=bool)
        for t, corner in zip(*np.divmod(np.flatnonzero(is_open), 3), strict=True):
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


# Neighbours whose normals differ by less lie in a plane: 1 - cosine of a quarter of a degree.
_COPLANAR = 1.0e-5


def _unfolded(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Splits flat polygons anew whose triangles lie on each other, as a fan of a polygon with
    inward corners does."""
    for _ in range(_MOST_ROUNDS):
        corners = points[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        _, edges, place, counts = half_edges(triangles)
        order = np.argsort(place, kind="stable")
        halves = order[np.repeat(counts == 2, counts)].reshape(-1, 2)
        one, other = (halves // 3).T
        folds = np.einsum("ni,ni->n", normals[one], normals[other]) < -1.0 + _COPLANAR
        gone, made = np.zeros(len(triangles), dtype=bool), []
        for triangle, ends in zip(one[folds], edges[place[halves[folds, 0]]], strict=True):
            fans = []
            for apex in ends:
                around = np.flatnonzero((triangles == apex).any(axis=1))
                flat = np.abs(normals[around] @ normals[triangle]) > 1.0 - _COPLANAR
                fans.append(_connected_fan(triangles, around[flat], triangle, apex))
            for fan in sorted(fans, key=len, reverse=True):
                split = None if gone[fan].any() else _split_anew(points, triangles[fan])
                if split is not None:
                    gone[fan] = True
                    made.append(split)
                    break
        if not made:
            return triangles
        triangles = np.vstack([triangles[~gone], *made])
    return triangles


def _connected_fan(triangles: np.ndarray, around: np.ndarray, first: int, apex: int) -> np.ndarray:
    """Triangles at an apex that are connected to the first one by edges from the apex."""
    fan, reached = {int(first)}, set(triangles[first].tolist()) - {int(apex)}
    while True:
        more = {int(one) for one in around if reached & set(triangles[one].tolist())} - fan
        if not more:
            return np.array(sorted(fan))
        fan |= more
        reached |= set(triangles[list(more)].ravel().tolist()) - {int(apex)}


def _split_anew(points: np.ndarray, fan: np.ndarray) -> np.ndarray | None:
    """Triangles of the polygon around a fan; None where it is not a simple one."""
    loops = boundary_loops(fan)
    if len(loops) != 1 or len(loops[0]) != len(np.unique(fan)) or len(loops[0]) != len(fan) + 2:
        return None
    loop = np.array(loops[0])
    ears = clip_ears(points[loop])
    return None if ears is None else loop[ears]


def boundary_loops(triangles: np.ndarray) -> list[list[int]]:
    """The closed paths along the edges that belong to one triangle only, in its direction.

    Args:
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        Points of each loop in order.
    """
    halves, _, place, counts = half_edges(triangles)
    after: dict[int, list[int]] = {}
    for start, end in halves[counts[place] == 1].tolist():
        after.setdefault(start, []).append(end)
    loops = []
    while after:
        loop = [next(iter(after))]
        while loop[-1] in after:
            ends = after[loop[-1]]
            loop.append(ends.pop())
            if not ends:
                del after[loop[-2]]
            if loop[-1] in loop[:-1]:
                # A path that meets itself is a loop from there on.
                start = loop.index(loop[-1])
                loops.append(loop[start:-1])
                del loop[start + 1 :]
        # What is left of a path is open: triangles there have no common direction.
    return loops


def _outward(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, bool]:
    """Reverses all triangles if they enclose a negative volume; also returns whether they did."""
    corners = points[triangles] - points[np.unique(triangles)].mean(axis=0)
    if np.linalg.det(corners).sum() >= 0.0:
        return triangles, False
    return triangles[:, ::-1], True


SUFFIXES = (".stl", ".obj", ".ply", ".off", ".vtk", ".vtu", ".vtp", ".msh")
# Distance, relative to the size of the surface, below which points are merged: STL files repeat
# the corners of every triangle, and CAD programs round the corners of two faces differently.
_COINCIDENT = 1.0e-5
# Flat cells, and how many of their first nodes are corners; polygons have corners only.
_CORNERS_OF = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4, "polygon": None}
# A larger share of a file that is left out is told.
_SMALL_SHARE = 0.01


def read_surface(
    path: Path, *, scale: float = 1.0, rotation: Sequence[float] = (0.0, 0.0, 0.0),
    translation: Sequence[float] = (0.0, 0.0, 0.0), notes: list[str] | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Reads triangles and places them: x = translation + Rz Ry Rx (scale · x_file).

    Quadrilaterals and polygons are split. trimesh reads .stl, .obj, .ply and .off.

    Args:
        path: File of triangles, of one of the `SUFFIXES`.
        scale: Metres in one unit of the file.
        rotation: Angles about the fixed x, then y, then z axis [rad], shape (3,).
        translation: Shift after scale and rotation [m], shape (3,).
        notes: List to which a note on what was left out is appended.

    Returns:
        Points [m], shape (point_count, 3), and triangles, shape (triangle_count, 3).

    Raises:
        MeshError: The file cannot be read, or contains no triangles.
    """
    path = Path(path)
    check_file(path, SUFFIXES, "surface")
    check_size(path)
    with damage_told(path, "cannot be read"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numpy, on text that is no number
        read = _READERS.get(path.suffix.lower())
        points, blocks = _by_trimesh(path) if read is None else _flat_cells(read(str(path)))
    fans = [np.asarray(block, np.int64)[:, [0, corner, corner + 1]] for block in blocks
            for corner in range(1, block.shape[1] - 1)]  # fmt: skip
    if sum(map(len, fans)) == 0:
        raise MeshError(path, "has no triangles")
    triangles = np.concatenate(fans)
    points = np.asarray(points, float)
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise MeshError(path, f"has triangles of point {triangles.max()}, but only {len(points)} "
                        "points")  # fmt: skip
    check_positions(path, points, scale, "point")
    placed = Rotation.from_euler("xyz", rotation).apply(scale * points) + translation
    merged = _merged(placed, triangles)
    lost = 1.0 - len(merged[1]) / len(triangles)
    if notes is not None and lost > _SMALL_SHARE:
        notes.append(
            f"{path.name}: left out {len(triangles) - len(merged[1])} of {len(triangles)} triangles "
            f"({100.0 * lost:.0f} %) whose corners are nearer than "
            f"{1e3 * _COINCIDENT * np.linalg.norm(np.ptp(placed, axis=0)):.2g} mm: one point there."
        )
    return merged


def _by_trimesh(path: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    """Points and triangles of a file that trimesh reads, in the form in which it does."""
    import trimesh

    raw, suffix = path.read_bytes(), path.suffix.lower()
    if suffix == ".stl":
        # No text is so long that its bytes at the place of the number of triangles fit.
        end = 84 + 50 * int.from_bytes(raw[80:84], "little")
        is_binary = len(raw) >= 84 and end <= len(raw)
        if is_binary:
            raw = raw[:end]  # programs append their own data
        elif not re.match(rb"(\xef\xbb\xbf)?\s*solid\b", raw, re.I) or (
            b"endsolid" not in raw[-1000:].lower()):  # fmt: skip
            needed = f"{(end - 84) // 50} triangles need {end} bytes, " if len(raw) >= 84 else ""
            if raw.lstrip()[:5].lower() == b"solid":
                needed = "it has no endsolid, and "
            reason = f"is no STL file, or only a part of one: {needed}it has {len(raw)} bytes"
            raise MeshError(path, reason)
    else:
        is_binary = suffix == ".ply" and b"format ascii" not in raw[:1000]
    if not is_binary:
        text = raw.removeprefix(b"\xef\xbb\xbf").decode("latin-1")
        text = text.replace("\r\n", "\n").replace("\r", "\n")
        # Names, and with them words of another alphabet or of the format.
        text = re.sub(r"(?im)^(\s*(?:end)?solid)\b.*$", r"\1", text) if suffix == ".stl" else text
        if suffix == ".off" and not re.match(r"\s*(#.*\s+)*C?OFF\b", text):
            raise ValueError("it does not begin with OFF")
        raw = text.encode("ascii", "replace")
    found = trimesh.load_mesh(io.BytesIO(raw), file_type=suffix[1:], process=False)
    return found.vertices, [np.asarray(found.faces)]


def _flat_cells(content: meshio.Mesh) -> tuple[np.ndarray, list[np.ndarray]]:
    """Points and corners of the flat cells of a mesh."""
    return content.points, [block.data[:, : _CORNERS_OF[block.type]] for block in content.cells
                            if block.type in _CORNERS_OF and len(block.data)]  # fmt: skip


_READERS = {".vtk": read_legacy_vtk, ".vtu": read_vtk_xml, ".vtp": read_vtk_xml, ".msh": read_gmsh}


def _merged(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merges coincident points, and drops unused ones."""
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    triangles = first_of_duplicates(points, _COINCIDENT * size)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    used, index = np.unique(triangles, return_inverse=True)
    return points[used], index.reshape(-1, 3)


REPAIR = "`softrobot_twin mesh {} --repair{}` closes holes and unites solids that overlap or touch"
"""What can be done about a surface, given the name of its file and further options."""


def read_solid_surface(
    path: Path, *, notes: list[str], hull: bool | None = None, **placement
) -> SolidSurface:
    """Reads a closed surface and repairs it.

    Args:
        path: File of triangles.
        notes: List to which a note on each repair is appended.
        hull: Whether the convex hull of the file is taken. None where there is no such choice: then
            several solids are not refused.
        **placement: See `read_surface`.

    Returns:
        The surface, with outward triangles.

    Raises:
        MeshError: The file cannot be read, or its surface is open, consists of several solids or
            encloses no volume.
    """
    path = Path(path)
    told: list[str] = []
    points, triangles = read_surface(path, notes=told, **placement)
    if hull:
        return _convex_hull(path, points)
    repaired = repair_surface(points, triangles)
    told += [f"{path.name}: {note}." for note in repaired.notes]
    used, index = np.unique(repaired.triangles, return_inverse=True)
    points, triangles = points[used], np.ascontiguousarray(index.reshape(-1, 3))
    remedy = REPAIR.format(path.name, f" --output {path.stem}_repaired.stl")
    if hull is not None:
        remedy += "; or `hull: true` takes its convex hull"
    refuse_open(path, points, triangles, remedy)
    shells = connected_shells(triangles)
    if hull is not None and shells.any():
        outward = outward_shells(points, triangles, shells)
        count = len(nested(points, outward, shells))
        if count > 1:
            raise MeshError(path, f"consists of {count} separate solids; {remedy}; what is apart "
                            "needs an entry and a file for each solid")  # fmt: skip
    try:
        surface_mass_properties(points, triangles)
    except MeshError as error:
        raise MeshError(path, error.reason) from None
    notes.extend(line for line in told if line not in notes)
    return SolidSurface(flatten_regions(points, triangles), triangles)


def _convex_hull(path: Path, points: np.ndarray) -> SolidSurface:
    """The convex hull of points, for things to grasp."""
    try:
        found = ConvexHull(points)
    except QhullError:
        raise MeshError(path, "has no convex hull: all its points lie in a plane") from None
    corners = points[found.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ti,ti->t", normals, found.equations[:, :3]) < 0.0
    triangles = np.where(inward[:, None], found.simplices[:, ::-1], found.simplices)
    used, index = np.unique(triangles, return_inverse=True)
    triangles = np.ascontiguousarray(index.reshape(-1, 3), dtype=np.int64)
    return SolidSurface(flatten_regions(points[used], triangles), triangles)
