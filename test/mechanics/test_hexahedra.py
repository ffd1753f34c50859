"""Enhanced hexahedra: patch tests, rigid motion, tangents, bending and volume without locking."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.hexahedral_mesh import (
    INTO_TETS,
    HexahedralMesh,
)
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import HEXAHEDRON_CORNERS
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.inertia import borne_masses, lumped_masses
from softrobot_twin.mechanics.laws import law_names
from softrobot_twin.mechanics.strain_rate_damping import StrainRateDamping
from test.builder import builder

YOUNG = 2.0e5


@builder
def bind_blocks(bind, /, mesh, law="corotational", poisson=0.3, fixed=()):
    """Binds a term of a law for each kind of cells of a mesh."""
    return bind(*((law, block.mesh, YOUNG, poisson) for block in mesh.blocks()), fixed=fixed)


def distorted(seed, cells=(3, 2, 2), amount=0.2, mixed=False):
    """A block whose nodes are all moved about; of one half of it each cell may be six tetrahedra."""
    grid = read_box(np.array(cells, float), cells, of_hexahedra=True).mesh
    rng = np.random.default_rng(seed)
    x = 0.01 * (grid.node_positions + rng.uniform(-amount, amount, grid.node_positions.shape))
    if not mixed:
        return HexahedralMesh(x, grid.tets, grid.hexahedra)
    middles = grid.node_positions[grid.hexahedra].mean(axis=1)
    cut = middles[:, 0] > 0.5 * cells[0]
    tets = grid.hexahedra[cut][:, INTO_TETS].reshape(-1, 4)
    return HexahedralMesh(x, tets, grid.hexahedra[~cut])


def inner_nodes(mesh):
    """Nodes that are not on the surface of a mesh."""
    return np.setdiff1d(np.arange(mesh.node_count), np.unique(mesh.surface_triangles))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("law", law_names())
def test_distorted_cells_reproduce_a_uniform_strain_exactly(bind_blocks, law, mixed, seed):
    mesh = distorted(seed, mixed=mixed)
    bound = bind_blocks(mesh, law)
    strain = np.random.default_rng(seed).uniform(-0.1, 0.1, (3, 3))
    forces, inverted = bound.forces(mesh.node_positions @ (np.eye(3) + strain).T)
    assert inverted == 0
    assert np.abs(forces[inner_nodes(mesh)]).max() < 1e-10 * np.abs(forces).max()


@pytest.mark.parametrize("seed", range(3))
def test_a_uniform_strain_prescribed_on_the_surface_is_found_inside(bind_blocks, seed):
    mesh = distorted(seed, mixed=True)
    surface = np.unique(mesh.surface_triangles)
    bound = bind_blocks(mesh, "linear", fixed=surface)
    rest, strain = mesh.node_positions, np.random.default_rng(seed).uniform(-0.1, 0.1, (3, 3))
    x = rest.copy()
    x[surface] += rest[surface] @ strain.T
    forces, _ = bound.assemble(x)
    assert bound.matrix.factor()
    x[bound.free] += bound.matrix.solve(forces)
    np.testing.assert_allclose(x - rest, rest @ strain.T, atol=1e-12 * np.abs(rest).max())


def test_warped_faces_between_hexahedra_and_tetrahedra_leave_no_gap():
    """Only inner nodes are moved, so that the volumes of all cells sum to that of the block."""
    grid = distorted(3, (4, 3, 3), amount=0.0, mixed=True)
    x = grid.node_positions.copy()
    inner = np.setdiff1d(np.arange(len(x)), np.unique(grid.surface_triangles))
    x[inner] += 0.002 * np.random.default_rng(3).uniform(-1.0, 1.0, (len(inner), 3))
    mesh = HexahedralMesh(x, grid.tets, grid.hexahedra)
    assert mesh.volume == pytest.approx(0.04 * 0.03 * 0.03, rel=1e-12)


@pytest.mark.parametrize("degrees", [1, 90, 180, 359])
@pytest.mark.parametrize("mixed", [False, True])
def test_rigid_rotation_stores_no_energy_and_makes_no_force(bind_blocks, degrees, mixed):
    mesh = distorted(4, mixed=mixed)
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.36, 0.48, 0.8]))
    bound = bind_blocks(mesh)
    turned = turn.apply(mesh.node_positions) + [1.0, -2.0, 3.0]
    forces, _ = bound.forces(turned)
    assert np.abs(forces).max() < 1e-10 * YOUNG * 0.01**2
    assert bound.energy(turned) < 1e-20 * YOUNG * mesh.volume


@pytest.mark.parametrize("seed", range(4))
def test_a_single_cell_has_only_the_six_rigid_modes_without_stiffness(bind_blocks, seed):
    mesh = distorted(seed, cells=(1, 1, 1), amount=0.15)
    for poisson in (0.0, 0.3, 0.499):
        _, K = bind_blocks(mesh, "linear", poisson).assemble(mesh.node_positions)
        values = np.linalg.eigvalsh(K.toarray())
        assert np.abs(values[:6]).max() < 1e-9 * values[-1]
        assert values[6] > 1e-5 * values[-1]


@pytest.mark.parametrize("law", law_names())
@pytest.mark.parametrize("seed", range(2))
def test_forces_and_stiffness_are_the_derivatives_of_the_energy(bind_blocks, law, seed):
    mesh = distorted(seed, cells=(2, 1, 1), mixed=True)
    bound = bind_blocks(mesh, law)
    rng = np.random.default_rng(seed)
    x = mesh.node_positions + 5e-4 * rng.standard_normal(mesh.node_positions.shape)
    bound.assert_slopes(x, rng.choice(mesh.node_count, 5, replace=False), step=1e-7)


def test_the_projected_stiffness_of_a_crushed_cell_is_positive_semidefinite(bind_blocks):
    mesh = distorted(2)
    bound = bind_blocks(mesh, poisson=0.45)
    crushed = mesh.node_positions * [0.4, 1.0, 1.2]
    exact, projected = bound.least_curvatures(crushed)
    assert exact < -1e-6 and projected > -1e-10


def test_an_inverted_cell_is_counted(bind_blocks):
    mesh = read_box((0.03, 0.01, 0.01), (3, 1, 1), of_hexahedra=True).mesh
    bound = bind_blocks(mesh)
    x = mesh.node_positions.copy()
    assert bound.forces(x)[1] == 0
    end = x[:, 0] > 0.0299
    x[end, 0] = 0.012
    assert bound.forces(x)[1] == 1


# --- accuracy ------------------------------------------------------------------------------------

LENGTH, LOAD = 1.0, 1.0e-4


def timoshenko(depth, poisson):
    """PL³/3EI + PL/κGA of a square section, κ after Cowper."""
    kappa = 10 * (1 + poisson) / (12 + 11 * poisson)
    bending = LOAD * LENGTH**3 / (3 * YOUNG * depth**4 / 12)
    return bending + LOAD * LENGTH * 2 * (1 + poisson) / (kappa * YOUNG * depth**2)


@builder
def deflection(bind_blocks, /, depth, cells, poisson):
    """Deflection of a cantilever's end under a shear load, over beam theory's."""
    mesh = read_box((LENGTH, depth, depth), cells, of_hexahedra=True).mesh
    x = mesh.node_positions
    bound = bind_blocks(mesh, "linear", poisson, fixed=np.flatnonzero(x[:, 0] < 1e-9))
    forces = np.zeros_like(x)
    end = x[:, 0] > LENGTH - 1e-9
    shares = [np.where((x[end, axis] > 1e-9) & (x[end, axis] < depth - 1e-9), 1.0, 0.5)
              for axis in (1, 2)]  # fmt: skip
    forces[end, 2] = LOAD * shares[0] * shares[1] / (shares[0] * shares[1]).sum()
    bound.assemble(x)
    assert bound.matrix.factor()
    u = bound.matrix.solve(forces[bound.free])
    return np.sum(u * forces[bound.free]) / LOAD / timoshenko(depth, poisson)


@pytest.mark.parametrize("depth, cells, poisson, error", [
    (0.1, (10, 1, 1), 0.3, 0.03), (0.1, (10, 1, 1), 0.49, 0.04), (0.05, (10, 1, 1), 0.3, 0.03),
    (0.05, (10, 1, 1), 0.49, 0.04), (0.02, (10, 1, 1), 0.3, 0.03), (0.02, (10, 1, 1), 0.49, 0.05),
    (0.05, (40, 2, 2), 0.49, 0.04), (0.05, (40, 2, 2), 0.4999, 0.05),
])  # fmt: skip
def test_a_cantilever_of_any_aspect_ratio_bends_as_beam_theory(deflection, depth, cells, poisson, error):
    assert deflection(depth, cells, poisson) == pytest.approx(1.0, abs=error)


COOKS_LIMIT = {0.3: 23.054, 0.49: 19.66, 0.4999: 19.43}
"""Richardson's limit of meshes of 16 to 64 cells along an edge, in plane strain with E = 1."""


@builder
def cooks_membrane(bind, bind_blocks, /, cells, poisson, of_tets=False):
    """Vertical displacement of the free end's upper corner in plane strain, E and load 1."""

    def shape(p):
        return np.stack(
            [48 * p[:, 0], 44 * p[:, 0] + p[:, 1] * (44 - 28 * p[:, 0]), p[:, 2]], axis=1
        )

    grid = read_box((1, 1, 1), (cells, cells, 1), of_hexahedra=True).mesh
    corners = HexahedralMesh(shape(grid.node_positions), grid.tets, grid.hexahedra)
    mesh = corners
    if of_tets:
        mesh = add_mid_edge_nodes(TetMesh(corners.node_positions, corners.as_tets))
    x = mesh.node_positions
    held = np.flatnonzero(x[:, 0] < 1e-9)
    bound = bind_blocks(mesh, "linear", poisson, fixed=held)
    forces = np.zeros_like(x)
    a, b, c = x[mesh.surface_triangles].transpose(1, 0, 2)
    at_end = np.minimum(np.minimum(a[:, 0], b[:, 0]), c[:, 0]) > 48 - 1e-9
    ends = mesh.surface_triangles[at_end]
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)[at_end]
    if of_tets:
        ends, areas = ends.reshape(-1, 4, 3)[:, 3], 4 * areas[::4]
    np.add.at(forces[:, 1], ends, areas[:, None] / 3 / 16)
    _, K = bound.assemble(x)
    in_plane = np.flatnonzero(np.tile([True, True, False], len(bound.free)))
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import spsolve

    u = np.zeros(3 * len(bound.free))
    K = csc_array(K)[in_plane][:, in_plane]
    u[in_plane] = spsolve(K, forces[bound.free].ravel()[in_plane])
    top = np.argmin(np.linalg.norm(x[bound.free, :2] - [48, 60], axis=1))
    return float(u[3 * top + 1]) * YOUNG


@pytest.mark.parametrize("poisson", COOKS_LIMIT)
def test_cooks_membrane_is_found_on_a_coarse_mesh(cooks_membrane, poisson):
    limit = COOKS_LIMIT[poisson]
    coarse, fine = cooks_membrane(8, poisson), cooks_membrane(16, poisson)
    assert 0.95 * limit < coarse < fine < limit
    assert limit - fine < 0.6 * (limit - coarse)


def test_the_limit_of_cooks_membrane_is_that_of_quadratic_tetrahedra(cooks_membrane):
    reached = cooks_membrane(12, 0.3, of_tets=True)
    assert reached == pytest.approx(COOKS_LIMIT[0.3], rel=0.02)


def test_displacements_converge_quadratically_on_distorted_meshes(bind_blocks):
    """A displacement u = ∇φ with Δφ = 0 needs no body force in any isotropic material."""

    def field(p):
        x, y, z = p.T
        e = np.exp(x)
        return np.stack([e * np.cos(0.6 * y) * np.cos(0.8 * z),
                         -0.6 * e * np.sin(0.6 * y) * np.cos(0.8 * z),
                         -0.8 * e * np.cos(0.6 * y) * np.sin(0.8 * z)], axis=1)  # fmt: skip

    errors = []
    for count in (3, 6):
        grid = read_box((1, 1, 1), (count, count, count), of_hexahedra=True).mesh
        x = grid.node_positions
        bend = 0.08 * np.prod(np.sin(np.pi * x), axis=1)[:, None] * [1.0, -1.0, 0.5]
        mesh = HexahedralMesh(x + bend, grid.tets, grid.hexahedra)
        surface = np.unique(mesh.surface_triangles)
        bound = bind_blocks(mesh, "linear", 0.49, fixed=surface)
        placed = mesh.node_positions.copy()
        placed[surface] += field(placed[surface])
        forces, _ = bound.assemble(placed)
        assert bound.matrix.factor()
        placed[bound.free] += bound.matrix.solve(forces)
        points = mesh.node_positions
        miss = placed - mesh.node_positions - field(points)
        errors.append(np.sqrt((miss**2).sum() / len(points)))
    assert errors[0] > 3.0 * errors[1]


# --- mass and viscosity --------------------------------------------------------------------------


@pytest.mark.parametrize("mixed", [False, True])
def test_masses_sum_to_that_of_the_body_and_have_its_centre(mixed):
    corners = distorted(5, mixed=mixed)
    mesh = corners
    density = np.random.default_rng(0).uniform(500.0, 1500.0, mesh.cell_count)
    total = density @ mesh.volumes
    for masses in (lumped_masses(mesh, density), borne_masses(mesh, density)):
        assert masses.sum() == pytest.approx(total)
        assert np.all(masses > 0.0)
    uniform = distorted(5)
    at = borne_masses(uniform, 1.0) @ uniform.node_positions / uniform.volume
    np.testing.assert_allclose(at, centre_of_mass(uniform), rtol=1e-12)


def centre_of_mass(mesh):
    """Centre of a body of hexahedra [m]: x det ∂x/∂ξ is cubic, which 2 × 2 × 2 points integrate."""
    corners, moment, volume = mesh.node_positions[mesh.hexahedra], 0.0, 0.0
    for place in HEXAHEDRON_CORNERS / np.sqrt(3.0):
        factors = 1.0 + HEXAHEDRON_CORNERS * place
        slopes = HEXAHEDRON_CORNERS * np.prod(factors, axis=1)[:, None] / factors / 8.0
        volumes = np.linalg.det(np.einsum("kai,aj->kij", corners, slopes))
        moment = moment + volumes @ (np.prod(factors, axis=1) @ corners / 8.0)
        volume = volume + volumes.sum()
    return moment / volume


def test_a_viscous_cell_resists_strain_and_not_rotation(bind):
    mesh = distorted(6)

    def term(block, free, lame):
        return StrainRateDamping(block, free, lame, 0.1)

    bound = bind(*[(term, block.mesh, YOUNG, 0.3) for block in mesh.blocks()])
    rest = mesh.node_positions
    for part in bound.terms:
        part.begin_step(rest, np.zeros_like(rest), 0.01)
    turned = Rotation.from_rotvec([0.3, -0.2, 0.1]).apply(rest)
    assert np.abs(bound.forces(turned)[0]).max() < 1e-9 * YOUNG * 0.01**2
    assert sum(part.heat(1.1 * rest) for part in bound.terms) > 0.0
