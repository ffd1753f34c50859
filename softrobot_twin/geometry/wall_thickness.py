"""How thick a body is, and how many elements lie across its thinnest part."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.surface import boundary_triangles

# Rays that a thickness is measured by, at most.
_MOST_RAYS = 400
# Rays that are compared with all triangles at once.
_PORTION = 40
# Share of the rays that may be shorter than the thickness: a wedge is as thin as one likes at its
# edge.
_WEDGES = 0.02
# Least cosine between a ray and the normal of the face where it leaves.
_FACING = 0.5


class ThinnestPart(NamedTuple):
    """The thinnest part of a body.

    Attributes:
        thickness: Between two faces that look away from each other [m].
        place: Middle of it [m], shape (3,).
        elements: Number of elements across it: the thickness by the length of an edge there.
    """

    thickness: float
    place: np.ndarray
    elements: float


def thinnest_part(positions: np.ndarray, tets: np.ndarray) -> ThinnestPart:
    """Measures the thickness of a body by rays from its surface, along its normals into it.

    Args:
        positions: Nodes [m], shape (node_count, 3).
        tets: Tetrahedra, or hexahedra as tetrahedra, shape (tet_count, 4).

    Returns:
        Its thinnest part; corners are left out.
    """
    triangles = boundary_triangles(tets)
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
    ray = ranked[int(_WEDGES * len(ranked))]
    own = corners[chosen[ray]]
    edge = float(np.linalg.norm(own - np.roll(own, 1, axis=0), axis=1).mean())
    place = starts[ray] - 0.5 * lengths[ray] * normals[chosen[ray]]
    return ThinnestPart(float(lengths[ray]), place, float(lengths[ray]) / edge)


def _depths(
    starts: np.ndarray, outward: np.ndarray, corners: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Length of each ray into the body until it leaves through a face that looks away; infinite
    where it leaves through a face beside it."""
    first, one, other = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    along = -outward
    across = np.cross(along[:, None], other[None])
    slope = np.einsum("rti,ti->rt", across, one)
    safe = np.where(np.abs(slope) > 1e-30, slope, np.inf)
    away = starts[:, None] - first[None]
    u = np.einsum("rti,rti->rt", away, across) / safe
    turned = np.cross(away, one[None])
    v = np.einsum("ri,rti->rt", along, turned) / safe
    depth = np.einsum("ti,rti->rt", other, turned) / safe
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (depth > 1e-9 * size)
    depth = np.where(hit, depth, np.inf)
    nearest = depth.argmin(axis=1)
    facing = np.einsum("ri,ri->r", along, normals[nearest]) > _FACING
    return np.where(facing, depth[np.arange(len(depth)), nearest], np.inf)
