"""Liquid in cavities: its pressure grows with depth.

With w = ρ g, the pressure of a liquid is p(x) = λ + w · (x - o), where λ is the pressure at a point
o. The second part is the gradient of the potential

    U = -∫ w · (x - o) dV = -Σ v w · (x_i + x_j + x_k) / 4,    v = x_i · (x_j × x_k) / 6,

over the triangles (i, j, k) of the walls, whose vertices x are seen from o (divergence theorem). With
g_i = ∂v/∂x_i and s = x_i + x_j + x_k the forces and their derivative are

    f_i = (w · s) g_i / 4 + v w / 4,
    ∂f_i/∂x_j = (w · s) ∂g_i/∂x_j / 4 + (g_i wᵀ + w g_jᵀ) / 4,    ∂g_i/∂x_j = -[x_k]ₓ / 6.

Arguments of the kernels here; those of one triangle have no first axis:
    cavity: Cavity of each triangle, shape (triangle_count,).
    forces: At the vertices [N], shape (vertex_count, 3); added to.
    m: Number of a vertex in its triangle; 3 is the first one again.
    offsets, strides: Places of the blocks in storage, shape (triangle_count, pair_count).
    points: Vertices [m], shape (vertex_count, 3).
    shares: Weights of the nodes that carry the vertices, shape (triangle_count, 3, width).
    t: A triangle.
    tops, weights: Top [m], and w [N/m³], of each cavity, shape (cavity_count, 3).
    triangles: Vertices of each, shape (triangle_count, 3).
    x: Three vertices of one triangle, each three numbers [m].
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.matrix3 import ZERO, add_outer, add_scaled_matrix, cross_matrix
from softrobot_twin.geometry.vector3 import (
    add,
    add_scaled,
    cross,
    dot,
    row,
    scaled,
    set_row,
    subtract,
)
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.cavity_surfaces import CavityLoad, CavitySurface
from softrobot_twin.mechanics.stencil import add_block


@njit(**INNER)
def corner(points, triangles, t, m, tops, cavity):
    """Vertex m of a triangle, seen from the top of its cavity."""
    return subtract(row(points, triangles[t, m % 3]), row(tops, cavity[t]))


@njit(**KERNEL)
def _add_liquid_forces(points, triangles, cavity, tops, weights, forces):
    """Add f_i of every triangle to the vertices; gives U [J]."""
    energy = 0.0
    for t in range(len(triangles)):
        w = row(weights, cavity[t])
        i = corner(points, triangles, t, 0, tops, cavity)
        j = corner(points, triangles, t, 1, tops, cavity)
        k = corner(points, triangles, t, 2, tops, cavity)
        depth = 0.25 * dot(w, add(i, add(j, k)))
        v = dot(i, cross(j, k)) / 6.0
        energy -= v * depth
        for m in range(3):
            a = corner(points, triangles, t, m + 1, tops, cavity)
            b = corner(points, triangles, t, m + 2, tops, cavity)
            n = triangles[t, m]
            force = add_scaled(scaled(w, 0.25 * v), cross(a, b), depth / 6.0)
            set_row(forces, n, add(row(forces, n), force))
    return energy


@njit(**ONCE)
def _force_derivative(x, w, i, j):
    """∂f_i/∂x_j of one triangle with vertices x."""
    g_i = scaled(cross(x[(i + 1) % 3], x[(i + 2) % 3]), 1.0 / 24.0)
    g_j = scaled(cross(x[(j + 1) % 3], x[(j + 2) % 3]), 1.0 / 24.0)
    K = add_outer(add_outer(ZERO, g_i, w), w, g_j)
    if i == j:
        return K
    depth = 0.25 * dot(w, add(x[0], add(x[1], x[2])))
    sign = -1.0 if (i + 1) % 3 == j else 1.0
    return add_scaled_matrix(K, cross_matrix(x[3 - i - j]), sign * depth / 6.0)


@njit(**KERNEL)
def _add_liquid_stiffness(points, triangles, cavity, tops, weights, shares, offsets, strides, storage):
    """Add -Σ w_ia w_jb ∂f_i/∂x_j of every triangle to the blocks of nodes a and b."""
    width = shares.shape[2]
    for t in range(len(triangles)):
        w = row(weights, cavity[t])
        x = (corner(points, triangles, t, 0, tops, cavity),
             corner(points, triangles, t, 1, tops, cavity),
             corner(points, triangles, t, 2, tops, cavity))  # fmt: skip
        pair = 0
        for b in range(width):
            for a in range(b, width):
                if offsets[t, pair] >= 0:
                    K = ZERO
                    for i in range(3):
                        for j in range(3):
                            share = -shares[t, i, a] * shares[t, j, b]
                            if share != 0.0:
                                K = add_scaled_matrix(K, _force_derivative(x, w, i, j), share)
                    add_block(K, offsets[t, pair], strides[t, pair], storage)
                pair += 1


class LiquidFilling(CavityLoad):
    """The weight of the liquid in cavities, as a pressure on their walls."""

    name = "liquid_filling"

    def __init__(
        self, surfaces: tuple[CavitySurface, ...], free_index: np.ndarray,
        rest_positions: np.ndarray, densities: np.ndarray, gravity: np.ndarray,
    ):  # fmt: skip
        """Fill the cavities.

        Args:
            surfaces: The cavities.
            free_index: Unknown of each node, -1 where fixed, shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            densities: Density of the liquid in each [kg/m³], shape (cavity_count,).
            gravity: Acceleration [m/s²], shape (3,).
        """
        super().__init__(surfaces, free_index, rest_positions)
        self._weights = np.outer(densities, gravity)
        # The pressure of a cavity is that at its highest vertex at rest, where the valve is.
        corners = self.walls.vertices(rest_positions)
        self._tops = np.array([x[np.argmin(x @ gravity)] for x in corners])
        self._forces = np.empty((sum(map(len, corners)), 3))

    def _add_forces(self, positions: np.ndarray) -> float:
        """Write the forces on the vertices [N]; gives the energy [J]."""
        self._forces[:] = 0.0
        return _add_liquid_forces(
            self.walls.place(positions), self.walls.triangles, self.walls.cavity, self._tops,
            self._weights, self._forces,
        )  # fmt: skip

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """See `ForceTerm.add_forces`."""
        self._add_forces(positions)
        self.walls.carry_forces(self._forces, forces)
        return 0

    def add_stiffness(self, positions: np.ndarray, storage: np.ndarray, projected: bool) -> None:
        """See `ForceTerm.add_stiffness`. Projected, it adds no stiffness; see `Cavities.add_stiffness`."""
        if not projected:
            walls = self.walls
            _add_liquid_stiffness(
                walls.place(positions), walls.triangles, walls.cavity, self._tops, self._weights,
                walls.stencil_weights, walls.bound.offsets, walls.bound.strides, storage,
            )  # fmt: skip

    def energy(self, positions: np.ndarray) -> float:
        """U [J]; see `ForceTerm.energy`."""
        return self._add_forces(positions)
