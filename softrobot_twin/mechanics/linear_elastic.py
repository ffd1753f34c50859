"""The linear law: small strain and no rotation, so that the stiffness never changes.

    σ = λ tr(ε) 1 + 2µ ε,    ε = sym ∇u,    K_ab = Σ_q V_q (λ g_a g_bᵀ + µ g_b g_aᵀ + µ (g_a·g_b) 1)

with the shape functions' gradients g at the quadrature points of the element at rest. It costs
next to nothing, and it is wrong where a body turns: what turns by θ seems to shrink by 1 - cos θ.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.quadrature import quadrature
from softrobot_twin.mechanics.stencil import bind_stencils, lower_pairs


@njit(cache=True, nogil=True, error_model="numpy")
def add_stresses(x, rest, tets, free, gradients, weights, la, mu, forces):
    """Subtract V σ g_a from the forces; gives the number of elements inside out at a point."""
    inverted_count = 0
    gradient_u, stress = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(tets)):
        inverted = False
        for q in range(gradients.shape[1]):
            gradient_u[:] = 0.0
            for a in range(tets.shape[1]):
                n = tets[k, a]
                for i in range(3):
                    for j in range(3):
                        gradient_u[i, j] += (x[n, i] - rest[n, i]) * gradients[k, q, a, j]
            trace = gradient_u[0, 0] + gradient_u[1, 1] + gradient_u[2, 2]
            for i in range(3):
                for j in range(3):
                    stress[i, j] = weights[k] * mu * (gradient_u[i, j] + gradient_u[j, i])
                stress[i, i] += weights[k] * la * trace
            inverted = inverted or not stretch_determinant(gradient_u) > 0.0
            for a in range(tets.shape[1]):
                n = free[k, a]
                if n >= 0:
                    for i in range(3):
                        for j in range(3):
                            forces[n, i] -= stress[i, j] * gradients[k, q, a, j]
        inverted_count += inverted
    return inverted_count


@njit(cache=True, nogil=True, error_model="numpy")
def stretch_determinant(gradient_u):
    """det(1 + ∇u)."""
    a, b, c = 1.0 + gradient_u[0, 0], gradient_u[0, 1], gradient_u[0, 2]
    d, e, f = gradient_u[1, 0], 1.0 + gradient_u[1, 1], gradient_u[1, 2]
    g, h, i = gradient_u[2, 0], gradient_u[2, 1], 1.0 + gradient_u[2, 2]
    return a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)


class LinearElastic(ForceTerm):
    """Force term of a linear elastic body, of linear or quadratic tetrahedra."""

    name = "linear elasticity"

    def __init__(self, mesh, free_index: np.ndarray, material: LameParameters):
        """Prepare the elements.

        Args:
            mesh: The body at rest, a `TetMesh` or a `QuadraticMesh`.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
        """
        self.material = material
        self._mesh = mesh
        self._free = free_index[mesh.tets]
        self._gradients, self._weights = quadrature(mesh)
        self._stiffness = np.empty(0)

    def stencils(self) -> np.ndarray:
        """Free nodes that each element couples, -1 where fixed, shape (tet_count, 4 or 10)."""
        return self._free

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Sum the stiffness once, laid out as the factorization stores it."""
        bound = bind_stencils(self._free, elimination_rank, slots)
        g = np.take_along_axis(self._gradients, bound.order[:, None, :, None], axis=2)
        present = bound.offsets >= 0
        last = (bound.offsets + 2 * bound.strides + 2)[present].max(initial=-1)
        self._stiffness = np.zeros(last + 1)
        la, mu = self.material
        identity = np.eye(3)
        # Pair by pair: the matrices of all elements at once would not fit in memory.
        for pair, (a, b) in enumerate(zip(*lower_pairs(self._free.shape[1]), strict=True)):
            outer = np.einsum("k,kqi,kqj->kij", self._weights, g[:, :, a], g[:, :, b])
            dot = np.trace(outer, axis1=1, axis2=2)[:, None, None]
            block = la * outer + mu * outer.transpose(0, 2, 1) + mu * dot * identity
            kept = present[:, pair]
            place = bound.offsets[kept, pair, None, None] + np.arange(3)[:, None]
            place = place + bound.strides[kept, pair, None, None] * np.arange(3)
            np.add.at(self._stiffness, place, block[kept])

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the free nodes, shape (free_node_count, 3).

        Returns:
            Number of elements that are inside out at a quadrature point.
        """
        return add_stresses(
            positions, self._mesh.node_positions, self._mesh.tets, self._free,
            self._gradients, self._weights,
            self.material.lame_lambda, self.material.shear_modulus, forces,
        )  # fmt: skip

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add -F(q) to the forces and ∂F/∂q to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: Of no effect: the stiffness is never negative.
        """
        self.add_forces(positions, forces)
        storage[: len(self._stiffness)] += self._stiffness

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J]. Plain numpy, for studies and tests."""
        u = (positions - self._mesh.node_positions)[self._mesh.tets]
        gradient = np.einsum("kai,kqaj->kqij", u, self._gradients)
        strain = 0.5 * (gradient + gradient.transpose(0, 1, 3, 2))
        trace = np.trace(strain, axis1=2, axis2=3)
        la, mu = self.material
        density = mu * np.sum(strain**2, axis=(2, 3)) + 0.5 * la * trace**2
        return float(np.sum(self._weights[:, None] * density))
