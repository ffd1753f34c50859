"""Published and closed-form problems of rubber: values, and the order at which Newton converges.

Loads that scenes have no entry for are dead loads, and prescribed positions, of `Specimen`.
"""

import numpy as np
import pytest
from locking_study import COOK_SHEAR, cook
from specimens import (
    Specimen,
    mapped_mesh,
    mesh_of,
    quadratic_constant,
    traction_loads,
)

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.smoothed_mesh import edge_rings
from softrobot_twin.mechanics.laws.neo_hookean import NeoHookean

pytestmark = pytest.mark.exhaustive

RUBBER = NeoHookean(1.0, 1.0e4)
STRETCHES = (1.1, 1.5, 2.0, 3.0)


def law_of(poisson, shear=COOK_SHEAR):
    return NeoHookean(shear, 2.0 * shear * (1.0 + poisson) / (3.0 - 6.0 * poisson))


def assert_quadratic(specimen):
    """Newton's method squares corrections, in units of √µV, by less than 10 √κ/µ.

    A move that changes no shape by first order changes volumes by second order, so √κ/µ is natural.
    """
    sizes, law = specimen.decrements, specimen.law
    unit = np.sqrt(law.shear_modulus * specimen.mesh.volume)
    most = 10.0 * np.sqrt(law.bulk_modulus / law.shear_modulus)
    assert quadratic_constant(sizes) * unit < most, sizes
    assert sizes[-1] < 1e-6 * sizes[0]


@pytest.mark.parametrize("kind, count, poisson, share", [
    ("quadratic", 8, 0.3, 0.01), ("quadratic", 8, 0.4999, 0.02), ("hexahedral", 12, 0.3, 0.015),
    ("hexahedral", 12, 0.4999, 0.03), ("linear", 16, 0.4999, 0.07), ("smoothed", 16, 0.3, 0.01),
    ("smoothed", 16, 0.4999, 0.02),
])  # fmt: skip
def test_cooks_membrane(kind, count, poisson, share):
    expected = {0.3: (8.765, 8.97), 0.4999: (6.92, 6.95)}[poisson]
    found = cook(kind, count, poisson)
    assert (found.corner, found.middle) == pytest.approx(expected, rel=share)
    assert_quadratic(found.specimen)


def test_cooks_membrane_of_linear_tetrahedra_locks_without_patches():
    assert cook("linear", 8, 0.4999, by_patches=False).corner < 0.35 * 6.92
    assert cook("linear", 8, 0.4999).corner > 0.75 * 6.92


@pytest.fixture(scope="module")
def compressed_block():
    """Shortening [%] by p/p₀ of a block under a load on a quarter of its face, top held across."""
    mesh = mapped_mesh("quadratic", (4, 4, 4), lambda points: points.copy())
    x = mesh.node_positions
    held, top = np.abs(x) < 1e-9, x[:, 2] > 1.0 - 1e-9
    held[top, :2] = True
    loads = traction_loads(mesh, top & (x[:, :2] < 0.5 + 1e-9).all(axis=1), (0.0, 0.0, -4.0))
    block = Specimen(mesh, law_of(0.4999), np.zeros(len(x), bool), held)
    centre, found = int(np.argmin(np.linalg.norm(x - [0.0, 0.0, 1.0], axis=1))), {}
    for level in (20, 40, 60, 80):
        for part in (0.25, 0.5, 0.75, 1.0):
            block.solve(loads * (level - 20.0 + 20.0 * part))
        found[level] = 100.0 * (1.0 - block.positions[centre, 2])
        assert_quadratic(block)
    return found


NOT_CLOSED = pytest.mark.xfail(
    strict=True, reason="69.3 to 69.5 % on meshes of 4, 6 and 8 cells: see docs/elements.md"
)


@pytest.mark.parametrize("level, shortening", [
    (20, 22.0), (40, 42.6), (60, 58.8), pytest.param(80, 70.1, marks=NOT_CLOSED),
])  # fmt: skip
def test_a_block_is_compressed(compressed_block, level, shortening):
    assert compressed_block[level] == pytest.approx(shortening, abs=0.5)


def shell_octant(kind, count, layers):
    """An eighth of a spherical shell, radii 1 and 2, of three blocks."""
    grid = read_box((1.0, 1.0, 1.0), (count, count, layers), of_hexahedra=True).mesh

    def place(points):
        face = np.floor(0.5 * points[:, 0] + 1e-9).astype(int)
        across = np.tan(0.25 * np.pi * np.column_stack([points[:, 0] - 2.0 * face, points[:, 1]]))
        one, (a, b) = np.ones(len(points)), across.T
        ways = np.stack([np.column_stack(c) for c in ((one, a, b), (a, one, b), (a, b, one))])
        way = ways[face, np.arange(len(points))]
        return way / np.linalg.norm(way, axis=1)[:, None] * (2.0 ** points[:, 2])[:, None]

    def between(a, b):
        lengths = [np.linalg.norm(ends, axis=1, keepdims=True) for ends in (a, b)]
        way = a / lengths[0] + b / lengths[1]
        return way / np.linalg.norm(way, axis=1, keepdims=True) * np.sqrt(lengths[0] * lengths[1])

    grids = [HexahedralMesh(grid.node_positions + [2.0 * face, 0.0, 0.0], grid.tets, grid.hexahedra)
             for face in range(3)]  # fmt: skip
    return mesh_of(kind, grids, place, between)


def inflated(mesh, radii, power, held, area):
    """P/µ at each stretch of the inner wall, which is moved outwards; and the specimen.

    Args:
        mesh: The shell.
        radii: Distance of each node from centre or axis.
        power: Three for a sphere, two for a cylinder.
        held: Coordinates on rollers.
        area: Of the inner wall at rest.
    """
    x, inner = mesh.node_positions, radii < 1.0 + 1e-6
    moving = np.ones(3) if power == 3 else np.array([1.0, 1.0, 0.0])

    def grown(stretch):
        scale = (radii**power + stretch**power - 1.0) ** (1.0 / power) / radii
        return x * np.where(moving > 0.0, scale[:, None], 1.0)

    specimen, last, found = Specimen(mesh, RUBBER, inner, held), 1.0, []
    for stretch in STRETCHES:
        specimen.positions = specimen.positions + grown(stretch) - grown(last)
        specimen.positions[inner], last = grown(stretch)[inner], stretch
        specimen.solve(scale=1.0)
        assert_quadratic(specimen)
        # The work of the wall by its radius, over the volume that it sweeps.
        work = np.sum(specimen.reactions()[inner] * (x * moving)[inner])
        found.append(work / (area * stretch ** (power - 1)))
    return np.array(found)


@pytest.mark.parametrize("kind, count, share", [
    ("quadratic", 3, 0.01), ("linear", 6, 0.025), ("smoothed", 6, 0.022),
])  # fmt: skip
def test_a_sphere_is_inflated(kind, count, share):
    mesh = shell_octant(kind, count, count)
    x = mesh.node_positions
    found = inflated(mesh, np.linalg.norm(x, axis=1), 3, np.abs(x) < 1e-9, 0.5 * np.pi)
    np.testing.assert_allclose(found, [0.28716, 0.75543, 0.80693, 0.63451], rtol=share)


@pytest.mark.parametrize("kind, count, share", [
    ("quadratic", 3, 0.01), ("linear", 8, 0.02), ("smoothed", 8, 0.015),
])  # fmt: skip
def test_a_cylinder_is_inflated(kind, count, share):
    """A quarter of a ring in plane strain."""
    thick = 0.3

    def place(points):
        angle, radius = 0.5 * np.pi * points[:, 0], 2.0 ** points[:, 1]
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        return np.column_stack([x, y, thick * points[:, 2]])

    mesh = mapped_mesh(kind, (count, count, 1), place)
    x = mesh.node_positions
    held = np.abs(x) < 1e-9
    held[:, 2] = True
    found = inflated(mesh, np.linalg.norm(x[:, :2], axis=1), 2, held, 0.5 * np.pi * thick)
    np.testing.assert_allclose(found, [0.13156, 0.42823, 0.57405, 0.66042], rtol=share)


def test_a_thin_balloon():
    """P R / 2µH = 1/λ - 1/λ⁷ of the membrane, and its maximum, with a wall of 2 % of the radius."""
    wall = 0.02
    grid = shell_octant("quadratic", 4, 1)
    x = grid.node_positions
    radii = np.linalg.norm(x, axis=1, keepdims=True)
    thin = x / radii * (1.0 + wall * np.log2(radii))
    mesh = grid.__class__(grid.corner_mesh.__class__(thin[: grid.corner_mesh.node_count],
                                                     grid.corner_mesh.cells),
                          thin, grid.cells.copy(), grid.mid_edge_ends.copy())  # fmt: skip
    held, radii = np.abs(thin) < 1e-9, np.linalg.norm(thin, axis=1)
    inner = radii < 1.0 + 1e-6
    balloon, found, last = Specimen(mesh, RUBBER, inner, held), [], 1.0
    stretches = (1.1, 1.3, 1.38309, 1.5, 2.0)

    def grown(stretch):
        return thin * ((radii**3 + stretch**3 - 1.0) ** (1.0 / 3.0) / radii)[:, None]

    for stretch in stretches:
        balloon.positions = balloon.positions + grown(stretch) - grown(last)
        balloon.positions[inner], last = grown(stretch)[inner], stretch
        balloon.solve(scale=wall)
        work = np.sum(balloon.reactions()[inner] * thin[inner])
        # Radius and stretch are those of the middle of the wall.
        found.append(work / (0.5 * np.pi * stretch**2) / (2.0 * wall) * (1.0 + 0.5 * wall))
    own = 1.0 + 0.5 * wall
    middle = [(own**3 + s**3 - 1.0) ** (1.0 / 3.0) / own for s in stretches]
    expected = np.array([1.0 / s - 1.0 / s**7 for s in middle])
    np.testing.assert_allclose(found, expected, rtol=0.02)
    assert np.argmax(found) == 2 and found[2] == pytest.approx(0.61973, rel=0.02)
    assert_quadratic(balloon)


def disc(kind, count, layers):
    """A cylinder of radius and length one: a square inside, and four blocks around it."""
    half = 0.5
    inside, ring = (read_box((1.0, 1.0, 1.0), (count, n, layers), of_hexahedra=True).mesh for n in (count, count // 2))

    def place(points):
        number = np.floor(0.5 * points[:, 0] + 1e-9).astype(int)
        u, v = 2.0 * (points[:, 0] - 2.0 * number) - 1.0, points[:, 1]
        core = half * np.column_stack([u, 2.0 * v - 1.0])
        arc = np.column_stack([np.sin(0.25 * np.pi * u), np.cos(0.25 * np.pi * u)])
        side = np.column_stack([half * u, np.full(len(u), half)])
        side += (arc - side) * v[:, None]
        turn = -0.5 * np.pi * (number - 1)
        c, s = np.round(np.cos(turn)), np.round(np.sin(turn))
        outer = np.column_stack([c * side[:, 0] - s * side[:, 1], s * side[:, 0] + c * side[:, 1]])
        return np.column_stack([np.where((number == 0)[:, None], core, outer), points[:, 2]])

    def between(a, b):
        middle = 0.5 * (a + b)
        rim = (np.linalg.norm([a[:, :2], b[:, :2]], axis=2) > 1.0 - 1e-9).all(axis=0)
        middle[rim, :2] /= np.linalg.norm(middle[rim, :2], axis=1)[:, None]
        return middle

    grids = [HexahedralMesh(grid.node_positions + [2.0 * k, 0.0, 0.0], grid.tets, grid.hexahedra)
             for k, grid in enumerate([inside, ring, ring, ring, ring])]  # fmt: skip
    return mesh_of(kind, grids, place, between)


@pytest.mark.parametrize("kind, count, layers, share", [
    ("quadratic", 4, 2, 0.01), ("smoothed", 8, 4, 0.03),
])  # fmt: skip
def test_a_cylinder_is_twisted_at_fixed_length(kind, count, layers, share):
    """Rivlin: M = πµψR⁴/2, and the ends press with πµψ²R⁴/4."""
    mesh = disc(kind, count, layers)
    x = mesh.node_positions
    ends, top = np.abs(x[:, 2] - 0.5) > 0.5 - 1e-9, x[:, 2] > 1.0 - 1e-9
    cylinder = Specimen(mesh, RUBBER, ends)

    def twisted(twist):
        c, s = np.cos(twist * x[:, 2]), np.sin(twist * x[:, 2])
        return np.column_stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]])

    last = 0.0
    for twist in (0.5, 1.0):
        cylinder.positions = cylinder.positions + twisted(twist) - twisted(last)
        cylinder.positions[ends], last = twisted(twist)[ends], twist
        cylinder.solve(scale=1.0)
        assert_quadratic(cylinder)
        force, at = cylinder.reactions()[top], cylinder.positions[top]
        moment = np.sum(at[:, 0] * force[:, 1] - at[:, 1] * force[:, 0])
        assert moment == pytest.approx(0.5 * np.pi * twist, rel=share)
        assert force[:, 2].sum() == pytest.approx(-0.25 * np.pi * twist**2, rel=2.0 * share)


ELASTICA = {1: (0.30172, 0.05643), 2: (0.49346, 0.16064), 5: (0.71379, 0.38763), 10: (0.81061, 0.55500)}


@pytest.mark.parametrize("kind, count, share", [("smoothed", 4, 0.01), ("quadratic", 2, 0.02)])
def test_a_cantilever_under_a_tip_load_is_the_elastica(kind, count, share):
    """PL²/EI against deflection and approach of the tip, both by the length; ν = 0."""
    thick, law = 0.05, NeoHookean(1.0, 2.0 / 3.0)
    mesh = mapped_mesh(kind, (10 * count, count, count), lambda points: points * [1.0, thick, thick])
    x = mesh.node_positions
    tip = x[:, 0] > 1.0 - 1e-9
    loads = traction_loads(mesh, tip, (0.0, 0.0, 2.0 * thick**2 / 12.0))
    beam = Specimen(mesh, law, x[:, 0] < 1e-9)
    for load in (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0):
        beam.solve(load * loads)
        if load in ELASTICA:
            moved = (beam.positions - x)[tip].mean(axis=0)
            assert (moved[2], -moved[0]) == pytest.approx(ELASTICA[load], rel=share)


def le10_plate(kind, cells):
    """The plate of NAFEMS LE10 at rest, its restraints and 1 MPa on it, and its point D."""

    def place(points):
        angle, out = 0.5 * np.pi * points[:, 0], points[:, 1:2] ** 1.3
        inner = np.column_stack([2.0 * np.cos(angle), np.sin(angle)])
        outer = np.column_stack([3.25 * np.cos(angle), 2.75 * np.sin(angle)])
        return np.column_stack([inner + (outer - inner) * out, 0.6 * points[:, 2]])

    mesh = mapped_mesh(kind, cells, place)
    x = mesh.node_positions
    rim = np.abs((x[:, 0] / 3.25) ** 2 + (x[:, 1] / 2.75) ** 2 - 1.0) < 1e-6
    held = np.abs(x) < 1e-9
    held[:, 2] = rim & (np.abs(x[:, 2] - 0.3) < 1e-9)
    held[rim, :2] = True
    loads = traction_loads(mesh, x[:, 2] > 0.6 - 1e-9, (0.0, 0.0, -1e6))
    plate = Specimen(mesh, LE10_STEEL, np.zeros(len(x), bool), held, by_patches=False)
    plate.solve(loads)
    # Strains are so small that the second correction is the last one.
    assert plate.decrements[1] < 1e-3 * plate.decrements[0]
    point = int(np.argmin(np.linalg.norm(x - [2.0, 0.0, 0.6], axis=1)))
    assert np.linalg.norm(x[point] - [2.0, 0.0, 0.6]) < 1e-9
    return plate, point


LE10_STEEL = NeoHookean(210e9 / 2.6, 210e9 / 1.2)


def stress_yy(moved):
    """σ_yy [Pa] of a gradient of displacements."""
    shear, bulk = LE10_STEEL
    return 2.0 * shear * moved[1, 1] + (bulk - 2.0 * shear / 3.0) * np.trace(moved)


def test_nafems_le10():
    """A thick elliptic plate under 1 MPa, as soft as steel: σ_yy = -5.38 MPa at the point D."""
    plate, point = le10_plate("quadratic", (8, 5, 4))
    mesh, x = plate.mesh, plate.mesh.node_positions
    corners, stresses = np.vstack([np.zeros(3), np.eye(3)]), []
    for cell in mesh.cells[(mesh.cells == point).any(axis=1)]:
        slopes = mesh.shape_functions.slopes(corners[cell[:4] == point])[0]
        gradients = slopes @ np.linalg.inv(x[cell].T @ slopes)
        stresses.append(stress_yy((plate.positions - x)[cell].T @ gradients))
    assert np.mean(stresses) == pytest.approx(-5.38e6, rel=0.025)


def test_nafems_le10_of_smoothed_tetrahedra():
    """Rings around D have their mean beside it: the error falls with the size, to nothing."""
    found = []
    for cells in ((8, 5, 4), (16, 10, 8)):
        plate, point = le10_plate("smoothed", cells)
        rings, moves = edge_rings(plate.mesh), plate.positions - plate.mesh.node_positions
        around = (rings.cells == point).any(axis=1)
        gradients = np.einsum("eai,eaj->eij", moves[rings.cells], rings.points.gradients[:, 0])
        stresses = [stress_yy(gradient) for gradient in gradients[around]]
        found.append(np.average(stresses, weights=rings.points.weights[around, 0]))
    coarse, fine = found
    assert coarse > fine > -5.38e6
    assert 2.0 * fine - coarse == pytest.approx(-5.38e6, rel=0.025)
