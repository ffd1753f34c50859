"""Shape functions: interpolation between the nodes of a cell.

A kind of cell is one object of the protocol `ShapeFunctions`. Functions are given over reference
coordinates; those of a tetrahedron are its last three barycentric coordinates L₁ L₂ L₃, with
L₀ = 1 - L₁ - L₂ - L₃. Gradients in the body follow from the positions of the nodes, for cells
with straight and with curved edges alike (`integration_points`).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from softrobot_twin.geometry.quadrature import (
    Quadrature,
    barycentric_coordinates,
    tetrahedron_rule,
)

# Edges of a tetrahedron by their corners, in the order in which VTK numbers the mid-edge nodes.
EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])


class ShapeFunctions(Protocol):
    """Shape functions of one kind of cell.

    Attributes:
        node_count: Nodes of a cell.
        quadrature: The rule that integrates the stiffness of such a cell at rest.
        gradient_degree: Degree of the gradients inside a straight-edged cell as polynomials of
            the barycentric coordinates: 0 or 1. None where they are no such polynomials; inversion
            of a cell is then detected at its quadrature points only.
    """

    node_count: int
    quadrature: Quadrature
    gradient_degree: int | None

    def values(self, points: np.ndarray) -> np.ndarray:
        """N at reference coordinates (point_count, 3), shape (point_count, node_count)."""
        ...

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂N/∂ξ there, shape (point_count, node_count, 3)."""
        ...


class LinearTetrahedron:
    """Four nodes at the corners: N_a = L_a."""

    node_count = 4
    gradient_degree = 0
    quadrature = tetrahedron_rule(1)

    def values(self, points: np.ndarray) -> np.ndarray:
        """N at reference coordinates (point_count, 3), shape (point_count, 4)."""
        return barycentric_coordinates(points)

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂N/∂ξ there, shape (point_count, 4, 3)."""
        slopes = np.vstack([np.full(3, -1.0), np.eye(3)])
        return np.broadcast_to(slopes, (len(points), 4, 3))


class QuadraticTetrahedron:
    """Ten nodes, at the corners and on the edges in the order of `EDGES`.

    N_a = L_a (2 L_a - 1) at a corner, N_ab = 4 L_a L_b on an edge. Where edges are straight at
    rest, the gradients are linear inside the cell, and the four points of the rule of degree two
    integrate their products, the stiffness at rest, exactly: it has its full rank, 24.
    """

    node_count = 10
    gradient_degree = 1
    quadrature = tetrahedron_rule(2)

    def values(self, points: np.ndarray) -> np.ndarray:
        """N at reference coordinates (point_count, 3), shape (point_count, 10)."""
        return quadratic_values(barycentric_coordinates(points))

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂N/∂ξ there, shape (point_count, 10, 3)."""
        slopes = quadratic_slopes(barycentric_coordinates(points))
        return slopes[:, :, 1:] - slopes[:, :, :1]


LINEAR_TETRAHEDRON, QUADRATIC_TETRAHEDRON = LinearTetrahedron(), QuadraticTetrahedron()


def quadratic_values(barycentric: np.ndarray) -> np.ndarray:
    """The quadratic functions at barycentric coordinates.

    Args:
        barycentric: L, shape (point_count, 4).

    Returns:
        N, shape (point_count, 10); each row sums to 1.
    """
    L = np.asarray(barycentric, dtype=float)
    return np.hstack([L * (2.0 * L - 1.0), 4.0 * L[:, EDGES[:, 0]] * L[:, EDGES[:, 1]]])


def quadratic_slopes(barycentric: np.ndarray) -> np.ndarray:
    """∂N/∂L of the quadratic functions: 4 L_a - 1 at a corner, 4 L_b and 4 L_a on an edge.

    Args:
        barycentric: L, shape (point_count, 4).

    Returns:
        Shape (point_count, 10, 4).
    """
    L = np.asarray(barycentric, dtype=float)
    slopes = np.zeros((len(L), 10, 4))
    corners, edges, (first, second) = np.arange(4), np.arange(4, 10), EDGES.T
    slopes[:, corners, corners] = 4.0 * L - 1.0
    slopes[:, edges, first] = 4.0 * L[:, second]
    slopes[:, edges, second] = 4.0 * L[:, first]
    return slopes


class IntegrationPoints(NamedTuple):
    """Gradients and weights of cells at rest.

    Attributes:
        gradients: ∇N_a at each point [1/m], shape (cell_count, point_count, node_count, 3).
        weights: Volume of each point [m³], shape (cell_count, point_count).
    """

    gradients: np.ndarray
    weights: np.ndarray


def integration_points(
    node_positions: np.ndarray,
    cells: np.ndarray,
    shape: ShapeFunctions,
    rule: Quadrature | None = None,
) -> IntegrationPoints:
    """Gradients and volumes at the quadrature points of cells.

    Args:
        node_positions: Rest positions [m], shape (node_count, 3).
        cells: Node indices, shape (cell_count, shape.node_count).
        shape: The cells' shape functions.
        rule: The quadrature; the cells' own when None.

    Returns:
        The points of each cell.
    """
    points, weights = rule or shape.quadrature
    slopes = shape.slopes(points)
    # Where gradients are constant, all points share one.
    slopes = slopes[:1] if shape.gradient_degree == 0 else slopes
    # J_ij = ∂x_i/∂ξ_j.
    jacobians = np.einsum("kai,qaj->kqij", node_positions[cells], slopes)
    gradients = slopes @ np.linalg.inv(jacobians)
    volumes = np.linalg.det(jacobians) * weights
    count = (len(cells), len(points), shape.node_count, 3)
    return IntegrationPoints(np.ascontiguousarray(np.broadcast_to(gradients, count)), volumes)
