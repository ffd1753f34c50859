"""Surface of a tetrahedral mesh: the faces that belong to exactly one tetrahedron."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


# Face i is opposite to corner i; its nodes are counter-clockwise seen from outside.
_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


class BoundaryFaces(NamedTuple):
    """Triangles of the surface, and the tetrahedron of each.

    Attributes:
        triangles: Node indices, outward normals, int64, shape (triangle_count, 3).
        tets: Tetrahedron each triangle belongs to, int64, shape (triangle_count,).
    """

    triangles: np.ndarray
    tets: np.ndarray


class HalfEdges(NamedTuple):
    """Edges of triangles.

    Attributes:
        halves: Begin and end of the edges of each triangle in turn, shape (3 · triangle_count, 2).
        edges: Each edge once, the lower point first, shape (edge_count, 2).
        place: Edge of each half, shape (3 · triangle_count,).
        counts: Number of halves of each edge, shape (edge_count,).
    """

    halves: np.ndarray
    edges: np.ndarray
    place: np.ndarray
    counts: np.ndarray


def half_edges(triangles: np.ndarray) -> HalfEdges:
    """The edges of triangles, of shape (triangle_count, 3).

    Args:
        triangles: Points of each triangle, shape (triangle_count, 3).
    """
    halves = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, place, counts = np.unique(np.sort(halves, axis=1), axis=0, return_inverse=True, return_counts=True)
    return HalfEdges(halves, edges, place.ravel(), counts)


def single_rows(faces: np.ndarray) -> np.ndarray:
    """Indices of the faces whose nodes no other face has, of faces of shape (face_count, width).

    Args:
        faces: Nodes of each face, shape (face_count, width).
    """
    _, first, counts = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return np.sort(first[counts == 1])


def boundary_faces(tets: np.ndarray) -> BoundaryFaces:
    """Finds the surface of a tetrahedral mesh, and the tetrahedron of each triangle.

    Args:
        tets: Node indices, positively oriented, shape (tet_count, 4).

    Returns:
        The triangles, in the order of the tetrahedra.
    """
    tets = np.asarray(tets, dtype=np.int64)
    faces = tets[:, _FACES].reshape(-1, 3)
    single = single_rows(faces)
    return BoundaryFaces(faces[single], single // 4)


def boundary_triangles(tets: np.ndarray) -> np.ndarray:
    """Finds the surface of a tetrahedral mesh.

    Args:
        tets: Node indices, positively oriented, shape (tet_count, 4).

    Returns:
        Node indices of the triangles, normals pointing outwards, int64, shape
        (triangle_count, 3).
    """
    return boundary_faces(tets).triangles
