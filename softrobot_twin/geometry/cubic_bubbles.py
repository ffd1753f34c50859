"""Cubic tetrahedra as quadratic ones with additional bubble functions.

To the ten functions of a quadratic tetrahedron (`shape_functions.py`) ten cubic ones are added that
are zero at all of its nodes. With barycentric coordinates L they are

    L_a L_b (L_a - L_b) on each edge,    L_a L_b L_c on each face.

They are hierarchical: a bubble's coefficient is an offset [m] that is zero for a displacement that
quadratic elements can represent. A bubble belongs to all tetrahedra around its edge or face; that
of an edge is odd, so it has a sign in each of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.geometry.quadratic_mesh import QuadraticMesh
from softrobot_twin.geometry.shape_functions import EDGES, quadratic_slopes, quadratic_values

FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
FUNCTION_COUNT = 20
FIRST_EDGE, FIRST_FACE = 10, 16
FACE_LOAD_SHARE = 1.0 / 120.0
"""∫N dV / V of a face's bubble; that of an edge's is zero."""


@dataclass(frozen=True, eq=False)
class CubicMesh(QuadraticMesh):
    """A quadratic mesh with bubbles; its nodes are those without them.

    Attributes:
        functions: Nodes and bubbles of each tetrahedron, shape (tet_count, 20).
        signs: Sign of each function in each tetrahedron, shape (tet_count, 20).
        bubble_corners: Corners of the edge or face of each bubble, those of an edge with the
            second one twice, shape (bubble_count, 3).
    """

    functions: np.ndarray
    signs: np.ndarray
    bubble_corners: np.ndarray

    def carriers(self, tets: np.ndarray, barycentric_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and bubbles that carry points inside tetrahedra; see `TetMesh.carriers`."""
        values = cubic_values(barycentric_weights) * self.signs[tets]
        return self.functions[tets], values


def cubic_values(barycentric_coordinates: np.ndarray) -> np.ndarray:
    """The twenty functions at points L of shape (point_count, 4), shape (point_count, 20).

    Args:
        barycentric_coordinates: L of each point, shape (point_count, 4).
    """
    L = np.asarray(barycentric_coordinates, dtype=float)
    a, b = L[:, EDGES[:, 0]], L[:, EDGES[:, 1]]
    return np.hstack([quadratic_values(L), a * b * (a - b), L[:, FACES].prod(axis=2)])


def cubic_slopes(barycentric_coordinates: np.ndarray) -> np.ndarray:
    """∂N/∂L of the twenty functions, shape (point_count, 20, 4).

    Args:
        barycentric_coordinates: L of each point, shape (point_count, 4).
    """
    L = np.asarray(barycentric_coordinates, dtype=float)
    slopes = np.zeros((len(L), FUNCTION_COUNT, 4))
    slopes[:, :FIRST_EDGE] = quadratic_slopes(L)
    for edge, (a, b) in enumerate(EDGES):
        slopes[:, FIRST_EDGE + edge, a] = L[:, b] * (2.0 * L[:, a] - L[:, b])
        slopes[:, FIRST_EDGE + edge, b] = L[:, a] * (L[:, a] - 2.0 * L[:, b])
    for face, corners in enumerate(FACES):
        for corner in corners:
            others = corners[corners != corner]
            slopes[:, FIRST_FACE + face, corner] = L[:, others].prod(axis=1)
    return slopes


def add_bubbles(mesh: QuadraticMesh, first_bubble: int | None = None) -> CubicMesh:
    """Give a quadratic mesh its cubic bubbles.

    Args:
        mesh: The mesh.
        first_bubble: Number of the first bubble; that after its last node when None.

    Returns:
        It, with the bubbles of all edges and then those of all faces.
    """
    first = mesh.node_count if first_bubble is None else first_bubble
    corners = mesh.cells[:, :4]
    edges = mesh.cells[:, 4:] - mesh.corner_mesh.node_count
    ends = corners[:, EDGES]
    faces = np.sort(corners[:, FACES], axis=2).reshape(-1, 3)
    face_corners, face = np.unique(faces, axis=0, return_inverse=True)
    edge_count = len(mesh.mid_edge_ends)
    signs = np.ones((len(corners), FUNCTION_COUNT))
    signs[:, FIRST_EDGE:FIRST_FACE] = np.where(ends[:, :, 0] < ends[:, :, 1], 1.0, -1.0)
    functions = np.hstack([mesh.cells, first + edges, first + edge_count + face.reshape(-1, len(FACES))])
    edge_corners = mesh.mid_edge_ends[:, [0, 1, 1]]
    bubble_corners = np.concatenate([edge_corners, face_corners])
    return CubicMesh(
        mesh.corner_mesh, mesh.node_positions, mesh.cells, mesh.mid_edge_ends, functions, signs,
        bubble_corners,
    )  # fmt: skip
