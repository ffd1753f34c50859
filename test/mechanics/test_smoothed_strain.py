"""Facts of linear tetrahedra whose strain is smoothed over edges."""

from itertools import combinations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from softrobot_twin.geometry.smoothed_mesh import edge_rings, smooth
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.strain_rate_damping import StrainRateDamping
from softrobot_twin.mechanics.volume_barrier import BARRIER_VOLUME

from .test_corotational import deformed
from test.builder import builder

YOUNG, POISSON = 2.0e5, 0.4
LAWS = ("corotational", "linear", "neo_hookean", "mooney_rivlin", "yeoh", "ogden")


def rings_of(mesh, cells=None):
    (block,) = smooth(mesh).strained_blocks(cells)
    return block.mesh


@builder
def body(block, bind, /, law="corotational", fixed=(), **shape):
    """A box of tetrahedra with smoothed strain."""
    mesh = block(**shape)
    return mesh, bind((law, rings_of(mesh), YOUNG, POISSON), fixed=fixed)


def inside(mesh):
    return np.setdiff1d(np.arange(mesh.node_count), mesh.surface_triangles)


def random_mesh(rng):
    """Tetrahedra between random points, slivers included."""
    points = rng.random((int(rng.integers(5, 14)), 3))
    tets = Delaunay(points).simplices
    volumes = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])
    tets[volumes < 0.0] = tets[volumes < 0.0][:, [1, 0, 2, 3]]
    tets = tets[np.abs(volumes) > 1e-6]
    used, cells = np.unique(tets, return_inverse=True)
    return TetMesh(points[used], cells.reshape(tets.shape))


def test_the_volumes_of_the_rings_are_that_of_the_body(block):
    mesh = block(shake=0.3)
    assert rings_of(mesh).points.weights.sum() == pytest.approx(mesh.volume, rel=1e-13)


def test_a_ring_has_the_mean_gradient_of_its_tetrahedra(block):
    mesh = block(cells=(1, 2, 2), shake=0.3)
    x, moved, rings = mesh.node_positions, deformed(mesh, 0.05), rings_of(mesh)
    own = {}
    for tet, volume in zip(mesh.cells, mesh.volumes, strict=True):
        F = ((moved[tet[1:]] - moved[tet[0]]).T @ np.linalg.inv((x[tet[1:]] - x[tet[0]]).T))
        for pair in combinations(sorted(tet), 2):
            sums = own.setdefault(pair, [0.0, 0.0, set()])
            sums[0], sums[1] = sums[0] + volume / 6.0, sums[1] + volume / 6.0 * F
            sums[2] |= set(tet)
    assert len(own) == len(rings.cells)
    expected = {(tuple(sorted(nodes)), round(v * 1e12)): F / v for v, F, nodes in own.values()}
    for k, count in enumerate(rings.node_counts):
        assert len(set(rings.cells[k])) == count
        F = moved[rings.cells[k]].T @ rings.points.gradients[k, 0]
        key = tuple(sorted(set(rings.cells[k]))), round(rings.points.weights[k, 0] * 1e12)
        np.testing.assert_allclose(F, expected[key], atol=1e-12)


def test_rings_do_not_cross_from_one_material_to_another(block):
    mesh = block(cells=(2, 2, 2))
    left = np.flatnonzero(mesh.centres_at(mesh.node_positions)[:, 0] < mesh.bounding_box.mean(0)[0])
    assert set(rings_of(mesh, left).cells.ravel()) == set(mesh.cells[left].ravel())


@pytest.mark.parametrize("count", [10, pytest.param(100, marks=pytest.mark.exhaustive)])
def test_random_meshes_have_six_zero_energies_and_no_others(bind, drawn_rng, count):
    for _ in range(count):
        mesh = random_mesh(drawn_rng)
        _, K = bind(("corotational", rings_of(mesh), 1.0, 0.3)).assemble(mesh.node_positions)
        values = np.linalg.eigvalsh(K.toarray())
        assert np.abs(values[:6]).max() < 1e-10 * values[-1]
        assert values[6] > 1e3 * np.abs(values[:6]).max()
        # Linear tetrahedra, which have six, are stiffer against every motion.
        _, stiffer = bind(("corotational", mesh, 1.0, 0.3)).assemble(mesh.node_positions)
        assert np.linalg.eigvalsh((stiffer - K).toarray())[0] > -1e-10 * values[-1]
        assert values[6] > 1e-3 * np.linalg.eigvalsh(stiffer.toarray())[6]


@pytest.mark.parametrize("law", LAWS)
def test_forces_and_stiffness_are_the_slopes_of_the_energy(body, law):
    mesh, bound = body(law, cells=(1, 2, 1), shake=0.2, fixed=[0, 1, 2, 10])
    bound.assert_slopes(deformed(mesh, 0.03), range(0, mesh.node_count, 3))


def test_tangent_of_strain_rate_damping_is_minus_the_derivative_of_the_force(body):
    def damping(rings, free_index, lame):
        return StrainRateDamping(rings, free_index, lame, 0.1)

    mesh, bound = body(damping, cells=(1, 2, 1), shake=0.2, fixed=[0, 1])
    bound.terms[0].begin_step(deformed(mesh, 0.02), np.zeros_like(mesh.node_positions), 0.01)
    x = deformed(mesh, 0.02, seed=1)
    bound.assert_slopes(x, range(0, mesh.node_count, 5), 1e-7, has_energy=False)
    assert bound.terms[0].heat(x) > 0.0


GRADIENT = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.0, 0.05, 1.05]])


def test_patch_of_slivers_is_in_balance_inside(bind, drawn_rng):
    for _ in range(20):
        points = np.vstack([random_mesh(drawn_rng).node_positions, drawn_rng.random((40, 3))])
        tets = Delaunay(points).simplices
        volumes = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])
        tets[volumes < 0.0] = tets[volumes < 0.0][:, [1, 0, 2, 3]]
        mesh = TetMesh(points, tets)
        forces, _ = bind(("corotational", rings_of(mesh), YOUNG, POISSON)).assemble(points @ GRADIENT.T)
        assert len(inside(mesh)) > 10
        assert np.abs(forces[inside(mesh)]).max() < 1e-11 * np.abs(forces).max()


def test_a_bar_of_two_materials_strains_as_one_in_series(block, bind):
    """Each half has a uniform strain, and tractions at the interface are equal."""
    mesh = block(size=(0.4, 0.1, 0.1), cells=(4, 2, 2), shake=0.0)
    x = mesh.node_positions
    left = mesh.centres_at(x)[:, 0] < 0.2
    bound = bind(*(("corotational", rings_of(mesh, np.flatnonzero(part)), young, 0.0)
                   for part, young in ((left, 1.0e5), (~left, 3.0e5))))  # fmt: skip
    strain = 0.03
    stretched = x.copy()
    stretched[:, 0] = np.where(
        x[:, 0] < 0.2, x[:, 0] * (1.0 + strain), 0.2 * strain + x[:, 0] + (x[:, 0] - 0.2) * strain / 3.0
    )
    forces, _ = bound.assemble(stretched)
    free = (x[:, 0] > 1e-9) & (x[:, 0] < 0.4 - 1e-9)
    assert np.abs(forces[free]).max() < 1e-12 * np.abs(forces).max()
    assert forces[x[:, 0] < 1e-9, 0].sum() == pytest.approx(1.0e5 * strain * 0.1**2)


@pytest.fixture
def ring(bind):
    """Six tetrahedra around an edge, and a node of one of them."""
    angles = 2.0 * np.pi * np.arange(6) / 6.0
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1)
    x = np.vstack([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], rim])
    mesh = TetMesh(x, np.array([[0, 1, 2 + i, 2 + (i + 1) % 6] for i in range(6)]))
    return mesh, bind(("corotational", rings_of(mesh), YOUNG, POISSON))


def with_thin_tet(mesh, volume):
    """One tetrahedron of the ring has this share of its volume; its mean hardly changes."""
    x = mesh.node_positions.copy()
    angle = np.arcsin(volume * np.sin(np.pi / 3.0))
    x[3] = [np.cos(angle), np.sin(angle), 0.0]
    return x


def test_a_tetrahedron_that_folds_inside_a_good_ring_is_counted(ring):
    mesh, bound = ring
    assert bound.forces(with_thin_tet(mesh, 0.05))[1] == 0
    inverted = with_thin_tet(mesh, -0.05)
    term = bound.terms[0]
    assert bound.forces(inverted)[1] == 1 and term.crossed_count == 1
    deformations = inverted[mesh.cells[:, 1:]] - inverted[mesh.cells[:, :1]]
    assert (np.linalg.det(deformations) < 0.0).sum() == 1


def test_the_barrier_pushes_a_thin_tetrahedron_back(ring):
    mesh, bound = ring
    volume = 0.3 * BARRIER_VOLUME
    thin, thinner = with_thin_tet(mesh, volume), with_thin_tet(mesh, 0.5 * volume)
    thinning = thinner - thin
    forces, _ = bound.forces(thin)
    assert bound.terms[0].nearly_flat_count > 0
    assert (forces * thinning).sum() < 0.0
    energy = bound.terms[0].energy
    assert energy(with_thin_tet(mesh, 0.01 * volume)) > energy(thinner) > energy(thin)


def test_the_barrier_of_tetrahedra_has_exact_derivatives(ring):
    mesh, bound = ring
    x = with_thin_tet(mesh, 0.3 * BARRIER_VOLUME) + 1e-3 * deformed(mesh, 1.0)
    assert bound.forces(x)[1] == 0 and bound.terms[0].nearly_flat_count > 0
    bound.assert_slopes(x)


def test_no_move_may_fold_a_tetrahedron(ring):
    mesh, bound = ring
    begin, end = mesh.node_positions, with_thin_tet(mesh, -0.5)
    share = bound.terms[0].largest_share(begin, end)
    assert 0.1 < share < 0.7
    assert bound.forces(begin + share * (end - begin))[1] == 0


def test_linear_tetrahedra_watch_no_ring(block, bind):
    bound = bind(("corotational", block(), YOUNG, POISSON))
    assert bound.terms[0].fold_barrier is None


def test_edge_rings_of_one_tetrahedron_are_the_tetrahedron():
    mesh = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    rings = edge_rings(mesh)
    assert rings.cells.shape == (6, 4) and (rings.node_counts == 4).all()
    np.testing.assert_allclose(rings.points.weights, mesh.volume / 6.0)
