"""Volume, centroid and inertia of the solid inside a closed triangle surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import closed_surface


class MassProperties(NamedTuple):
    """Mass properties at unit density; multiply by the density [kg/m³] for those of the body.

    Attributes:
        volume: Volume [m³].
        centroid: Centroid [m], shape (3,).
        inertia: Inertia tensor about the centroid [m⁵], shape (3, 3).
    """

    volume: float
    centroid: np.ndarray
    inertia: np.ndarray


def surface_mass_properties(points: np.ndarray, triangles: np.ndarray) -> MassProperties:
    """Integrates over the inside of a closed surface by the divergence theorem.

    Every triangle forms a tetrahedron with a common point; the signed integrals of 1, x and x xᵀ
    over these tetrahedra sum to those over the inside, for any common point.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).

    Returns:
        The mass properties at unit density.

    Raises:
        MeshError: The surface is open, two triangles have the same direction along an edge, or the
            surface encloses no positive volume because it is inside out or flat.
    """
    closed_surface(triangles, len(points))
    points = np.asarray(points, float)
    # A common point in the middle keeps the tetrahedra, and with them the round-off, small.
    middle = points[np.unique(triangles)].mean(axis=0)
    corners = points[triangles] - middle
    volumes = np.linalg.det(corners) / 6.0
    volume = float(volumes.sum())
    # A smaller volume is round-off of a flat surface.
    if volume <= 1e-12 * np.ptp(points[np.unique(triangles)], axis=0).max() ** 3:
        raise MeshError(None, f"the surface encloses {volume:g} m³; its triangles must run outwards")
    sums = corners.sum(axis=1)
    offset = volumes @ sums / (4.0 * volume)
    # ∫ x xᵀ over a tetrahedron with one corner at the origin is V/20 (Σ x_i x_iᵀ + s sᵀ).
    second = np.einsum("t,tci,tcj->ij", volumes, corners, corners)
    second = (second + np.einsum("t,ti,tj->ij", volumes, sums, sums)) / 20.0
    second -= volume * np.outer(offset, offset)
    return MassProperties(volume, middle + offset, np.trace(second) * np.eye(3) - second)
