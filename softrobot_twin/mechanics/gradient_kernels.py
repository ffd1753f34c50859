"""Positions to deformation gradients and stresses to nodal forces, for elements of any order.

How many nodes an element has is told by its arrays. See `lanes.py` for how they are laid out.
"""

from __future__ import annotations

from numba import njit

from softrobot_twin.mechanics.lanes import KERNEL, LANES, at


@njit(**KERNEL)
def gather(x, tets, X):
    """Coordinates of the elements' nodes."""
    for a in range(len(tets)):
        node = X[at(3 * a, 0) : at(3 * a + 3, 0)]
        for e in range(LANES):
            n = tets[a, e]
            node[at(0, e)] = x[n, 0]
            node[at(1, e)] = x[n, 1]
            node[at(2, e)] = x[n, 2]


@njit(**KERNEL)
def deform(X, G, F):
    """F = Σ x_a ∇N_aᵀ at one point."""
    F[:] = 0.0
    for a in range(len(X) // (3 * LANES)):
        node = X[at(3 * a, 0) : at(3 * a + 3, 0)]
        gradient = G[at(3 * a, 0) : at(3 * a + 3, 0)]
        for e in range(LANES):
            b0, b1, b2 = gradient[at(0, e)], gradient[at(1, e)], gradient[at(2, e)]
            x0, x1, x2 = node[at(0, e)], node[at(1, e)], node[at(2, e)]
            F[at(0, e)] += x0 * b0
            F[at(1, e)] += x0 * b1
            F[at(2, e)] += x0 * b2
            F[at(3, e)] += x1 * b0
            F[at(4, e)] += x1 * b1
            F[at(5, e)] += x1 * b2
            F[at(6, e)] += x2 * b0
            F[at(7, e)] += x2 * b1
            F[at(8, e)] += x2 * b2


@njit(**KERNEL)
def turn_gradients(G, R, g):
    """g_a = R ∇N_a at one point."""
    for a in range(len(g) // (3 * LANES)):
        gradient = G[at(3 * a, 0) : at(3 * a + 3, 0)]
        turned = g[at(3 * a, 0) : at(3 * a + 3, 0)]
        for e in range(LANES):
            b0, b1, b2 = gradient[at(0, e)], gradient[at(1, e)], gradient[at(2, e)]
            turned[at(0, e)] = R[at(0, e)] * b0 + R[at(1, e)] * b1 + R[at(2, e)] * b2
            turned[at(1, e)] = R[at(3, e)] * b0 + R[at(4, e)] * b1 + R[at(5, e)] * b2
            turned[at(2, e)] = R[at(6, e)] * b0 + R[at(7, e)] * b1 + R[at(8, e)] * b2


@njit(**KERNEL)
def add_stresses(G, mu, F, c, g, P):
    """Add P ∇N_a with P = 2µ F - c R at one point to each node's sum."""
    for a in range(len(g) // (3 * LANES)):
        gradient = G[at(3 * a, 0) : at(3 * a + 3, 0)]
        turned = g[at(3 * a, 0) : at(3 * a + 3, 0)]
        node = P[at(3 * a, 0) : at(3 * a + 3, 0)]
        for e in range(LANES):
            b0, b1, b2 = gradient[at(0, e)], gradient[at(1, e)], gradient[at(2, e)]
            stretched0 = F[at(0, e)] * b0 + F[at(1, e)] * b1 + F[at(2, e)] * b2
            stretched1 = F[at(3, e)] * b0 + F[at(4, e)] * b1 + F[at(5, e)] * b2
            stretched2 = F[at(6, e)] * b0 + F[at(7, e)] * b1 + F[at(8, e)] * b2
            node[at(0, e)] += 2.0 * mu * stretched0 - c[e] * turned[at(0, e)]
            node[at(1, e)] += 2.0 * mu * stretched1 - c[e] * turned[at(1, e)]
            node[at(2, e)] += 2.0 * mu * stretched2 - c[e] * turned[at(2, e)]


@njit(**KERNEL)
def subtract_forces(free, weights, P, forces):
    """Subtract the points' weight times the sums from the forces on the free nodes."""
    for a in range(len(free)):
        node = P[at(3 * a, 0) : at(3 * a + 3, 0)]
        for e in range(LANES):
            n = free[a, e]
            if n >= 0:
                forces[n, 0] -= weights[e] * node[at(0, e)]
                forces[n, 1] -= weights[e] * node[at(1, e)]
                forces[n, 2] -= weights[e] * node[at(2, e)]
