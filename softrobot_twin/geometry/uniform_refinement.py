"""One tetrahedron into eight: a finer mesh of the same body, for whoever has no mesher at hand."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.quadratic_mesh import QuadraticMesh, add_mid_edge_nodes
from softrobot_twin.geometry.tet_mesh import TetMesh

# Of the ten nodes of a quadratic tetrahedron: 4 to 9 stand on the edges 01 12 02 03 13 23.
_CORNERS = np.array([[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3]])
# What is left is an octahedron; each of its three diagonals, with the ring of nodes about it.
_DIAGONALS = ((4, 9, (5, 6, 7, 8)), (5, 7, (4, 6, 9, 8)), (6, 8, (4, 5, 9, 7)))


def refine(mesh: TetMesh) -> tuple[TetMesh, np.ndarray]:
    """Cuts every tetrahedron into eight, along the shortest diagonal of its inner octahedron.

    Args:
        mesh: The mesh.

    Returns:
        The finer mesh, whose first nodes are the coarser's, and the two nodes that each of the
        others lies between, shape (new_node_count, 2).
    """
    quadratic = add_mid_edge_nodes(mesh)
    tets = np.concatenate([quadratic.cells[:, _CORNERS].reshape(-1, 4), _octahedra(quadratic)])
    return TetMesh(quadratic.node_positions, _oriented(quadratic.node_positions, tets)), (
        quadratic.mid_edge_ends)


def _octahedra(quadratic: QuadraticMesh) -> np.ndarray:
    """Four tetrahedra about a diagonal of each octahedron."""
    x, nodes = quadratic.node_positions, quadratic.cells
    lengths = np.stack([np.linalg.norm(x[nodes[:, a]] - x[nodes[:, b]], axis=1)
                        for a, b, _ in _DIAGONALS])
    shortest = np.argmin(lengths, axis=0)
    pieces = []
    for number, (a, b, around) in enumerate(_DIAGONALS):
        local = np.array([[a, b, around[k], around[(k + 1) % 4]] for k in range(4)])
        pieces.append(nodes[shortest == number][:, local].reshape(-1, 4))
    return np.concatenate(pieces)


def _oriented(positions: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """With positive volumes."""
    a, b, c = (positions[tets[:, k]] - positions[tets[:, 0]] for k in (1, 2, 3))
    negative = np.einsum("ti,ti->t", np.cross(a, b), c) < 0.0
    tets = tets.copy()
    tets[negative] = tets[negative][:, [0, 1, 3, 2]]
    return tets
