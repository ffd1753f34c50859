"""Correction of quadratic tetrahedra by cubic bubbles around a state, applied without a matrix.

The law is that of `laws/corotational.py` at fourteen quadrature points, linearized in each point's
own frame, ∂P = R (2µ sym(Rᵀ∇v) + λ tr(Rᵀ∇v)), which at rest is linear elasticity. It is not an
`Elements` term: bubbles have signs and are not part of the factor, and only products are needed.
The residual forces r_b on the bubbles displace them by b, and the quadratic nodes stay in
equilibrium:

    S b = r_b,    S = K_bb - K_b2 K_22⁻¹ K_2b

K_22⁻¹ is the factor of the quadratic body, with all other terms of the scene; the remaining
products are with the elements' stiffness. Conjugate gradients need some ten of them, because S is
nearly block diagonal (3×3) on any mesh.

Arguments of the kernels here:
    deformations: ∇x, shape (element_count, point_count, 3, 3).
    gradients: ∇L_c of each element [1/m], shape (element_count, 4, 3).
    lame: λ and µ of each element [Pa], shape (element_count, 2).
    rotations: Of each point, shape (element_count, point_count, 3, 3).
    slopes, out: By the four L_c at each point, shape (4 point_count, element_count, 3).
    weights: Share of volume of each point, shape (point_count,).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from softrobot_twin.geometry.cubic_bubbles import (
    FACE_LOAD_SHARE,
    FIRST_EDGE,
    FIRST_FACE,
    FUNCTION_COUNT,
    CubicMesh,
    cubic_slopes,
)
from softrobot_twin.geometry.matrix3 import (
    ZERO,
    add_outer,
    plus_identity,
    product,
    rows,
    scaled_matrix,
    set_rows,
    symmetric,
    trace,
    transform,
    transposed_product,
)
from softrobot_twin.geometry.quadrature import barycentric_coordinates, tetrahedron_rule
from softrobot_twin.geometry.shape_functions import integration_points
from softrobot_twin.geometry.vector3 import row, set_row
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit

MOST_ITERATIONS = 60
ENOUGH = 2.0e-3
"""Iterations end when three of them together added less than this share of the energy."""

# A rule of degree five integrates the stiffness at rest exactly. Weights are shares of the volume.
_RULE = tetrahedron_rule(5)
POINTS, WEIGHTS = barycentric_coordinates(_RULE.points), 6.0 * _RULE.weights
_SLOPES = cubic_slopes(POINTS)
# ∂/∂L_j at point q of all functions, row 4 q + j.
_FROM_FUNCTIONS = np.ascontiguousarray(
    _SLOPES.transpose(0, 2, 1).reshape(4 * len(POINTS), FUNCTION_COUNT)
)


@njit(**INLINED)
def gradient_at(slopes, gradients, k, q):
    """∇v at point q of element k, from its slopes by L: Σ ∂v/∂L_c ∇L_cᵀ."""
    G = ZERO
    for c in range(4):
        G = add_outer(G, row(slopes[4 * q + c], k), row(gradients[k], c))
    return G


@njit(**KERNEL)
def write_deformations(slopes, gradients, deformations):
    """∇x at every point of every element, from its slopes by L; shape (tets, points, 3, 3)."""
    for k in range(len(gradients)):
        for q in range(deformations.shape[1]):
            set_rows(deformations[k, q], gradient_at(slopes, gradients, k, q))


@njit(**KERNEL)
def write_stress_changes(slopes, gradients, rotations, weights, lame, out):
    """∂P ∇L_c at every point, weighted, in place of the slopes of a move."""
    for k in range(len(gradients)):
        lame_lambda, shear_modulus = lame[k, 0], lame[k, 1]
        for q in range(len(weights)):
            R = rows(rotations[k, q])
            H = transposed_product(R, gradient_at(slopes, gradients, k, q))
            S = scaled_matrix(symmetric(H), 2.0 * weights[q] * shear_modulus)
            P = product(R, plus_identity(S, weights[q] * (lame_lambda * trace(H))))
            for c in range(4):
                set_row(out[4 * q + c], k, transform(P, row(gradients[k], c)))


class CubicPart:
    """The bubbles of one body, and the parameters of its law.

    Args:
        mesh: The body with bubbles.
        first_node: Index of its first node among all nodes.
        lame: Lamé's constants λ and µ [Pa], shape (2,), or of each cell, shape (cell_count, 2).
        density: Mass per volume [kg/m³], of all cells or of each, shape (cell_count,).
        turns: Whether the law is corotational, of all cells or of each, shape (cell_count,).
    """

    def __init__(self, mesh: CubicMesh, first_node: int, lame, density, turns):
        corners = mesh.corner_mesh
        at_rest = integration_points(
            corners.node_positions, corners.cells, corners.shape_functions
        )
        self.gradients, volumes = at_rest.gradients[:, 0], at_rest.weights[:, 0]
        # Each element's constants carry its volume, so that weights are shares.
        self.lame = volumes[:, None] * np.asarray(lame)
        self.functions = mesh.functions + first_node
        self.signs, self.turns = mesh.signs, turns
        self.masses = density * volumes * FACE_LOAD_SHARE


class CubicCorrection:
    """The stiffness of bodies with bubbles around a state, and the forces on the bubbles."""

    def __init__(
        self, parts: list[CubicPart], free_index: np.ndarray, node_unknowns: int,
        free_axes: np.ndarray | float = 1.0,
    ):  # fmt: skip
        """Lay out the unknowns: those of the scene first, then the bubbles.

        Args:
            parts: The bodies.
            free_index: Unknown of each node and then of each bubble, -1 where it is fixed.
            node_unknowns: Number of unknowns that are not bubbles.
            free_axes: As `Nodes.free_axes`, of the bubbles, shape (bubble_count, 3); 1.0 for all axes.
        """
        functions = np.concatenate([part.functions for part in parts])
        signs = np.concatenate([part.signs for part in parts])
        self._gradients = np.concatenate([part.gradients for part in parts])
        self._lame = np.concatenate([part.lame for part in parts])
        self._turns = np.concatenate([np.full(len(part.signs), part.turns) for part in parts])
        self._count, self.node_unknowns, self._free_axes = int(free_index.max()) + 1, node_unknowns, free_axes
        self.bubble_count = self._count - node_unknowns
        self._functions, self._signs = functions, signs
        self._unknowns = free_index[functions]
        tets, local = np.nonzero(self._unknowns >= 0)
        # Row a T + k is function a of element k.
        shape = (FUNCTION_COUNT * len(functions), self._count)
        self._gather = csr_array(
            (signs[tets, local], (local * len(functions) + tets, self._unknowns[tets, local])),
            shape=shape,
        )  # fmt: skip
        self._scatter = self._gather.T.tocsr()
        self._masses = self._bubble_masses(np.concatenate([part.masses for part in parts]))
        self._slopes = np.empty((4 * len(POINTS), len(functions), 3))
        self._stresses = np.empty_like(self._slopes)
        self._rotations = np.empty((len(functions), len(POINTS), 3, 3))
        self._preconditioner = np.empty((self.bubble_count, 3, 3))

    def _bubble_masses(self, masses: np.ndarray) -> np.ndarray:
        """Mass of each bubble [kg], shape (bubble_count,)."""
        faces = self._unknowns[:, FIRST_FACE:]
        moving = faces >= 0
        borne = np.broadcast_to(masses[:, None], faces.shape)
        return np.bincount(
            faces[moving] - self.node_unknowns, borne[moving], self.bubble_count
        )

    def linearize(self, positions: np.ndarray) -> np.ndarray:
        """Linearize at a state of the nodes.

        Args:
            positions: Positions of all nodes [m], shape (node_count, 3).

        Returns:
            -F on the bubbles [N], shape (bubble_count, 3).
        """
        placed = positions[self._functions[:, :FIRST_EDGE]]
        tet_count = len(placed)
        np.matmul(
            _FROM_FUNCTIONS[:, :FIRST_EDGE],
            np.ascontiguousarray(placed.transpose(1, 0, 2)).reshape(FIRST_EDGE, -1),
            out=self._slopes.reshape(-1, 3 * tet_count),
        )  # fmt: skip
        deformations = np.empty_like(self._rotations)
        write_deformations(self._slopes, self._gradients, deformations)
        self._rotations[:] = np.eye(3)
        self._rotations[self._turns] = _rotations_of(deformations[self._turns])
        self._find_preconditioner()
        strains = np.einsum("kqji,kqjl->kqil", self._rotations, deformations) - np.eye(3)
        strains = 0.5 * (strains + strains.transpose(0, 1, 3, 2))
        return -self._bubble_forces(strains)

    def _bubble_forces(self, strains: np.ndarray) -> np.ndarray:
        la, mu = self._lame[:, 0, None, None, None], self._lame[:, 1, None, None, None]
        trace = np.trace(strains, axis1=2, axis2=3)[:, :, None, None]
        stresses = 2.0 * mu * strains + la * trace * np.eye(3)
        stresses = WEIGHTS[:, None, None] * np.matmul(self._rotations, stresses)
        self._stresses[:] = np.einsum("kqij,kcj->qcki", stresses, self._gradients).reshape(
            self._stresses.shape
        )
        return self._scattered()[self.node_unknowns :]

    def _find_preconditioner(self) -> None:
        """Inverse of each bubble's own block of the stiffness."""
        blocks = np.zeros_like(self._preconditioner)
        identity = np.eye(3)
        for a in range(FIRST_EDGE, FUNCTION_COUNT):
            g = np.einsum("qj,kji->kqi", _SLOPES[:, a], self._gradients)
            turned = np.einsum("kqij,kqj->kqi", self._rotations, g)
            outer = np.einsum("q,kqi,kqj->kij", WEIGHTS, turned, turned)
            dot = np.trace(outer, axis1=1, axis2=2)[:, None, None]
            la, mu = self._lame[:, 0, None, None], self._lame[:, 1, None, None]
            own = (la + mu) * outer + mu * dot * identity
            moving = self._unknowns[:, a] >= 0
            np.add.at(blocks, self._unknowns[moving, a] - self.node_unknowns, own[moving])
        free = np.broadcast_to(self._free_axes, (self.bubble_count, 3))
        self._preconditioner = free[:, :, None] * np.linalg.inv(blocks) * free[:, None, :]

    def weight(self, gravity: np.ndarray) -> np.ndarray:
        """Weight on the bubbles [N] under an acceleration [m/s²], shape (bubble_count, 3).

        Args:
            gravity: The acceleration [m/s²], shape (3,).
        """
        return np.outer(self._masses, gravity) * self._free_axes

    def multiply(self, move: np.ndarray) -> np.ndarray:
        """The elements' stiffness times a move of all unknowns [m], (unknown_count, 3) [N].

        Args:
            move: Move of nodes and bubbles [m], shape (unknown_count, 3).
        """
        tet_count = len(self._gradients)
        local = (self._gather @ move).reshape(FUNCTION_COUNT, 3 * tet_count)
        np.matmul(_FROM_FUNCTIONS, local, out=self._slopes.reshape(-1, 3 * tet_count))
        write_stress_changes(
            self._slopes, self._gradients, self._rotations, WEIGHTS, self._lame, self._stresses
        )
        return self._scattered()

    def _scattered(self) -> np.ndarray:
        flat = self._stresses.reshape(len(_FROM_FUNCTIONS), -1)
        forces = self._scatter @ (_FROM_FUNCTIONS.T @ flat).reshape(-1, 3)
        forces[self.node_unknowns :] *= self._free_axes
        return forces

    def left_on_bubbles(self, forces: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Forces on bubbles that a move of the nodes does not balance.

        Args:
            forces: On the bubbles [N], shape (bubble_count, 3).
            move: Of the other unknowns [m], shape (node_unknowns, 3).
        """
        whole = np.concatenate([move, np.zeros((self.bubble_count, 3))])
        return forces - self.multiply(whole)[self.node_unknowns :]

    def solve(self, right: np.ndarray, solve_nodes: Callable) -> np.ndarray:
        """S⁻¹ r_b by conjugate gradients.

        Args:
            right: r_b [N], shape (bubble_count, 3).
            solve_nodes: K_22⁻¹: from forces to displacements of the unknowns that are not bubbles.

        Returns:
            Offsets of the bubbles [m], shape (bubble_count, 3).
        """
        nodes = self.node_unknowns
        found, left = np.zeros_like(right), right.copy()
        direction, product, gains = np.zeros_like(right), 1.0, []
        whole = np.zeros((self._count, 3))
        for _ in range(MOST_ITERATIONS):
            better = np.einsum("nij,nj->ni", self._preconditioner, left)
            last, product = product, float(np.vdot(left, better))
            if product <= 0.0:
                break
            direction = better + (product / last if gains else 0.0) * direction
            whole[:nodes], whole[nodes:] = 0.0, direction
            pulled = self.multiply(whole)
            whole[:nodes] = -solve_nodes(pulled[:nodes])
            applied = self.multiply(whole)[nodes:]
            stiffness = float(np.vdot(direction, applied))
            if stiffness <= 0.0:
                break
            step = product / stiffness
            found += step * direction
            left -= step * applied
            gains.append(step * product)
            if sum(gains[-3:]) <= ENOUGH * sum(gains) and len(gains) > 3:
                break
        return found


def _rotations_of(deformations: np.ndarray) -> np.ndarray:
    """Rotation of the polar decomposition of each matrix, shape (..., 3, 3)."""
    left, _, right = np.linalg.svd(deformations)
    turned = np.linalg.det(left) * np.linalg.det(right) < 0.0
    left[turned, :, 2] *= -1.0
    return left @ right
