"""Fixtures of the tests of elements: terms bound to a matrix, and a quadrature of high degree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.material import bulk_modulus, lame_parameters, shear_modulus
from softrobot_twin.mechanics.remembering_elements import RememberingElements
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU
from test.builder import builder
from test.finite_differences import central_slopes


class Bound(NamedTuple):
    """Terms over one mesh, and the matrix they add to."""

    terms: list
    matrix: SuperLU
    free: np.ndarray

    def assemble(self, positions, projected=False):
        """Forces on the free nodes, and the matrix, of the sum of the terms."""
        forces = np.zeros((len(self.free), 3))
        self.matrix.clear()
        for term in self.terms:
            term.add(positions, forces, self.matrix.storage, projected)
        return forces, self.matrix.matrix()

    def forces(self, positions):
        forces = np.zeros((len(self.free), 3))
        inverted = sum(term.add_forces(positions, forces) for term in self.terms)
        return forces, inverted

    def slopes_of_forces(self, x, step=1e-6, nodes=None):
        """By the coordinates of the free nodes, or of some."""
        nodes = self.free if nodes is None else nodes
        return central_slopes(lambda at: self.forces(at)[0].ravel(), x, nodes, step)

    def energy(self, positions):
        return sum(term.energy(positions) for term in self.terms)

    def assert_slopes(self, x, nodes=None, step=1e-6, bar=(1e-6, 1e-6), has_energy=True):
        """At some nodes forces are the energy's slope down, and the matrix is that of the forces.

        The bars are shares of the largest force and of the largest entry of the matrix.
        """
        nodes = self.free if nodes is None else np.intersect1d(nodes, self.free)
        own = np.searchsorted(self.free, nodes)
        forces, K = self.assemble(x)
        np.testing.assert_allclose(self.forces(x)[0], forces, atol=1e-12 * np.abs(forces).max())
        if has_energy:
            gradient = central_slopes(self.energy, x, nodes, step)
            np.testing.assert_allclose(
                forces[own].ravel(), -gradient, atol=bar[0] * np.abs(forces).max()
            )
        columns = self.slopes_of_forces(x, step, nodes)
        found = K.toarray()[:, (3 * own[:, None] + np.arange(3)).ravel()]
        np.testing.assert_allclose(found, -columns, atol=bar[1] * np.abs(K).max())

    def least_curvatures(self, x):
        """The least eigenvalue of the exact and of the projected matrix, by the largest entry."""
        matrices = [self.assemble(x, projected)[1].toarray() for projected in (False, True)]
        scale = np.abs(matrices[0]).max()
        return [np.linalg.eigvalsh(K)[0] / scale for K in matrices]


SHARES = {
    "mooney_rivlin": {"c10": 0.35, "c01": 0.15},
    "yeoh": {"c1": 0.5, "c2": -0.02, "c3": 0.01},
    "ogden": {"shear_moduli": (0.8, -0.2), "exponents": (1.5, -4.0)},
}
"""Constants of laws that have their own, those with a unit as shares of µ."""


@builder
def parameters_of(law, young, poisson):
    """The parameters of a law, by its name, that has E and ν at rest."""
    own, mu = law_named(law).own, shear_modulus(young, poisson)
    if own is None:
        return law_named(law).of_moduli(young, poisson)
    if law == "orthotropic":
        each = {"young_moduli": young, "shear_moduli": mu, "poisson_ratios": poisson}
        axes = {"first_axis": (2.0, 1.0, 0.0), "second_axis": (-1.0, 2.0, 0.0)}
        return own.parameters({name: 3 * (value,) for name, value in each.items()} | axes,
                              bulk_modulus(young, poisson))  # fmt: skip
    scale = {constant.name: mu if constant.unit else 1.0 for constant in own.constants}
    constants = {
        name: tuple(scale[name] * one for one in share) if isinstance(share, tuple)
        else scale[name] * share
        for name, share in SHARES[law].items()
    }  # fmt: skip
    return own.parameters(constants, bulk_modulus(young, poisson))


@builder
def bind(parameters_of, /, *parts, fixed=()) -> Bound:
    """Binds terms, each given as (class or name of a law, mesh, E, ν), with some nodes fixed."""

    def term_of(made, mesh, free_index, young, poisson):
        if isinstance(made, str):
            return Elements(mesh, free_index, parameters_of(made, young, poisson))
        return made(mesh, free_index, lame_parameters(young, poisson))

    node_count = len(parts[0][1].node_positions)
    free = np.setdiff1d(np.arange(node_count), fixed)
    free_index = np.full(node_count, -1)
    free_index[free] = np.arange(len(free))
    terms = [term_of(made, part, free_index, *moduli) for made, part, *moduli in parts]
    pairs = [stencil_pairs(term.stencils()) for term in terms]
    rows, columns = (np.concatenate(side) for side in zip(*pairs, strict=True))
    matrix = SuperLU(rows, columns, len(free))
    for term in terms:
        term.bind(matrix.elimination_rank, matrix.slots)
    return Bound(terms, matrix, free)


@pytest.fixture
def slopes():
    """Central differences; see `central_slopes`."""
    return central_slopes


@builder
def tet_rule(order=5):
    """Barycentric points and weights (sum 1) of a rule on a tetrahedron, from Gauss's on a cube."""
    points, weights = np.polynomial.legendre.leggauss(order)
    points, weights = 0.5 * (points + 1.0), 0.5 * weights
    u, v, w = (g.ravel() for g in np.meshgrid(points, points, points, indexing="ij"))
    product = np.einsum("i,j,k->ijk", weights, weights, weights).ravel()
    x, y, z = u, v * (1 - u), w * (1 - u) * (1 - v)
    return np.column_stack([1 - x - y - z, x, y, z]), 6 * product * (1 - u) ** 2 * (1 - v)


class MaterialPoint:
    """One linear tetrahedron, which is deformed as a whole: a material at one point."""

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])

    def __init__(self, law, **memory):
        mesh = TetMesh(self.corners, np.array([[0, 1, 2, 3]]))
        self.elements = RememberingElements(mesh, np.arange(4), law, **memory)
        rows, columns = stencil_pairs(self.elements.stencils())
        matrix = SuperLU(rows, columns, 4)
        self.elements.bind(matrix.elimination_rank, matrix.slots)
        self.time, self.positions, self.memory = 0.0, self.corners, {}

    def step(self, F, time_step=0.0):
        """Deform it to F in a time, and remember it; the stress P [Pa] at its end."""
        positions = self.corners @ np.asarray(F).T
        self.elements.begin_step(self.positions, np.empty(0), time_step)
        P, self.positions = self.stress(F), positions
        self.memory = self.elements.memory_after(positions, None)
        self.elements.recall(self.memory, None, None)
        self.elements.begin_step(positions, np.empty(0), time_step)
        self.time += time_step
        return P

    def stress(self, F):
        """P [Pa] at F in the step that began last."""
        forces = np.zeros((4, 3))
        self.elements.add_forces(self.corners @ np.asarray(F).T, forces)
        return -6.0 * forces.T @ self.corners


@pytest.fixture
def material_point():
    """Makes a `MaterialPoint`."""
    return MaterialPoint
