"""Meshes of hexahedra, alone and beside tetrahedra: surfaces, points in them, files."""

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.hexahedral_mesh import (
    INTO_TETS,
    HexahedralMesh,
    scaled_jacobians,
)
from softrobot_twin.geometry.mass_properties import surface_mass_properties
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.point_location import extrapolated_weights, locate_points

FORMATS = {".vtk": {}, ".vtu": {}, ".inp": {}, ".msh": {"file_format": "gmsh22", "binary": False}}


def shaken(seed=0, cells=(4, 2, 2), mixed=False):
    """A block of 10 mm cells whose nodes are moved about; half of it may be tetrahedra."""
    grid = read_box(0.01 * np.array(cells), cells, of_hexahedra=True).mesh
    shift = 0.0015 * np.random.default_rng(seed).uniform(-1, 1, grid.node_positions.shape)
    cut = np.zeros(len(grid.hexahedra), bool)
    if mixed:
        cut = grid.node_positions[grid.hexahedra].mean(axis=1)[:, 0] > 0.02
    tets = grid.hexahedra[cut][:, INTO_TETS].reshape(-1, 4)
    return HexahedralMesh(grid.node_positions + shift, tets, grid.hexahedra[~cut])


def written(path, mesh, hexahedra=None, **extra):
    cells = [("hexahedron", mesh.hexahedra if hexahedra is None else hexahedra)]
    if len(mesh.tets):
        cells.append(("tetra", mesh.tets))
    content = meshio.Mesh(mesh.node_positions, cells, **extra)
    meshio.write(path, content, **FORMATS[path.suffix])
    return path


@pytest.mark.parametrize("mixed", [False, True])
def test_the_surface_is_closed_and_points_outwards(mixed):
    mesh = shaken(mixed=mixed)
    closed_surface(mesh.surface_triangles, mesh.node_count)
    volume, _, _ = surface_mass_properties(mesh.node_positions, mesh.surface_triangles)
    assert volume == pytest.approx(mesh.volume, rel=0.05)
    assert len(mesh.surface_triangles) == 2 * (2 * 4 + 4 * 8)
    owned = mesh.cells[mesh.cells_of_surface]
    for triangle, cell in zip(mesh.surface_triangles, owned, strict=True):
        assert np.isin(triangle, cell).all()


def test_equal_diagonals_are_chosen_by_the_lowest_node_and_others_by_length():
    cube = read_box((1.0, 1.0, 1.0), (1, 1, 1), of_hexahedra=True).mesh
    for triangle in cube.surface_triangles.reshape(-1, 2, 3):
        assert all(np.unique(triangle).min() in half for half in triangle)
    x = cube.node_positions.copy()
    x[7] += 0.2
    stretched = HexahedralMesh(x, cube.tets, cube.hexahedra)
    triangles = stretched.surface_triangles.reshape(-1, 2, 3)
    for pair in triangles[(triangles == 7).any(axis=(1, 2))]:
        assert (pair == 7).any(axis=1).sum() == 1


@pytest.mark.parametrize("place", [0.0, 100.0])
@pytest.mark.parametrize("mixed", [False, True])
def test_points_are_where_their_weights_put_them(mixed, place):
    mesh = shaken(1, mixed=mixed)
    mesh = HexahedralMesh(mesh.node_positions + place, mesh.tets, mesh.hexahedra)
    low, high = mesh.bounding_box
    points = np.random.default_rng(2).uniform(low - 0.005, high + 0.005, (500, 3))
    found = locate_points(mesh, points)
    at = np.einsum("pa,pai->pi", found.barycentric_weights, mesh.node_positions[found.nodes])
    np.testing.assert_allclose(np.linalg.norm(at - points, axis=1), found.distances, atol=1e-12)
    assert 100 < np.count_nonzero(found.distances == 0.0) < 400
    assert found.barycentric_weights.min() >= 0.0
    np.testing.assert_allclose(found.barycentric_weights.sum(axis=1), 1.0)
    carried = mesh.carriers(found.cells, found.barycentric_weights)
    np.testing.assert_array_equal(carried[0], found.nodes)


def test_a_point_made_of_reference_coordinates_is_found_in_its_cell():
    from softrobot_twin.geometry.shape_functions import TRILINEAR_HEXAHEDRON

    mesh = shaken(3)
    rng = np.random.default_rng(4)
    cells = rng.integers(len(mesh.hexahedra), size=200)
    weights = TRILINEAR_HEXAHEDRON.values(rng.uniform(-0.98, 0.98, (200, 3)))
    points = np.einsum("pa,pai->pi", weights, mesh.node_positions[mesh.hexahedra[cells]])
    found = locate_points(mesh, points)
    np.testing.assert_array_equal(found.cells, cells)
    np.testing.assert_allclose(found.barycentric_weights, weights, atol=1e-9)


@pytest.mark.parametrize("mixed", [False, True])
def test_points_outside_follow_the_nearest_cell(mixed):
    mesh = shaken(5, mixed=mixed)
    low, high = mesh.bounding_box
    points = np.random.default_rng(6).uniform(low - 0.01, high + 0.01, (300, 3))
    found = locate_points(mesh, points)
    weights = extrapolated_weights(mesh, found, points)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = mesh.node_positions @ turn.T + [1.0, 2.0, 3.0]
    at = np.einsum("pa,pai->pi", weights, moved[found.nodes])
    np.testing.assert_allclose(at, points @ turn.T + [1.0, 2.0, 3.0], atol=1e-12)


def test_the_scaled_jacobian_of_a_box_is_one():
    boxes = read_box((1.0, 3.0, 0.2), (2, 2, 2), of_hexahedra=True).mesh
    assert scaled_jacobians(boxes.node_positions[boxes.hexahedra]) == pytest.approx(1.0)
    assert (scaled_jacobians(shaken().node_positions[shaken().hexahedra]) < 0.95).any()


# --- files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("mixed", [False, True])
def test_every_format_gives_the_same_mesh(suffix, mixed, tmp_path):
    mesh = shaken(7, mixed=mixed)
    reading = read_solid_mesh(written(tmp_path / f"body{suffix}", mesh), scale=0.5)
    assert reading.notes == ()
    np.testing.assert_allclose(reading.mesh.node_positions, 0.5 * mesh.node_positions)
    np.testing.assert_array_equal(reading.mesh.hexahedra, mesh.hexahedra)
    np.testing.assert_array_equal(reading.mesh.tets, mesh.tets)


def test_mirrored_hexahedra_are_repaired_and_repeated_ones_dropped(tmp_path):
    mesh = shaken(8)
    hexahedra = np.vstack([mesh.hexahedra, mesh.hexahedra[3][[1, 2, 3, 0, 5, 6, 7, 4]]])
    hexahedra[2] = hexahedra[2][[4, 5, 6, 7, 0, 1, 2, 3]]
    reading = read_solid_mesh(written(tmp_path / "body.vtk", mesh, hexahedra))
    assert reading.notes == (
        "Dropped 1 hexahedron (16) that the file contains more than once.",
        "Reoriented 1 inverted hexahedron (2).",
    )
    assert reading.mesh.volume == pytest.approx(mesh.volume)


def test_parts_that_touch_are_joined(tmp_path):
    mesh = shaken(9, cells=(2, 1, 1))
    apart = np.arange(16).reshape(2, 8)
    points = mesh.node_positions[mesh.hexahedra].reshape(-1, 3)
    two = HexahedralMesh(points, np.empty((0, 4)), apart)
    path = written(tmp_path / "body.vtk", two)
    assert "Merged 4 nodes" in read_solid_mesh(path).notes[0]
    kept = read_solid_mesh(path, merge_tolerance=0.0).notes
    assert any("2 separate parts" in note for note in kept)


def test_cells_that_share_only_an_edge_are_reported(tmp_path):
    grid = read_box((2.0, 2.0, 1.0), (2, 2, 1), of_hexahedra=True).mesh
    hinge = HexahedralMesh(grid.node_positions, grid.tets, grid.hexahedra[[0, 3]])
    notes = read_solid_mesh(written(tmp_path / "body.vtk", hinge)).notes
    assert any("connected by edges or single nodes only" in note for note in notes)


def test_skewed_hexahedra_are_reported(tmp_path):
    cube = read_box((1.0, 1.0, 1.0), (1, 1, 1), of_hexahedra=True).mesh
    x = cube.node_positions.copy()
    x[:, 0] += 20.0 * x[:, 2]
    path = written(tmp_path / "body.vtk", HexahedralMesh(x, cube.tets, cube.hexahedra))
    (note,) = read_solid_mesh(path).notes
    assert "Kept 1 hexahedron (0) with a scaled Jacobian below 0.1 (lowest 0.05)" in note


def test_named_regions_and_surfaces_of_quadrilaterals_are_read(tmp_path):
    mesh = shaken(10, mixed=True)
    soft, stiff = np.arange(0, 8, 2), np.arange(1, 8, 2)
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    content = meshio.Mesh(
        mesh.node_positions, [("hexahedron", mesh.hexahedra), ("tetra", mesh.tets), ("quad", quads)],
        cell_data={"gmsh:physical": [np.isin(np.arange(8), stiff) + 1, np.full(len(mesh.tets), 3),
                                     np.full(2, 4)],
                   "gmsh:geometrical": [np.ones(8, int), np.ones(len(mesh.tets), int),
                                        np.ones(2, int)]},
        field_data={"soft": np.array([1, 3]), "stiff": np.array([2, 3]), "tets": np.array([3, 3]),
                    "wall": np.array([4, 2])},
    )  # fmt: skip
    meshio.write(tmp_path / "body.msh", content, file_format="gmsh22", binary=False)
    reading = read_solid_mesh(tmp_path / "body.msh")
    count = len(mesh.tets)
    np.testing.assert_array_equal(reading.parts.region("tets"), np.arange(count))
    np.testing.assert_array_equal(reading.parts.region("soft"), count + soft)
    np.testing.assert_array_equal(reading.parts.region("stiff"), count + stiff)
    assert len(reading.parts.surface("wall")) == 4
    assert set(reading.parts.surface("wall").ravel()) == set(quads.ravel())


def test_abaqus_names_of_hexahedra_are_known(tmp_path):
    mesh = shaken(11)
    plain = written(tmp_path / "body.inp", mesh).read_text()
    assert "C3D8RH" in plain
    for kind in ("C3D8I", "C3D8R", "C3D8H"):
        other = tmp_path / f"{kind}.inp"
        other.write_text(plain.replace("C3D8RH", kind))
        np.testing.assert_array_equal(read_solid_mesh(other).mesh.hexahedra, mesh.hexahedra)


CUBE = read_box((1.0, 1.0, 1.0), (1, 1, 1), of_hexahedra=True).mesh


CUBE_CELL = ("hexahedron", CUBE.hexahedra)
FLAT, FOLDED = CUBE.node_positions * [1.0, 1.0, 0.0], CUBE.node_positions.copy()
FOLDED[CUBE.hexahedra[0, 6]] = [0.3, 0.3, 1.0]  # a corner on a face
BESIDE = np.vstack([CUBE.node_positions, [[2.0, 0.6, 0.5], [2.0, 0.4, 0.5]]])
BOTH_DIAGONALS = [[*CUBE.hexahedra[0, [1, 2, 6]], 8], [*CUBE.hexahedra[0, [2, 6, 5]], 9]]
FLAT_TOLD = "hexahedron 0 is flat or inside out in a corner"


@pytest.mark.parametrize("points, cells, told", [
    *((CUBE.node_positions, cells, told) for cells, told in (
        ([CUBE_CELL, ("wedge", [[0, 1, 2, 4, 5, 6]])],
         "hexahedra of 8 (1 wedge), which are not simulated"),
        ([CUBE_CELL, ("pyramid", [[0, 1, 3, 2, 4]])],
         "hexahedra of 8 (1 pyramid), which are not simulated"),
        ([("hexahedron20", np.arange(20)[None] % 8)],
         "(1 hexahedron20), which are not simulated"),
        ([("hexahedron", CUBE.hexahedra[:, [0, 1, 2, 2, 4, 5, 6, 6]])],
         "hexahedron 0 has a node twice: a wedge or pyramid written as a hexahedron"),
        ([("hexahedron", CUBE.hexahedra[:, [0, 2, 1, 3, 4, 5, 6, 7]])],
         f"{FLAT_TOLD}: are its nodes in the order"),
        ([("hexahedron", CUBE.hexahedra + 1)], "hexahedron 0 has the nodes"),
        ([CUBE_CELL, ("tetra10", [[0, 1, 2, 4, 3, 5, 6, 7, 0, 1]])],
         "tetrahedra of 10 nodes beside hexahedra of 8"))),
    (FOLDED, [CUBE_CELL], FLAT_TOLD), (FLAT, [CUBE_CELL], FLAT_TOLD),
    (BESIDE, [CUBE_CELL, ("tetra", BOTH_DIAGONALS)],
     "along both of its diagonals, which is not simulated"),
])  # fmt: skip
def test_cells_that_are_not_simulated_are_refused_by_name(points, cells, told, tmp_path):
    path = tmp_path / "body.vtk"
    meshio.write(path, meshio.Mesh(points, [(kind, np.asarray(rows)) for kind, rows in cells]))
    with pytest.raises(MeshError) as caught:
        read_solid_mesh(path)
    assert told in str(caught.value) and caught.value.path == path


def test_half_a_face_may_be_covered_by_a_tetrahedron(tmp_path):
    x = np.vstack([CUBE.node_positions, [[2.0, 0.6, 0.5]]])
    a, b, c = CUBE.hexahedra[0, [1, 2, 6]]
    path = tmp_path / "body.vtk"
    cells = [("hexahedron", CUBE.hexahedra), ("tetra", np.array([[a, b, c, 8]]))]
    meshio.write(path, meshio.Mesh(x, cells))
    mesh = read_solid_mesh(path).mesh
    closed_surface(mesh.surface_triangles, mesh.node_count)
    assert len(mesh.surface_triangles) == 5 * 2 + 1 + 3
    assert mesh.volume == pytest.approx(1.0 + 1.0 / 6.0)
