"""The energy of the volumes of patches: derivatives, balance, stability, and no locking."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws.neo_hookean import NeoHookean
from softrobot_twin.mechanics.patch_volumes import (
    PatchVolumes,
    divided,
    element_bulk,
    patched_cells,
)
from softrobot_twin.mechanics.volume_change import volumetric
from test.builder import builder

BULK, SIZE = 1.0e6, (0.03, 0.02, 0.02)
KINDS = ("linear", "quadratic", "hexahedral")


@builder
def meshes(block, /, kind, cells=(3, 2, 2), size=SIZE, shake=0.2):
    """Makes a block of each kind of elements, its inner nodes moved about."""
    if kind == "hexahedral":
        return read_box(size, cells, of_hexahedra=True).mesh.blocks()[0].mesh
    linear = block(size, cells, shake)
    return linear if kind == "linear" else add_mid_edge_nodes(linear)


@builder
def patched(bind, /, mesh, law=None, fixed=()):
    """Binds the volumes of a mesh, and elements of a law beside them if one is given."""

    def volumes(part, free, _):
        return PatchVolumes(part, free, BULK, patched_cells(part).patches)

    def elements(part, free, _):
        return Elements(part, free, law)

    terms = [volumes] if law is None else [elements, volumes]
    return bind(*((term, mesh, 1.0, 0.3) for term in terms), fixed=fixed)


def moved(mesh, seed, amount=5e-4):
    x = mesh.node_positions
    return x + amount * np.random.default_rng(seed).standard_normal(x.shape)


@pytest.mark.parametrize("kind", KINDS)
def test_forces_and_stiffness_are_the_derivatives_of_the_energy(meshes, patched, kind):
    mesh = meshes(kind)
    bound = patched(mesh, fixed=[0, 1, 5])
    bound.assert_slopes(moved(mesh, 1), bound.free[[0, 7, -1]], step=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_a_rigid_motion_stores_no_energy_and_makes_no_force(meshes, patched, kind):
    mesh = meshes(kind)
    bound = patched(mesh)
    turn = Rotation.from_rotvec(np.radians(179.0) * np.array([0.36, 0.48, 0.8]))
    turned = turn.apply(mesh.node_positions) + [1.0, -2.0, 3.0]
    assert np.abs(bound.forces(turned)[0]).max() < 1e-11 * BULK * SIZE[1] ** 2
    assert abs(bound.terms[0].energy(turned)) < 1e-12 * BULK * np.prod(SIZE)


@pytest.mark.parametrize("kind", KINDS[:2])
def test_forces_of_patches_have_no_resultant_and_no_moment(meshes, patched, kind):
    """Those of hexahedra include inner parameters, which are no forces at points."""
    mesh = meshes(kind)
    x = moved(mesh, 2)
    forces, _ = patched(mesh).forces(x)
    scale = np.abs(forces).sum()
    assert np.abs(forces.sum(axis=0)).max() < 1e-12 * scale
    assert np.abs(np.cross(x, forces).sum(axis=0)).max() < 1e-12 * scale * np.abs(x).max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_uniform_strain_has_the_energy_of_its_volume_and_no_forces_inside(meshes, patched, kind):
    mesh = meshes(kind)
    bound = patched(mesh)
    F = np.eye(3) + np.random.default_rng(3).uniform(-0.2, 0.2, (3, 3))
    x = mesh.node_positions @ F.T
    (term,) = bound.terms
    expected = BULK * np.prod(SIZE) * volumetric(np.linalg.det(F))[0]
    assert term.energy(x) == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(term.volume_ratios(x), np.linalg.det(F), rtol=1e-9)
    forces, _ = bound.forces(x)
    rest = mesh.node_positions
    inside = ((rest > 1e-9) & (rest < np.array(SIZE) - 1e-9)).all(axis=1)
    if kind != "hexahedral":
        assert np.abs(forces[inside]).max() < 1e-10 * np.abs(forces).max()


def test_the_projected_stiffness_of_a_crushed_block_is_positive_semidefinite(meshes, patched):
    mesh = meshes("linear")
    bound = patched(mesh)
    crushed = moved(mesh, 4) * [0.5, 1.1, 1.1]
    exact, projected = bound.least_curvatures(crushed)
    assert exact < -1e-3 and projected > -1e-10


@pytest.mark.parametrize("kind", KINDS)
def test_only_rigid_motion_has_no_stiffness(meshes, patched, kind):
    """No hourglass: elements without any bulk modulus hold shapes, patches volumes."""
    mesh = meshes(kind)
    rubber = NeoHookean(BULK / 5e3, BULK)
    for share in (0.0, element_bulk(mesh)):
        law = divided(rubber, rubber.shear_modulus, share).law
        _, K = patched(mesh, law).assemble(mesh.node_positions)
        values = np.linalg.eigvalsh(K.toarray())
        mu_h = law.shear_modulus * SIZE[0] / 3.0
        assert np.abs(values[:6]).max() < 1e-10 * values[-1]
        assert values[6] > 1e-3 * mu_h


def least_stable_pressure(bound, mesh, law):
    """The inf-sup constant: √ of the least eigenvalue of V^-½ G K⁻¹ Gᵀ V^-½, by µ.

    Where it falls to zero on finer meshes, pressures alternate from patch to patch, unresisted.
    """
    elements, volumes = bound.terms
    x = mesh.node_positions
    _, whole = bound.assemble(x)
    bound.matrix.clear()
    elements.add(x, np.zeros((len(bound.free), 3)), bound.matrix.storage, False)
    own = bound.matrix.matrix().tocsc()
    # At rest the patches add κ Σ g gᵀ/V: its eigenvalues by K are κ times those that are sought.
    low_rank = (whole - own).toarray() / volumes.bulk_modulus
    values = np.linalg.eigvals(spsolve(own, low_rank)).real
    found = np.sort(values)[::-1][: volumes.patch_count]
    return float(np.sqrt(law.shear_modulus * found[-1]))


@pytest.mark.parametrize(
    "kind, counts, least", [("linear", (2, 4), 0.3), ("quadratic", (1, 2), 0.5)]
)
def test_pressures_of_patches_are_stable(meshes, patched, kind, counts, least):
    """Without patches it is 0.01 on four linear cells a side, and less on more."""
    for count in counts:
        mesh = meshes(kind, (count,) * 3, (1.0, 1.0, 1.0), 0.0)
        law = NeoHookean(1.0, 0.5)
        fixed = np.flatnonzero(mesh.node_positions[:, 2] < 1e-9)
        bound = patched(mesh, law, fixed=fixed)
        assert least_stable_pressure(bound, mesh, law) > least


@builder
def deflection(meshes, bind, /, kind, cells, poisson, by_patches):
    """Deflection of a slender cantilever under a small end load, by beam theory's at ν = 0.3."""
    mu = 1.0e6 / (2.0 + 2.0 * poisson)
    law = NeoHookean(mu, 2.0 * mu * (1.0 + poisson) / (3.0 - 6.0 * poisson))
    mesh = meshes(kind, cells, (1.0, 0.05, 0.05), 0.0)
    kept, bulk = divided(law, mu, element_bulk(mesh)) if by_patches else (law, 0.0)
    terms = [lambda part, free, _: Elements(part, free, kept)]
    if by_patches:
        terms.append(lambda part, free, _: PatchVolumes(part, free, bulk, patched_cells(part).patches))
    x = mesh.node_positions
    fixed = np.flatnonzero(x[:, 0] < 1e-9)
    bound = bind(*((term, mesh, 1.0, 0.3) for term in terms), fixed=fixed)
    load = np.where(x[:, 0] > 1.0 - 1e-9, 1.0, 0.0)[:, None] * [0.0, 0.0, 1e-4]
    load /= (load > 0.0).sum()
    bound.assemble(x)
    assert bound.matrix.factor()
    u = bound.matrix.solve(load[bound.free])
    expected = 1e-4 / (3.0 * 1e6 * 0.05**4 / 12.0)
    return np.sum(u * load[bound.free]) / 1e-4 / expected


def test_linear_tetrahedra_with_patches_do_not_lock(deflection):
    """Shear stays too stiff in linear elements; the volume adds nothing to it."""
    coarse = deflection("linear", (40, 2, 2), 0.3, by_patches=False)
    assert deflection("linear", (40, 2, 2), 0.4999, by_patches=False) < 0.1
    for poisson in (0.45, 0.49, 0.4999, 0.499999):
        assert deflection("linear", (40, 2, 2), poisson, by_patches=True) > coarse


def test_quadratic_tetrahedra_with_patches_are_near_beam_theory(deflection):
    for poisson in (0.49, 0.4999, 0.499999):
        assert deflection("quadratic", (20, 1, 1), poisson, by_patches=True) == pytest.approx(
            1.0, abs=0.03
        )


def test_elements_of_a_soft_volume_keep_all_of_it():
    law = NeoHookean(2.0, 0.9)
    assert divided(law, 2.0, 0.5) == (law, 0.0)
    kept, bulk = divided(NeoHookean(2.0, 1e4), 2.0, 0.5)
    assert kept == NeoHookean(2.0, 1.0) and bulk == 9999.0
