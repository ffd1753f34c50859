"""Corotational linear tetrahedra: small strain in the frame that turns with the element.

The energy of one element is V (µ ‖F - R‖² + λ/2 tr²(RᵀF - 1)) with F = R S. Forces and tangent are
its exact first and second derivatives, so Newton's method converges quadratically:

    P    = 2µ (F - R) + λ tr(RᵀF - 1) R  =  2µ F - c R,      c = 2µ - λ tr(RᵀF - 1)
    K_ab = V (λ g_a g_bᵀ + 2µ (g_a·g_b) 1 + c [g_a]× (tr(RS Rᵀ) 1 - RS Rᵀ)⁻¹ [g_b]×),   g_a = R ∇N_a

At rest the last term is µ [g_a]× [g_b]×, and K_ab is linear elasticity's.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.polar import polar_rotation
from softrobot_twin.mechanics.stencil import bind_stencils

KERNEL = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}


def shape_gradients(node_positions: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the linear shape functions and the volumes.

    Args:
        node_positions: Rest positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        Gradients ∇N_a [1/m], shape (tet_count, 4, 3), and volumes [m³], shape (tet_count,).
    """
    corners = node_positions[tets]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    inverse = np.linalg.inv(edges)
    gradients = np.empty((len(tets), 4, 3))
    gradients[:, 1:] = inverse
    gradients[:, 0] = -inverse.sum(axis=1)
    return gradients, np.linalg.det(edges) / 6.0


@njit(**KERNEL)
def deformation_gradient(x, tet, gradient):
    """F = Σ x_a ∇N_aᵀ, row by row."""
    f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
    for a in range(4):
        n = tet[a]
        b0, b1, b2 = gradient[a, 0], gradient[a, 1], gradient[a, 2]
        f00 += x[n, 0] * b0
        f01 += x[n, 0] * b1
        f02 += x[n, 0] * b2
        f10 += x[n, 1] * b0
        f11 += x[n, 1] * b1
        f12 += x[n, 1] * b2
        f20 += x[n, 2] * b0
        f21 += x[n, 2] * b1
        f22 += x[n, 2] * b2
    return f00, f01, f02, f10, f11, f12, f20, f21, f22


@njit(**KERNEL)
def add_element_forces(F, R, c, mu, volume, gradient, free, forces):
    """Subtract the internal forces V P ∇N_a, P = 2µ F - c R, from the free nodes' forces."""
    m, r = 2.0 * mu * volume, c * volume
    p00, p01, p02 = m * F[0] - r * R[0], m * F[1] - r * R[1], m * F[2] - r * R[2]
    p10, p11, p12 = m * F[3] - r * R[3], m * F[4] - r * R[4], m * F[5] - r * R[5]
    p20, p21, p22 = m * F[6] - r * R[6], m * F[7] - r * R[7], m * F[8] - r * R[8]
    for a in range(4):
        n = free[a]
        if n >= 0:
            b0, b1, b2 = gradient[a, 0], gradient[a, 1], gradient[a, 2]
            forces[n, 0] -= p00 * b0 + p01 * b1 + p02 * b2
            forces[n, 1] -= p10 * b0 + p11 * b1 + p12 * b2
            forces[n, 2] -= p20 * b0 + p21 * b1 + p22 * b2


@njit(**KERNEL)
def spin_stiffness(F, R, c, mu, flat, projected):
    """c (tr(U) 1 - U)⁻¹ with the left stretch U = F Rᵀ: how turning changes the stress.

    The element's tangent is positive semi-definite just when this is at most µ. Where it is not
    and `projected` asks for it, or where the element is flat, µ stands in its place.

    Returns:
        The six entries 00 11 22 01 02 12 of the symmetric matrix [Pa].
    """
    u00 = F[0] * R[0] + F[1] * R[1] + F[2] * R[2]
    u11 = F[3] * R[3] + F[4] * R[4] + F[5] * R[5]
    u22 = F[6] * R[6] + F[7] * R[7] + F[8] * R[8]
    u01 = F[0] * R[3] + F[1] * R[4] + F[2] * R[5]
    u02 = F[0] * R[6] + F[1] * R[7] + F[2] * R[8]
    u12 = F[3] * R[6] + F[4] * R[7] + F[5] * R[8]
    g00, g11, g22 = u11 + u22, u00 + u22, u00 + u11
    g01, g02, g12 = -u01, -u02, -u12
    if flat or (projected and not dominates(g00, g11, g22, g01, g02, g12, c / mu)):
        return mu, mu, mu, 0.0, 0.0, 0.0
    k00, k01, k02 = g11 * g22 - g12 * g12, g02 * g12 - g01 * g22, g01 * g12 - g02 * g11
    s = c / (g00 * k00 + g01 * k01 + g02 * k02)
    k11, k22, k12 = g00 * g22 - g02 * g02, g00 * g11 - g01 * g01, g01 * g02 - g00 * g12
    return s * k00, s * k11, s * k22, s * k01, s * k02, s * k12


@njit(**KERNEL)
def dominates(g00, g11, g22, g01, g02, g12, bound):
    """True when a symmetric matrix minus `bound` times the identity is positive (Sylvester)."""
    a, b, c = g00 - bound, g11 - bound, g22 - bound
    minor = a * b - g01 * g01
    det = a * (b * c - g12 * g12) - g01 * (g01 * c - g12 * g02) + g02 * (g01 * g12 - b * g02)
    return a > 0.0 and minor > 0.0 and det > 0.0


@njit(**KERNEL)
def add_element_stiffness(g, q, M, la, mu2, offsets, strides, storage):
    """Add the ten lower blocks K_ab of one element.

    Args:
        g: Turned gradients R ∇N_a [1/m], shape (4, 3).
        q: Room for M [g_b]×, shape (3, 3).
        M: Spin stiffness times the volume [N m].
        la: λ V [N m].
        mu2: 2 µ V [N m].
        offsets: Places of the blocks, shape (10,).
        strides: Distances of their columns, shape (10,).
        storage: The system matrix.
    """
    m00, m11, m22, m01, m02, m12 = M
    pair = 0
    for b in range(4):
        b0, b1, b2 = g[b, 0], g[b, 1], g[b, 2]
        q[0, 0], q[0, 1], q[0, 2] = m01 * b2 - m02 * b1, m02 * b0 - m00 * b2, m00 * b1 - m01 * b0
        q[1, 0], q[1, 1], q[1, 2] = m11 * b2 - m12 * b1, m12 * b0 - m01 * b2, m01 * b1 - m11 * b0
        q[2, 0], q[2, 1], q[2, 2] = m12 * b2 - m22 * b1, m22 * b0 - m02 * b2, m02 * b1 - m12 * b0
        for a in range(b, 4):
            o = offsets[pair]
            if o >= 0:
                s = strides[pair]
                a0, a1, a2 = g[a, 0], g[a, 1], g[a, 2]
                dot = mu2 * (a0 * b0 + a1 * b1 + a2 * b2)
                for j in range(3):
                    lb = la * g[b, j]
                    storage[o] += lb * a0 + a1 * q[2, j] - a2 * q[1, j]
                    storage[o + 1] += lb * a1 + a2 * q[0, j] - a0 * q[2, j]
                    storage[o + 2] += lb * a2 + a0 * q[1, j] - a1 * q[0, j]
                    storage[o + j] += dot
                    o += s
            pair += 1


@njit(**KERNEL)
def add_forces_kernel(x, tets, free, gradients, volumes, la, mu, forces):
    """Internal forces of all elements; gives the number of flat or inverted ones."""
    flat_count = 0
    for k in range(len(tets)):
        F = deformation_gradient(x, tets[k], gradients[k])
        R, flat = polar_rotation(*F)
        flat_count += flat
        c = 2.0 * mu - la * (trace_product(R, F) - 3.0)
        add_element_forces(F, R, c, mu, volumes[k], gradients[k], free[k], forces)
    return flat_count


@njit(**KERNEL)
def trace_product(R, F):
    """tr(RᵀF)."""
    s = R[0] * F[0] + R[1] * F[1] + R[2] * F[2] + R[3] * F[3] + R[4] * F[4]
    return s + R[5] * F[5] + R[6] * F[6] + R[7] * F[7] + R[8] * F[8]


@njit(**KERNEL)
def add_kernel(
    x, tets, free, gradients, volumes, la, mu, projected, offsets, strides, forces, storage
):
    """Internal forces and stiffness of all elements."""
    g = np.empty((4, 3))
    q = np.empty((3, 3))
    for k in range(len(tets)):
        gradient, volume = gradients[k], volumes[k]
        F = deformation_gradient(x, tets[k], gradient)
        R, flat = polar_rotation(*F)
        c = 2.0 * mu - la * (trace_product(R, F) - 3.0)
        add_element_forces(F, R, c, mu, volume, gradient, free[k], forces)
        for a in range(4):
            b0, b1, b2 = gradient[a, 0], gradient[a, 1], gradient[a, 2]
            g[a, 0] = R[0] * b0 + R[1] * b1 + R[2] * b2
            g[a, 1] = R[3] * b0 + R[4] * b1 + R[5] * b2
            g[a, 2] = R[6] * b0 + R[7] * b1 + R[8] * b2
        m = spin_stiffness(F, R, c, mu, flat, projected)
        M = (
            volume * m[0], volume * m[1], volume * m[2],
            volume * m[3], volume * m[4], volume * m[5],
        )  # fmt: skip
        add_element_stiffness(
            g, q, M, la * volume, 2.0 * mu * volume, offsets[k], strides[k], storage
        )


class CorotationalTets:
    """Force term of an elastic body of corotational linear tetrahedra."""

    name = "corotational tetrahedra"

    def __init__(self, mesh: TetMesh, free_index: np.ndarray, material: LameParameters):
        """Prepare the elements.

        Args:
            mesh: The body at rest.
            free_index: Free-node index of each node, -1 where it is fixed, shape (node_count,).
            material: Lamé's constants [Pa].
        """
        self.material = material
        self._tets = np.ascontiguousarray(mesh.tets, dtype=np.int64)
        self._free = np.ascontiguousarray(free_index[mesh.tets], dtype=np.int64)
        self._gradients, self._volumes = shape_gradients(mesh.node_positions, mesh.tets)
        self._bound = None

    def stencils(self) -> np.ndarray:
        """Free nodes that each element couples, -1 where fixed, shape (tet_count, 4)."""
        return self._free

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Look up where the stiffness goes, and sort each element's nodes to suit."""
        bound = bind_stencils(self._free, elimination_rank, slots)
        self._tets = np.take_along_axis(self._tets, bound.order, axis=1)
        self._free = np.take_along_axis(self._free, bound.order, axis=1)
        self._gradients = np.take_along_axis(self._gradients, bound.order[:, :, None], axis=1)
        self._bound = bound

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add -F(q) [N] to the forces on the free nodes, shape (free_node_count, 3).

        Returns:
            Number of elements that are flat or inside out.
        """
        return add_forces_kernel(
            positions, self._tets, self._free, self._gradients, self._volumes,
            self.material.lame_lambda, self.material.shear_modulus, forces,
        )  # fmt: skip

    def add(self, positions, forces, storage, projected: bool) -> None:
        """Add -F(q) to the forces and ∂F/∂q to the system matrix.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
            storage: The factorization's storage [N/m]; added to.
            projected: True for the element-wise positive semi-definite tangent.
        """
        add_kernel(
            positions, self._tets, self._free, self._gradients, self._volumes,
            self.material.lame_lambda, self.material.shear_modulus, projected,
            self._bound.offsets, self._bound.strides, forces, storage,
        )  # fmt: skip

    def energy(self, positions: np.ndarray) -> float:
        """Stored elastic energy [J]. Plain numpy, for studies and tests."""
        F = np.einsum("kai,kaj->kij", positions[self._tets], self._gradients)
        U, _, Vt = np.linalg.svd(F)
        U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
        R = U @ Vt
        trace = np.einsum("kij,kij->k", R, F) - 3.0
        shear = np.sum((F - R) ** 2, axis=(1, 2))
        la, mu = self.material
        return float(np.sum(self._volumes * (mu * shear + 0.5 * la * trace**2)))
