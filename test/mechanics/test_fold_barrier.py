"""The barrier between the points of an element: values that bound det F, derivatives, moves."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.cell_mesh import points_of
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import (
    HEXAHEDRON_CORNERS,
    QUADRATIC_TETRAHEDRON,
    TrilinearHexahedron,
)
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.fold_barrier import KEPT_SHARE, triples_of_parts
from softrobot_twin.mechanics.laws import law_names
from test.builder import builder

# Barycentric coordinates of points all over a tetrahedron, those of its corners and mid-edges first.
FINE = np.array([p for p in itertools.product(range(13), repeat=4) if sum(p) == 12]) / 12.0
PLACES = np.vstack([np.eye(4), [0.5 * (a + b) for a, b in itertools.combinations(np.eye(4), 2)]])


def mixed(A, B, C):
    """D(A, B, C) by its definition: det is the cubic form of which it is the polar form."""
    det = np.linalg.det
    return (det(A + B + C) - det(A + B) - det(A + C) - det(B + C) + det(A) + det(B) + det(C)) / 6.0


def values(F):
    """J_t of F at the four corners."""
    at = np.einsum("pc,cij->pij", PLACES, F)
    return np.array([mixed(*at[list(triple)]) for triple in triples_of_parts()])


def uneven(rng):
    """F at the four corners: a deformation that is upright, varied."""
    mean = Rotation.random(random_state=rng).as_matrix() * rng.uniform(0.5, 1.5, 3)
    return mean + rng.uniform(0.0, 0.6) * rng.standard_normal((4, 3, 3))


@builder
def tetrahedron(bind, /, law="corotational"):
    """Binds one quadratic tetrahedron of a law; its first two nodes are held."""
    corners = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    mesh = add_mid_edge_nodes(corners)
    return mesh, bind((law, mesh, 2e5, 0.3), fixed=[0, 1])


@builder
def cube(bind, /, law="corotational"):
    """Binds one hexahedron of a law; its first two nodes are held."""
    (block,) = read_box(np.ones(3), (1, 1, 1), of_hexahedra=True).mesh.blocks()
    return block.mesh, bind((law, block.mesh, 2e5, 0.3), fixed=[0, 1])


def values_of(mesh, x):
    """J_t of one element: a quadratic tetrahedron, or a hexahedron, of which they are det F."""
    if mesh.shape_functions is QUADRATIC_TETRAHEDRON:
        slopes = QUADRATIC_TETRAHEDRON.slopes(np.vstack([np.zeros(3), np.eye(3)]))
        return values(np.einsum("ni,cnj->cij", x[mesh.cells[0]], slopes))
    slopes = TrilinearHexahedron().slopes(HEXAHEDRON_CORNERS)
    # Half an edge of the cube is a unit of its reference coordinates.
    return np.linalg.det(2.0 * np.einsum("ni,cnj->cij", x[mesh.cells[0, :8]], slopes))


def volumes_of(mesh, x):
    """det F at the points of quadrature of one element."""
    apart = x[mesh.cells[0]] - mesh.node_positions[mesh.cells[0]]
    return np.linalg.det(np.eye(3) + np.einsum("ni,pnj->pij", apart, points_of(mesh).gradients[0]))


def nearly_folded(mesh, rng, least):
    """Nodes of an element that was moved along a drawn direction until a value is the least."""
    rest = mesh.node_positions
    while True:
        direction = rng.standard_normal(rest.shape)
        low, high = 0.0, 0.02
        while high < 1.0 and values_of(mesh, rest + high * direction).min() > least:
            low, high = high, high + 0.02
        for _ in range(60):
            middle = 0.5 * (low + high)
            above = values_of(mesh, rest + middle * direction).min() > least
            low, high = (middle, high) if above else (low, middle)
        if high < 1.0:
            return rest + high * direction


def test_values_are_determinants_where_their_places_are_one():
    F = uneven(np.random.default_rng(0))
    at = np.einsum("pc,cij->pij", PLACES, F)
    triples = triples_of_parts()
    own = (triples == triples[:, :1]).all(axis=1)
    assert own.sum() == 10 and len(triples) == 96
    np.testing.assert_allclose(values(F)[own], np.linalg.det(at[triples[own][:, 0]]), rtol=1e-12)


def test_values_do_not_prefer_a_numbering_of_the_corners():
    triples, places = {tuple(t) for t in triples_of_parts()}, [tuple(place) for place in PLACES]
    for order in itertools.permutations(range(4)):
        moved = [places.index(tuple(place[list(order)])) for place in PLACES]
        assert {tuple(sorted(moved[k] for k in triple)) for triple in triples} == triples


def test_det_F_is_nowhere_below_the_least_value_and_values_are_near_it(drawn_rng):
    gaps = []
    for _ in range(200):
        F = uneven(drawn_rng)
        J = np.linalg.det(np.einsum("pc,cij->pij", FINE, F))
        least = values(F).min()
        assert least <= J.min() + 1e-12 * np.abs(J).max()
        gaps.append((J.min() - least) / np.ptp(J))
    assert np.median(gaps) < 0.05


@pytest.mark.exhaustive
@pytest.mark.parametrize("least, acts", [(0.101, False), (0.099, True), (0.001, True), (-0.001, False)])
@pytest.mark.parametrize("kind", ["tetrahedron", "cube"])
def test_the_barrier_acts_where_a_value_is_small_and_none_is_not_positive(
    kind, least, acts, request, drawn_rng
):
    mesh, bound = request.getfixturevalue(kind)()
    (term,) = bound.terms
    for _ in range(10):
        x = nearly_folded(mesh, drawn_rng, least)
        inverted = bound.forces(x)[1]
        # Points of hexahedra may be flat or folded by themselves: their strain is enhanced.
        if not inverted:
            assert term.nearly_flat_count > 0 or not acts
            assert term.nearly_flat_count == 0 or acts or kind == "cube"
            assert term.crossed_count == (least < 0.0)


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
@pytest.mark.parametrize("kind", ["tetrahedron", "cube"])
def test_forces_and_stiffness_are_derivatives_of_the_energy(kind, law, request, drawn_rng):
    mesh, bound = request.getfixturevalue(kind)(law)
    (term,) = bound.terms
    x = nearly_folded(mesh, drawn_rng, 0.05)
    while bound.forces(x)[1] or not term.nearly_flat_count:
        x = nearly_folded(mesh, drawn_rng, 0.05)
    # The nearer a point is to where it is flat, the more all derivatives change.
    step = 1e-6 * np.ptp(x) * min(1.0, volumes_of(mesh, x).min() / 0.05)
    bound.assert_slopes(x, step=step, bar=(1e-6, 1e-5))
    assert bound.least_curvatures(x)[1] > -1e-12


@pytest.mark.sampled
@pytest.mark.parametrize("law", law_names())
def test_all_laws_but_that_of_small_displacements_have_the_barrier(law, tetrahedron, drawn_rng):
    mesh, bound = tetrahedron(law)
    bound.forces(nearly_folded(mesh, drawn_rng, 0.05))
    (term,) = bound.terms
    assert (term.nearly_flat_count > 0) == term.stays_upright == (law != "linear")


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", ["tetrahedron", "cube"])
def test_a_move_is_allowed_as_far_as_all_values_keep_a_share_of_themselves(kind, request, drawn_rng):
    mesh, bound = request.getfixturevalue(kind)()
    (term,), rest = bound.terms, mesh.node_positions
    for _ in range(20):
        change = 3.0 * (nearly_folded(mesh, drawn_rng, -0.05) - rest)
        share = term.largest_share(rest, rest + change)
        assert 0.0 < share < 1.0
        for part in np.linspace(0.0, share, 30):
            assert values_of(mesh, rest + part * change).min() >= KEPT_SHARE - 1e-9


def test_an_upright_element_beyond_the_barrier_has_none_and_is_told(tetrahedron, drawn_rng):
    """Values are lower than det F: an element may be upright where one is not positive."""
    mesh, bound = tetrahedron()
    (term,) = bound.terms
    for _ in range(100):
        x = nearly_folded(mesh, drawn_rng, -1e-4)
        inverted = bound.forces(x)[1]
        assert term.crossed_count == 1 and term.nearly_flat_count == 0
        if not inverted:
            return
    raise AssertionError("each of these elements is folded")
