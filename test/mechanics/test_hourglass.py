"""What resists the hour-glass modes of hexahedra: stability, derivatives, viscosity, reduced bodies."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.shape_functions import hourglass_fields
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.hourglass import hourglass_moduli
from softrobot_twin.mechanics.laws import law_named, law_names
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.reduced_elements import ReducedElements, all_points, point_gradients
from softrobot_twin.mechanics.reduced_motion import ReducedStrainRateDamping
from softrobot_twin.mechanics.remembering_elements import RememberingElements
from softrobot_twin.mechanics.strain_rate_damping import StrainRateDamping
from softrobot_twin.mechanics.viscosity import ViscousTerm

YOUNG, MODES = 1.0e5, 12
SIZE = np.array([0.02, 0.02, 0.02])


def block(cells=(2, 2, 1), rng=None, size=SIZE):
    """A block of hexahedra, whose nodes are moved about by a generator."""
    grid = read_box(size, cells, of_hexahedra=True).mesh
    if rng is None:
        return grid
    steps = 0.15 * np.asarray(size) / cells
    moved = grid.node_positions + steps * rng.uniform(-1.0, 1.0, grid.node_positions.shape)
    return HexahedralMesh(moved, grid.tets, grid.hexahedra)


def forces_of(term, x):
    forces = np.zeros_like(x)
    term.add_forces(x, forces)
    return forces


def assert_stiffness(bound, x, step=1e-7, bar=1e-6):
    """The assembled stiffness is the slope of the forces."""
    _, K = bound.assemble(x)
    slopes = bound.slopes_of_forces(x, step)
    np.testing.assert_allclose(K.toarray(), -slopes, atol=bar * np.abs(slopes).max())


# --- it does not fold ----------------------------------------------------------------------------


@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.4999])
@pytest.mark.parametrize("aspect", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("law", sorted(set(law_names()) - {"linear"}))
def test_a_compressed_cell_resists_every_hourglass_mode(bind, law, aspect, poisson):
    """Flat and tall cells, free at their sides; up to half of their height."""
    mesh = block((1, 1, 1), size=SIZE * [aspect, 1.0, 1.0])
    (cells,) = mesh.blocks()
    (bound,) = [bind((law, cells.mesh, YOUNG, poisson))]
    fields = hourglass_fields(mesh.node_positions[mesh.hexahedra])
    gammas = np.linalg.svd(fields.gammas[0])[2][:4]
    modes = np.einsum("ia,cd->acid", gammas, np.eye(3)).reshape(24, 12)
    order = np.argsort(mesh.hexahedra[0])
    rows = modes.reshape(8, 3, 12)[order].reshape(24, 12)
    rest = np.linalg.eigvalsh(rows.T @ bound.assemble(mesh.node_positions)[1].toarray() @ rows)
    for stretch in (0.9, 0.7, 0.5):
        for axis in range(3):
            scale = np.full(3, stretch**-0.5)
            scale[axis] = stretch
            K = bound.assemble(mesh.node_positions * scale)[1].toarray()
            assert np.linalg.eigvalsh(rows.T @ K @ rows)[0] > 0.1 * rest[0]


def test_the_moduli_are_positive_and_bending_does_not_know_the_bulk_modulus():
    fields = hourglass_fields(block((1, 1, 1)).node_positions[block((1, 1, 1)).hexahedra])
    soft, hard = (np.linalg.eigvalsh(hourglass_moduli(fields, lame_parameters(YOUNG, nu))[0])
                  for nu in (0.45, 0.4999))  # fmt: skip
    assert soft[0] > 0.0 and hard[0] > 0.0
    assert hard[-1] < 1.5 * soft[-1]


# --- with all that elements have -----------------------------------------------------------------


@pytest.mark.parametrize("law", law_names())
def test_flat_and_inverted_cells_have_forces_that_are_slopes_of_the_energy(bind, law, drawn_rng):
    mesh = block((1, 1, 1), drawn_rng)
    (cells,) = mesh.blocks()
    bound = bind((law, cells.mesh, YOUNG, 0.4))
    (hourglass,) = [term.hourglass for term in bound.terms]
    rest = mesh.node_positions
    for height in (0.3, 0.02, -0.3):
        x = rest * [1.0, 1.0, height] + 5e-4 * drawn_rng.standard_normal(rest.shape)
        d = drawn_rng.standard_normal(rest.shape)
        step = 1e-8
        slope = (hourglass.energy(x + step * d) - hourglass.energy(x - step * d)) / (2.0 * step)
        forces = np.zeros_like(x)
        hourglass.take(x)
        hourglass.add_forces(bound.terms[0].run_parts, forces)
        assert -np.vdot(forces, d) == pytest.approx(slope, rel=1e-4, abs=1e-9 * YOUNG * 4e-4)


def test_force_curvature_is_the_second_difference_of_the_forces(bind, drawn_rng):
    mesh = block((2, 1, 1), drawn_rng)
    (cells,) = mesh.blocks()
    bound = bind(("neo_hookean", cells.mesh, YOUNG, 0.4))
    (term,) = bound.terms
    rest = mesh.node_positions
    x = rest + 1e-3 * drawn_rng.standard_normal(rest.shape)
    d, step = drawn_rng.standard_normal(rest.shape), 2e-6
    found = np.zeros_like(rest)
    term.add_force_curvature(x, d, 1e-3, found)
    forces = [forces_of(term, x + sign * step * d) for sign in (-1, 0, 1)]
    expected = -(forces[0] - 2.0 * forces[1] + forces[2]) / step**2
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_strain_rate_damping_resists_bending_and_no_rotation(bind, drawn_rng):
    mesh = block((1, 1, 1))
    (cells,) = mesh.blocks()
    bound = bind((lambda mesh, free, lame: StrainRateDamping(mesh, free, lame, 0.1), cells.mesh,
                  YOUNG, 0.4))  # fmt: skip
    (term,) = bound.terms
    rest = mesh.node_positions
    bent = rest + 2e-3 * rest[:, :1] * rest[:, 2:] / 4e-4 * [1.0, 0.0, 0.0]
    term.begin_step(bent, np.zeros_like(bent), 0.01)
    turned = Rotation.from_rotvec([0.4, -0.3, 0.2]).apply(bent)
    assert np.abs(forces_of(term, turned)).max() < 1e-9 * YOUNG * 4e-4
    assert term.heat(rest) > 0.0
    assert_stiffness(bound, bent)
    assert_stiffness(bound, bent + 5e-4 * drawn_rng.standard_normal(rest.shape))


def test_viscous_bending_relaxes_to_the_share_that_remains(bind, drawn_rng):
    mesh = block((1, 1, 1))
    (cells,) = mesh.blocks()
    series = (ViscousTerm(0.4, 1.0),)

    def viscous(mesh, free, lame):
        return RememberingElements(mesh, free, law_named("neo_hookean").of_moduli(YOUNG, 0.4), series)

    bound = bind((viscous, cells.mesh, YOUNG, 0.4))
    (term,) = bound.terms
    rest = mesh.node_positions
    centred = rest - rest.mean(axis=0)
    bent = rest + 2e-4 * centred[:, :1] * centred[:, 2:] / 4e-4 * [1.0, 0.0, 0.0]
    memory, sizes = term.memory_at_rest(), []
    for begin, end, span in ((rest, bent, 1e-6), (bent, bent, 100.0), (bent, bent, 1e-6)):
        term.recall(memory, None, None)
        term.begin_step(begin, None, span)
        sizes.append(np.linalg.norm(forces_of(term, end)))
        assert_stiffness(bound, end, bar=1e-5)
        memory = term.memory_after(end, None)
    assert sizes[2] == pytest.approx(0.6 * sizes[0], rel=0.01)


# --- in the coordinates of a basis ---------------------------------------------------------------


def reduced(mesh, law, rng):
    (cells,) = mesh.blocks()
    waves, phases = 40.0 * rng.standard_normal((3, MODES, 3)), 6.0 * rng.random((3, MODES))
    basis = np.cos(np.einsum("ni,jmi->njm", mesh.node_positions, waves) + phases)
    points, nodes = point_gradients(cells, all_points(cells), basis), np.arange(MODES // 3)
    return basis, points, ReducedElements(points, law, nodes, nodes)


@pytest.mark.parametrize("name", ["corotational", "linear", "neo_hookean"])
def test_a_reduced_body_has_the_projected_forces_energy_and_stiffness(name, bind, drawn_rng):
    mesh, law = block((2, 2, 1), drawn_rng), law_named(name).of_moduli(YOUNG, 0.4)
    basis, _, term = reduced(mesh, law, drawn_rng)
    (cells,) = mesh.blocks()
    bound = bind((lambda mesh, free, lame: Elements(mesh, free, law), cells.mesh, YOUNG, 0.4))
    q = 2e-4 * drawn_rng.standard_normal(MODES)
    x = mesh.node_positions + basis @ q
    forces, K = bound.assemble(x)
    expected = np.einsum("nim,ni->m", basis, forces)
    np.testing.assert_allclose(
        forces_of(term, q.reshape(-1, 3)).ravel(), expected, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(
        -term.point_forces(q).sum(axis=0), expected, atol=1e-11 * np.abs(expected).max())
    assert term.energy(q.reshape(-1, 3)) == pytest.approx(bound.energy(x), rel=1e-10)
    flat = basis.reshape(-1, MODES)
    projected = flat.T @ K.toarray() @ flat
    np.testing.assert_allclose(
        term.stiffness(False), projected, atol=1e-10 * np.abs(projected).max())


def test_the_damping_of_a_reduced_body_is_that_of_its_cells(bind, drawn_rng):
    mesh, lame = block((2, 1, 1), drawn_rng), lame_parameters(YOUNG, 0.4)
    basis, points, _ = reduced(mesh, law_named("linear").of_moduli(YOUNG, 0.4), drawn_rng)
    (cells,) = mesh.blocks()
    bound = bind((lambda mesh, free, made: StrainRateDamping(mesh, free, lame, 0.1), cells.mesh,
                  YOUNG, 0.4))  # fmt: skip
    nodes = np.arange(MODES // 3)
    term, (whole,) = ReducedStrainRateDamping(points, lame, 0.1, nodes, nodes), bound.terms
    begin, q = 2e-4 * drawn_rng.standard_normal((2, MODES))
    term.begin_step(begin.reshape(-1, 3), None, 0.01)
    whole.begin_step(mesh.node_positions + basis @ begin, None, 0.01)
    forces = forces_of(whole, mesh.node_positions + basis @ q)
    expected = np.einsum("nim,ni->m", basis, forces)
    np.testing.assert_allclose(
        forces_of(term, q.reshape(-1, 3)).ravel(), expected, atol=1e-10 * np.abs(expected).max())
