"""Triangles of spheres, cut ever finer."""

import numpy as np


def cut_on_sphere(points, triangles, cuts):
    """Cuts each triangle in four, a number of times, with the new points on the unit sphere."""
    for _ in range(cuts):
        halves = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
        edges, place = np.unique(halves.reshape(-1, 2), axis=0, return_inverse=True)
        (a, b, c), (ab, bc, ca) = triangles.T, len(points) + place.reshape(-1, 3).T
        middle = points[edges].mean(axis=1)
        points = np.vstack([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return points, triangles
