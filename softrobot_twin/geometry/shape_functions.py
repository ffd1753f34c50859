"""Shape functions: interpolation between the nodes of a cell.

A kind of cell is one object of the protocol `ShapeFunctions`. Functions are given over reference
coordinates; those of a tetrahedron are its last three barycentric coordinates L₁ L₂ L₃, with
L₀ = 1 - L₁ - L₂ - L₃, those of a hexahedron run from -1 to 1. Gradients in the body follow from the positions of the nodes, for cells
with straight and with curved edges alike (`integration_points`).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from softrobot_twin.geometry.quadrature import (
    Quadrature,
    barycentric_coordinates,
    hexahedron_rule,
    tetrahedron_rule,
)

# Edges of a tetrahedron by their corners, in the order in which VTK numbers the mid-edge nodes.
EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])

# Corners of a hexahedron in its reference coordinates, in the order of VTK, Gmsh and Abaqus.
HEXAHEDRON_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1],
     [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float,
)  # fmt: skip


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
        """N at reference coordinates (point_count, 3), shape (point_count, node_count).

        Args:
            points: Reference coordinates ξ, shape (point_count, 3).
        """
        ...

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂N/∂ξ there, shape (point_count, node_count, 3).

        Args:
            points: Reference coordinates ξ, shape (point_count, 3).
        """
        ...


class LinearTetrahedron:
    """Four nodes at the corners: N_a = L_a."""

    node_count = 4
    gradient_degree = 0
    quadrature = tetrahedron_rule(1)

    def values(self, points: np.ndarray) -> np.ndarray:
        """N at reference coordinates (point_count, 3), shape (point_count, 4).

        Args:
            points: Reference coordinates ξ, shape (point_count, 3).
        """
        return barycentric_coordinates(points)

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂N/∂ξ there, shape (point_count, 4, 3).

        Args:
            points: Reference coordinates ξ, shape (point_count, 3).
        """
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
        """N at reference coordinates (point_count, 3), shape (point_count, 10).

        Args:
            points: Reference coordinates ξ, shape (point_count, 3).
        """
        return quadratic_values(barycentric_coordinates(points))

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂N/∂ξ there, shape (point_count, 10, 3).

        Args:
            points: Reference coordinates ξ, shape (point_count, 3).
        """
        slopes = quadratic_slopes(barycentric_coordinates(points))
        return slopes[:, :, 1:] - slopes[:, :, :1]


class TrilinearHexahedron:
    """Eight nodes at the corners c: N_a = Π_i (1 + c_i ξ_i) / 8."""

    node_count = 8
    gradient_degree = None
    quadrature = hexahedron_rule(2)

    def values(self, points: np.ndarray) -> np.ndarray:
        """N at reference coordinates (point_count, 3), shape (point_count, 8).

        Args:
            points: Reference coordinates ξ, -1 to 1, shape (point_count, 3).
        """
        return (1.0 + _signed(points)).prod(axis=2) / 8.0

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """∂N/∂ξ there, shape (point_count, 8, 3).

        Args:
            points: Reference coordinates ξ, -1 to 1, shape (point_count, 3).
        """
        factors = 1.0 + _signed(points)
        others = np.stack(
            [np.delete(factors, axis, axis=2).prod(axis=2) for axis in range(3)], axis=2
        )
        return HEXAHEDRON_CORNERS * others / 8.0


def _signed(points: np.ndarray) -> np.ndarray:
    """c_i ξ_i of each corner, shape (point_count, 8, 3)."""
    return np.asarray(points, dtype=float)[:, None, :] * HEXAHEDRON_CORNERS


class MeanHexahedron(TrilinearHexahedron):
    """Eight nodes at the corners, and one point: that of the mean of their gradients over the cell.

    The other motions of the corners are those of `HourglassFields`.
    """

    quadrature = hexahedron_rule(1)


LINEAR_TETRAHEDRON, QUADRATIC_TETRAHEDRON = LinearTetrahedron(), QuadraticTetrahedron()
TRILINEAR_HEXAHEDRON, MEAN_HEXAHEDRON = TrilinearHexahedron(), MeanHexahedron()


def modes(points: np.ndarray) -> np.ndarray:
    """Fields of enhanced strain in the reference cube.

    The first three are the gradients of 1 - ξ_i², the incompatible modes of Wilson and Taylor: with
    them a cell bends without shear. The other two are (ξη, ηζ, ζξ) and (ζξ, ξη, ηζ). With them the
    change of volume can be uniform in a cell also where its corners' displacement has products of
    two coordinates, so that nearly incompressible material does not lock. The set is invariant
    under every numbering of the corners. It does not contain ∇(ξηζ): that is in the span of
    the corners already, and would leave their pattern ξηζ without stiffness.

    Args:
        points: Reference coordinates, shape (point_count, 3).

    Returns:
        Shape (point_count, 5, 3).
    """
    points = np.asarray(points, dtype=float)
    products = points * np.roll(points, -1, axis=1)  # ξη ηζ ζξ
    bending = -2.0 * points[:, :, None] * np.eye(3)
    return np.concatenate([bending, products[:, None], np.roll(products, 1, axis=1)[:, None]], axis=1)


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
    node_positions: np.ndarray, cells: np.ndarray, shape: ShapeFunctions
) -> IntegrationPoints:
    """Gradients and volumes at the quadrature points of cells.

    Args:
        node_positions: Rest positions [m], shape (node_count, 3).
        cells: Node indices, shape (cell_count, shape.node_count).
        shape: The cells' shape functions.

    Returns:
        The points of each cell.
    """
    points, weights = shape.quadrature
    slopes = shape.slopes(points)
    # Where gradients are constant, all points share one.
    slopes = slopes[:1] if shape.gradient_degree == 0 else slopes
    # J_ij = ∂x_i/∂ξ_j.
    jacobians = np.einsum("kai,qaj->kqij", node_positions[cells], slopes)
    gradients = slopes @ np.linalg.inv(jacobians)
    volumes = np.linalg.det(jacobians) * weights
    count = (len(cells), len(points), shape.node_count, 3)
    return IntegrationPoints(np.ascontiguousarray(np.broadcast_to(gradients, count)), volumes)


class HourglassFields(NamedTuple):
    """The motions of a hexahedron's corners beside the affine ones, and the strain that they make.

    Attributes:
        gammas: γ_i of the corners, orthogonal to every affine field, shape (cell_count, 4, 8).
        gradients: ∇N_a of the corners less their means, then the fields of enhanced strain, at the points
            of the rule of the trilinear hexahedron [1/m], shape (cell_count, 8, 8 + 5, 3).
        weights: Volume of each point [m³], shape (cell_count, 8).
    """

    gammas: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray


def hourglass_fields(corners: np.ndarray, means: np.ndarray | None = None) -> HourglassFields:
    """The fields of hexahedra.

    Those of enhanced strain are g_k = |J₀| / |J| J₀⁻ᵀ m_k with the `modes` m_k and J₀ = ∂x/∂ξ in the
    middle. Their means over the cell are zero, as those of all fields here: so a uniform strain makes
    none of them (Taylor, Beresford and Wilson 1976; Simo and Rifai 1990).

    Args:
        corners: Rest positions of the corners [m], shape (cell_count, 8, 3).
        means: Mean ∇N_a that the affine motions are measured by [1/m], shape (cell_count, 8, 3); those
            of the trilinear functions when None.
    """
    points, weights = TRILINEAR_HEXAHEDRON.quadrature
    jacobians = np.einsum("kai,qaj->kqij", corners, TRILINEAR_HEXAHEDRON.slopes(points))
    middle = np.einsum("kai,aj->kij", corners, TRILINEAR_HEXAHEDRON.slopes(np.zeros((1, 3)))[0])
    determinants = np.linalg.det(jacobians)
    volumes = determinants * weights
    own = TRILINEAR_HEXAHEDRON.slopes(points) @ np.linalg.inv(jacobians)
    of_mean = np.einsum("kq,kqai->kai", volumes, own) / volumes.sum(axis=1)[:, None, None]
    means = of_mean if means is None else means
    share = np.linalg.det(middle)[:, None] / determinants
    inner = share[:, :, None, None] * (modes(points) @ np.linalg.inv(middle)[:, None])
    gradients = np.concatenate([own - of_mean[:, None], inner], axis=2)
    # ηζ, ζξ, ξη and ξηζ at the corners.
    c = HEXAHEDRON_CORNERS
    patterns = np.stack([c[:, 1] * c[:, 2], c[:, 2] * c[:, 0], c[:, 0] * c[:, 1], c.prod(axis=1)]) / 8.0
    gammas = patterns - np.einsum("ic,kcj,kaj->kia", patterns, corners, means)
    return HourglassFields(gammas, gradients, volumes)
