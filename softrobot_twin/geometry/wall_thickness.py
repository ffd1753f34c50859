"""How thick a body is, and how many elements lie across its thinnest part."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import CellMesh
from softrobot_twin.geometry.point_location import locate_points

# Rays that a thickness is measured by, at most.
_MOST_RAYS = 400
# Rays that are compared with all triangles at once.
_PORTION = 40
# Share of the rays that may be shorter than the thickness: a wedge is as thin as one likes at its
# edge.
_WEDGES = 0.02
# Least cosine between a ray and the normal of the face where it leaves.
_FACING = 0.5
# Rays up to this many times as long as the thickness count as the thinnest part.
_NEARLY = 1.25
# How far inside the face where a ray begins its element is looked for, as a share of the ray.
_INSIDE = 0.02


class ThinnestPart(NamedTuple):
    """The thinnest part of a body.

    Attributes:
        thickness: Between two faces that look away from each other [m].
        place: Middle of it [m], shape (3,).
        elements: Number of elements across it: the thickness by the extent of an element there, in
            the direction across, the median over places that are nearly as thin.
    """

    thickness: float
    place: np.ndarray
    elements: float


def thinnest_part(mesh: CellMesh) -> ThinnestPart:
    """Measures the thickness of a body by rays from its surface, along its normals into it.

    Args:
        mesh: Its mesh, of any cells; what elements have inside of their edges is left out.

    Returns:
        Its thinnest part; corners are left out.
    """
    mesh = mesh.corner_mesh
    positions, triangles = mesh.node_positions, mesh.surface_triangles
    corners = positions[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    chosen = np.unique(np.linspace(0, len(triangles) - 1, _MOST_RAYS).astype(np.int64))
    starts = corners[chosen].mean(axis=1)
    lengths = np.concatenate([
        _depths(starts[first : first + _PORTION], normals[chosen[first : first + _PORTION]],
                corners, normals) for first in range(0, len(chosen), _PORTION)
    ])  # fmt: skip
    known = np.flatnonzero(np.isfinite(lengths))
    if not len(known):
        size = float(np.ptp(positions[triangles.ravel()], axis=0).min())
        return ThinnestPart(size, positions.mean(axis=0), float("nan"))
    ranked = known[np.argsort(lengths[known], kind="stable")]
    first = int(_WEDGES * len(ranked))
    ray = ranked[first]
    thin = ranked[first:][lengths[ranked[first:]] <= _NEARLY * lengths[ray]]
    across = normals[chosen[thin]]
    inside = starts[thin] - _INSIDE * lengths[thin, None] * across
    cells = mesh.cells[locate_points(mesh, inside).cells]
    extents = np.ptp(np.einsum("rni,ri->rn", positions[cells], across), axis=1)
    place = starts[ray] - 0.5 * lengths[ray] * normals[chosen[ray]]
    return ThinnestPart(float(lengths[ray]), place, float(np.median(lengths[thin] / extents)))


def _depths(starts: np.ndarray, outward: np.ndarray, corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Length of each ray into the body until it leaves through a face that looks away; infinite
    where it leaves through a face beside it."""
    # About the middle of the body: the products below are differences.
    middle = corners[:, 0].mean(axis=0)
    starts, first = starts - middle, corners[:, 0] - middle
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    along = -outward
    # The triple products of Möller and Trumbore for all pairs, as products of matrices.
    face, moment = np.cross(one, other), np.cross(starts, along)
    slope = -along @ face.T
    safe = np.where(np.abs(slope) > 1e-30, slope, np.inf)
    u = (moment @ other.T - along @ np.cross(other, first).T) / safe
    v = (-moment @ one.T - along @ np.cross(first, one).T) / safe
    depth = (starts @ face.T - (first * face).sum(axis=1)) / safe
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (depth > 1e-9 * size)
    depth = np.where(hit, depth, np.inf)
    nearest = depth.argmin(axis=1)
    facing = np.einsum("ri,ri->r", along, normals[nearest]) > _FACING
    return np.where(facing, depth[np.arange(len(depth)), nearest], np.inf)
