"""Uniform refinement of tetrahedral meshes: each tetrahedron is divided into eight."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.mesh_repair import orient_tets
from softrobot_twin.geometry.quadratic_mesh import QuadraticMesh, add_mid_edge_nodes
from softrobot_twin.geometry.tet_mesh import TetMesh

# Corner tetrahedra by local nodes; nodes 4 to 9 are on the edges 01 12 02 03 13 23.
_CORNERS = np.array([[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3]])
# The rest is an octahedron: ends of each of its three diagonals, and the ring of nodes around it.
_DIAGONALS = ((4, 9, (5, 6, 7, 8)), (5, 7, (4, 6, 9, 8)), (6, 8, (4, 5, 9, 7)))


def refine(mesh: TetMesh) -> tuple[TetMesh, np.ndarray]:
    """Divides every tetrahedron into eight, along the shortest diagonal of its inner octahedron.

    Source: Bey 1995, with the shortest diagonal.

    Args:
        mesh: The mesh.

    Returns:
        The refined mesh, whose first nodes are those of the original mesh, and the end nodes of the
        edge of each other node, shape (new_node_count, 2).
    """
    quadratic = add_mid_edge_nodes(mesh)
    tets = np.concatenate([quadratic.cells[:, _CORNERS].reshape(-1, 4), _octahedra(quadratic)])
    upright, _ = orient_tets(quadratic.node_positions, tets)
    return TetMesh(quadratic.node_positions, upright), quadratic.mid_edge_ends


def _octahedra(quadratic: QuadraticMesh) -> np.ndarray:
    """Four tetrahedra around the shortest diagonal of each octahedron."""
    x, nodes = quadratic.node_positions, quadratic.cells
    lengths = np.stack([np.linalg.norm(x[nodes[:, a]] - x[nodes[:, b]], axis=1)
                        for a, b, _ in _DIAGONALS])
    shortest = np.argmin(lengths, axis=0)
    parts = []
    for number, (a, b, around) in enumerate(_DIAGONALS):
        local = np.array([[a, b, around[k], around[(k + 1) % 4]] for k in range(4)])
        parts.append(nodes[shortest == number][:, local].reshape(-1, 4))
    return np.concatenate(parts)
