"""Slabs from STL files, cut into triangles in many ways, and bodies to put on them."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
from scipy.spatial import Delaunay

LENGTH, WIDTH, THICKNESS = 2.0, 1.0, 0.1


def cut(kind: str, seed: int = 0) -> np.ndarray:
    """Points of a floor's top, x in [0, 2], y in [0, 1]: `coarse`, `fine`, `irregular`, `sliver`."""
    random = np.random.default_rng(seed)
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    if kind == "coarse":
        return corners
    if kind == "fine":
        x, y = np.meshgrid(np.linspace(0, 2, 41), np.linspace(0, 1, 21), indexing="ij")
        return np.column_stack([x.ravel(), y.ravel()])
    if kind == "irregular":
        inner = random.uniform([0.02, 0.02], [1.98, 0.98], (300, 2))
        return np.vstack([corners, inner])
    # Points nearly on lines, 1e-5 of the length apart across them.
    along = random.uniform(0.05, 1.95, 120)
    lines = random.choice([0.4, 0.497, 0.503, 0.6], 120)
    across = lines + random.uniform(-2e-5, 2e-5, 120)
    return np.vstack([corners, np.column_stack([along, across])])


def write_slab(path: Path, kind: str, seed: int = 0, scale: float = 1.0) -> str:
    """Write a slab of 2 x 1 x 0.1 times a scale [m], its top through the origin, as binary STL."""
    plane = cut(kind, seed)
    cells = Delaunay(plane, qhull_options="QJ Pp" if kind == "fine" else "Qbb Qc Qz Pp").simplices
    a, b, c = (plane[cells[:, i]] for i in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    cells = np.where(area[:, None] > 0.0, cells, cells[:, ::-1])[np.abs(area) > 1e-14]
    halves = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
    known = {tuple(edge) for edge in halves}
    border = np.array([edge for edge in halves if (edge[1], edge[0]) not in known])
    count = len(plane)
    top = np.column_stack([plane - [0.2, 0.5], np.zeros(count)])
    points = np.vstack([top, top - [0.0, 0.0, THICKNESS]]) * scale
    i, j = border.T
    triangles = np.vstack([
        cells, cells[:, ::-1] + count,
        np.column_stack([j, i, i + count]), np.column_stack([j, i + count, j + count]),
    ])  # fmt: skip
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), binary=True)
    return str(path)
