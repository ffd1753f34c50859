"""The surface of a beam: its cross-section swept along its axis, with flat ends.

Beams are shown by it, and touch with it what has no simpler shape.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.simulation.building.beam_bodies import BeamBody

# At a corner of the axis the outline is moved to the plane between both sides, along the axis by
# no more than this many radii.
MOST_MITRE = 3.0


def swept_surface(
    beam: BeamBody, pieces: int = 1
) -> tuple[BarycentricMapping, np.ndarray]:
    """Sweep the outline of a beam's section along it.

    Args:
        beam: The beam.
        pieces: Pieces that each element is divided into.

    Returns:
        Points of a closed surface on the frames of the beam's nodes, an outline at each end of a
        piece and a point in the middle of both ends; and triangles, indices of points, outward,
        shape (triangle_count, 3).
    """
    elements = np.repeat(np.arange(len(beam.lengths)), pieces)
    shares = np.tile(np.arange(pieces) / pieces, len(beam.lengths))
    elements, shares = np.append(elements, elements[-1]), np.append(shares, 1.0)
    count, size = len(elements), len(beam.section.outline)
    centres = beam.axis_at(elements, shares)
    rings = centres[:, None, :] + _outlines(beam, elements, shares)
    points = np.concatenate([rings.reshape(-1, 3), centres[[0, -1]]])
    station = np.concatenate([np.repeat(np.arange(count), size), [0, count - 1]])
    mapping = beam.carried_by(elements[station], shares[station], points)
    return mapping, _tube(count, size)


def _outlines(beam: BeamBody, elements: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """The outline at each station, from the axis [m], shape (count, point_count, 3)."""
    weights = np.column_stack([1.0 - shares, shares])
    axes = np.einsum("ne,neij->nij", weights, beam.element_axes[elements])
    tangents = axes[:, :, 0] / np.linalg.norm(axes[:, :, 0], axis=1, keepdims=True)
    y = axes[:, :, 1] - np.sum(axes[:, :, 1] * tangents, axis=1)[:, None] * tangents
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    across = np.stack([y, np.cross(tangents, y)], axis=1)
    outlines = np.einsum("pk,nki->npi", beam.section.outline, across)
    corners = np.flatnonzero((shares == 0.0) & (elements > 0))
    before = beam.element_axes[elements[corners] - 1, 1, :, 0]
    own = tangents[corners]
    between = before + own
    # Zero where the axis turns back; there the outline stays as it is.
    along = np.sum(between * own, axis=1)
    off = -np.einsum("npi,ni->np", outlines[corners], between)
    off /= np.where(along > 1.0e-9, along, np.inf)[:, None]
    most = MOST_MITRE * beam.section.radius
    outlines[corners] += np.clip(off, -most, most)[:, :, None] * own[:, None, :]
    return outlines


def _tube(ring_count: int, size: int) -> np.ndarray:
    """Triangles between rings of points, and of both ends, whose middles come last."""
    ring = size * np.arange(ring_count - 1)[:, None]
    here, there = np.arange(size), np.roll(np.arange(size), -1)
    lower = np.stack([ring + here, ring + there, ring + size + there], axis=2)
    upper = np.stack([ring + here, ring + size + there, ring + size + here], axis=2)
    last, middle = size * (ring_count - 1), size * ring_count
    start = np.column_stack([np.full(size, middle), there, here])
    end = np.column_stack([np.full(size, middle + 1), last + here, last + there])
    return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3), start, end])
