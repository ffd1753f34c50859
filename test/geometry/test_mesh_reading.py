import math
import random

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from test.builder import builder

pytestmark = pytest.mark.libraries

CORNERS, ONE_TET = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float), [[0, 1, 2, 3]]
FORMATS = {
    "msh 2.2 ascii": (".msh", {"file_format": "gmsh22", "binary": False}),
    "msh 2.2 binary": (".msh", {"file_format": "gmsh22", "binary": True}),
    "msh 4.1 ascii": (".msh", {"file_format": "gmsh", "binary": False}),
    "msh 4.1 binary": (".msh", {"file_format": "gmsh", "binary": True}),
    "vtk 4.2 ascii": (".vtk", {"file_format": "vtk42", "binary": False}),
    "vtk 4.2 binary": (".vtk", {"file_format": "vtk42", "binary": True}),
    "vtk 5.1 binary": (".vtk", {"file_format": "vtk51", "binary": True}),
    "vtu ascii": (".vtu", {"file_format": "vtu", "binary": False}),
    "vtu compressed": (".vtu", {"file_format": "vtu", "compression": "zlib"}),
    "inp": (".inp", {"file_format": "abaqus"}),
    "xml under .vtk": (".vtk", {"file_format": "vtu"}),
}


def write(path, points, cells, **options):
    formats = {".vtk": "vtk42", ".msh": "gmsh22", ".vtu": "vtu", ".inp": "abaqus"}
    options.setdefault("file_format", formats[path.suffix])
    meshio.Mesh(np.asarray(points, float), cells).write(path, **options)
    return path


@builder
def read_tets(tmp_path, /, points, tets, **placement):
    """Reads a file of these tetrahedra."""
    path = write(tmp_path / "body.vtk", points, [("tetra", np.asarray(tets))])
    return read_solid_mesh(path, **placement)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_mesh_without_output(name, block, tmp_path, capfd):
    suffix, options = FORMATS[name]
    mesh = block()
    path = write(tmp_path / f"body{suffix}", mesh.node_positions, [("tetra", mesh.cells)], **options)
    capfd.readouterr()
    reading = read_solid_mesh(path)
    np.testing.assert_allclose(reading.mesh.node_positions, mesh.node_positions, rtol=1e-10)
    np.testing.assert_array_equal(reading.mesh.cells, mesh.cells)
    np.testing.assert_array_equal(reading.file_node_indices, np.arange(mesh.node_count))
    assert capfd.readouterr() == ("", "")
    if name == "xml under .vtk":
        assert reading.notes == ("Read as VTK XML in spite of the suffix '.vtk'.",)
    else:
        assert reading.notes == ()


@pytest.mark.parametrize("suffix", [".msh", ".vtk", ".vtu", ".inp"])
def test_surface_cells_are_dropped_and_counted(suffix, tmp_path):
    cells = [
        ("triangle", np.array([[0, 1, 2], [0, 1, 3]])),
        ("tetra", np.array([[0, 1, 2, 3]])),
        ("line", np.array([[0, 1]])),
    ]
    reading = read_solid_mesh(write(tmp_path / f"body{suffix}", CORNERS, cells))
    assert reading.mesh.cell_count == 1
    assert reading.notes == ("Dropped the cells that are not solid (1 line, 2 triangle).",)


def test_placement_scales_then_turns_about_x_y_z_then_shifts(read_tets):
    points = [[1000, 0, 0], [0, 1000, 0], [0, 0, 1000], [2000, 2000, 2000]]
    placed = read_tets(points, ONE_TET, scale=1e-3, rotation=(math.pi / 2, math.pi / 2, 0),
                       translation=(1, 2, 3))  # fmt: skip
    # About x: y → z, z → −y; then about y: z → x, x → −z.
    expected = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0], [2, -2, -2]]) + [1, 2, 3]
    np.testing.assert_allclose(placed.mesh.node_positions, expected, atol=1e-15)
    assert placed.notes == ()


def test_a_rotation_of_ninety_radians_is_warned_of(read_tets):
    turned = read_tets(CORNERS, ONE_TET, rotation=(0, 0, 90))
    assert "are the angles in degrees?" in turned.notes[0]


def test_inverted_tets_are_repaired_and_reported_by_index(block, read_tets):
    mesh = block()
    tets = mesh.cells.copy()
    tets[[4, 20]] = tets[[4, 20]][:, [0, 2, 1, 3]]
    reading = read_tets(mesh.node_positions, tets)
    np.testing.assert_allclose(reading.mesh.volumes, mesh.volumes)
    assert reading.notes == ("Reoriented 2 inverted tetrahedra (4, 20).",)


def test_flat_tets_are_dropped_and_reported_by_their_number_in_the_file(read_tets):
    reading = read_tets(np.vstack([CORNERS, [1, 1, 0]]), [[0, 1, 2, 4], [0, 2, 1, 3]])
    assert reading.mesh.cell_count == 1
    assert reading.notes == (
        "Dropped 1 tetrahedron (0) without volume.",
        "Reoriented 1 inverted tetrahedron (1).",
        "Dropped 1 node (4) that no tetrahedron uses.",
    )


def test_unused_nodes_are_dropped_and_the_numbers_of_the_file_keep_their_meaning(read_tets):
    points = np.vstack([[9.0, 9, 9], CORNERS[:2], [8.0, 8, 8], CORNERS[2:]])
    reading = read_tets(points, [[1, 2, 4, 5]], scale=0.5)
    assert reading.notes == ("Dropped 2 nodes (0, 3) that no tetrahedron uses.",)
    assert reading.file_node_indices.tolist() == [1, 2, 4, 5]
    assert reading.mesh_node_indices.tolist() == [-1, 0, 1, -1, 2, 3]
    np.testing.assert_allclose(reading.mesh.node_positions, 0.5 * CORNERS)


TWO_PIECES = np.vstack([CORNERS, CORNERS[:3], [0, 0, -1]])
TWO_TETS = np.array([[0, 1, 2, 3], [4, 6, 5, 7]])


def test_touching_parts_are_joined_and_reported(read_tets):
    joined = read_tets(TWO_PIECES, TWO_TETS)
    assert joined.notes == (
        "Merged 3 nodes (4, 5, 6) with coincident ones: they cut the mesh into separate parts "
        "(merge_distance: 0 keeps the cut).",
    )
    assert joined.mesh.cells.tolist() == [[0, 1, 2, 3], [0, 2, 1, 4]]
    assert joined.mesh_node_indices.tolist() == [0, 1, 2, 3, 0, 1, 2, 4]


def test_parts_stay_separate_on_request_and_the_cut_is_reported(read_tets):
    apart = read_tets(TWO_PIECES, TWO_TETS, merge_tolerance=0.0)
    assert apart.mesh.node_count == 8
    assert apart.notes == (
        "The mesh consists of 2 separate parts, of 4, 4 nodes.",
        "Another node coincides with 3 nodes (4, 5, 6): the body is cut there.",
    )
    joined = read_tets(TWO_PIECES, TWO_TETS, merge_tolerance=1e-9)
    assert joined.notes == ("Merged 3 nodes (4, 5, 6) with coincident ones.",)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_mesh_whose_elements_share_no_node_is_merged_into_the_original_mesh(block, read_tets, scale):
    mesh = block()
    points = scale * mesh.node_positions[mesh.cells].reshape(-1, 3).astype(np.float32)
    reading = read_tets(points, np.arange(len(points)).reshape(-1, 4))
    assert reading.mesh.node_count == mesh.node_count
    np.testing.assert_allclose(reading.mesh.volumes, scale**3 * mesh.volumes, rtol=1e-5)
    assert len(reading.notes) == 1 and reading.notes[0].startswith("Merged")


def test_a_cut_within_one_part_is_kept_and_reported(block, read_tets):
    mesh = block(cells=(2, 1, 1), shake=0.0)
    points, tets = mesh.node_positions, mesh.cells.copy()
    # The middle of an edge of the block's waist, for the right half's tetrahedra another node.
    waist = int(np.flatnonzero((points == [0.1, 0.0, 0.0]).all(axis=1))[0])
    right = points[tets].mean(axis=1)[:, 0] > 0.1
    tets[right] = np.where(tets[right] == waist, len(points), tets[right])
    reading = read_tets(np.vstack([points, points[waist]]), tets)
    assert reading.mesh.node_count == len(points) + 1
    assert [note for note in reading.notes if "is cut there" in note]


@pytest.mark.parametrize("shared", [1, 2])
def test_parts_joined_only_at_an_edge_or_a_node_are_reported(shared, read_tets):
    points = np.vstack([CORNERS, -1.0 - CORNERS[shared:]])
    reading = read_tets(points, [[0, 1, 2, 3], [*range(shared), *range(4, 8 - shared)]])
    assert any("at least 1 places" in note and "can rotate" in note for note in reading.notes)


def test_duplicate_tets_are_dropped_and_reported(block, read_tets):
    mesh = block()
    twice = np.vstack([mesh.cells, mesh.cells[[3, 7]][:, [2, 0, 3, 1]]])
    reading = read_tets(mesh.node_positions, twice)
    count = mesh.cell_count
    assert reading.notes == (
        f"Dropped 2 tetrahedra ({count}, {count + 1}) that the file contains more than once.",
    )
    np.testing.assert_allclose(reading.mesh.volumes, mesh.volumes)


def test_a_sliver_is_reported_with_its_quality(read_tets):
    height = 0.002 / 1.5
    sliver = np.array([[6, 0, 0], [4, 0, 0], [5, 1, height], [5, -1, height]])
    reading = read_tets(np.vstack([CORNERS, sliver]), [[0, 1, 2, 3], [4, 5, 7, 6]])
    assert reading.mesh.cell_count == 2
    assert reading.notes[-1] == (
        "Kept 1 tetrahedron (1) with a radius ratio below 0.05 (lowest 0.002, tetrahedron 1): "
        "expect less accuracy there."
    )


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("body.stl", "solid", "end in .msh, .vtk, .vtu, .inp, not in '.stl'"),
        ("body", "", "not in ''"),
        ("body.vtk", "", "starts with ''"),
        ("body.msh", "hello", "starts with 'hello'"),
        ("body.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0", "read as Gmsh"),
        ("body.vtk", "# vtk DataFile Version 3.0\n", "cannot be read as legacy VTK"),
        ("body.vtu", "<VTKFile type='PolyData'></VTKFile>", "cannot be read as VTK XML"),
        ("body.inp", "*NODE\n1,0,0,0\n*ELEMENT,TYPE=C3D4\n1,1,2,3,4\n", "cannot be read as Abaqus"),
    ],
)
def test_an_invalid_mesh_file_is_refused_by_name(name, content, told, tmp_path, capfd):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(MeshError) as caught:
        read_solid_mesh(path)
    assert told in str(caught.value)
    assert caught.value.path == path
    assert capfd.readouterr() == ("", "")


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(MeshError, match=r"nowhere\.vtk: there is no such file"):
        read_solid_mesh(tmp_path / "nowhere.vtk")


@pytest.mark.parametrize("cells, told", [
    ([("triangle", [[0, 1, 2]])], "no tetrahedra or hexahedra, only 1 triangle"),
    ([("pyramid", [range(5)])], "other than tetrahedra of 4 or 10 nodes and hexahedra of 8 (1 pyr"),
    ([("tetra10", [[*range(9), 10]])], "nodes [4, 5, 6, 7, 8, 10] on its edges"),
    ([("tetra", [[0, 1, 2, 3]]), ("wedge", [range(6)])], "(1 wedge)"),
    ([("tetra", [[0, 1, 2, 2]])], "only tetrahedra without volume"),
    ([("tetra", [[0, 1, 2, 30]])], "tetrahedron 0 has the nodes [0, 1, 2, 30]"),
])  # fmt: skip
def test_cells_that_form_no_body_are_refused(cells, told, tmp_path):
    points = np.random.default_rng(6).uniform(size=(10, 3))
    path = write(tmp_path / "body.vtk", points, [(kind, np.array(data)) for kind, data in cells])
    with pytest.raises(MeshError) as caught:
        read_solid_mesh(path)
    assert told in str(caught.value)
    assert caught.value.path == path


def test_a_node_nowhere_is_refused_by_name(read_tets):
    with pytest.raises(MeshError, match="node 2 is at"):
        read_tets([*CORNERS[:2], [0, math.nan, 0], CORNERS[3]], ONE_TET)


# Files of these formats are damaged at random.
FORMATS_TO_DAMAGE = {
    ".msh": {"file_format": "gmsh22", "binary": False}, ".vtk": {"file_format": "vtk42"},
    ".vtu": {"file_format": "vtu", "binary": False}, ".inp": {"file_format": "abaqus"},
}  # fmt: skip
BITS = (b"", b"-1", b"0", b"9" * 12, b"nan", b"1e400", b"x", b" ", b"\n", b"\xff\x00", b"<", b"*")


def torn(content: bytes, chance: random.Random) -> bytes:
    """The content with pieces replaced, or with its end cut off."""
    for _ in range(chance.choice((1, 1, 2, 8))):
        place = chance.randrange(max(len(content), 1))
        if chance.random() < 0.1:
            content = content[: max(place, 1)]
        else:
            end = place + chance.choice((0, 1, 3, 12))
            content = content[:place] + chance.choice(BITS) + content[end:]
    return content


@pytest.mark.parametrize("nodes", [4, 10])
@pytest.mark.parametrize("suffix", FORMATS_TO_DAMAGE)
@pytest.mark.filterwarnings("ignore")
def test_a_truncated_file_is_read_or_refused_by_name(suffix, nodes, block, tmp_path, capfd):
    mesh = block(cells=(1, 1, 2))
    kind = "tetra"
    if nodes == 10:
        mesh, kind = add_mid_edge_nodes(mesh), "tetra10"
    file = tmp_path / f"body{suffix}"
    meshio.Mesh(mesh.node_positions, [(kind, mesh.cells)]).write(file, **FORMATS_TO_DAMAGE[suffix])
    content = file.read_bytes()
    capfd.readouterr()  # of the writer
    chance = random.Random(f"{suffix}{nodes}")
    for _ in range(60):
        file.write_bytes(torn(content, chance))
        try:
            reading = read_solid_mesh(file)
        except MeshError as error:
            assert error.path == file and str(error).startswith(f"{file}: ")
            assert "\n" not in str(error) and len(str(error)) < 600
        else:
            assert (reading.mesh.volumes > 0.0).all()
            assert np.isfinite(reading.mesh.node_positions).all()
    assert capfd.readouterr() == ("", "")
