"""Named parts of mesh files keep their cells and nodes in every format and after every repair."""

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.surface import boundary_triangles
from test.cad_parts import gmsh_session, need_gmsh

from .test_mesh_reading import FORMATS as MESH_FORMATS

pytestmark = pytest.mark.libraries

# Those that can name parts.
FORMATS = {name: options for name, options in MESH_FORMATS.items() if options[0] in (".msh", ".inp")}
NAMES = {"soft": (1, 3), "stiff": (2, 3), "foot": (3, 2), "rim": (4, 1)}


class Body:
    """A block whose lower half is `stiff`, with the surface `foot` and the edges `rim`."""

    def __init__(self, mesh):
        self.points, self.tets = mesh.node_positions.copy(), mesh.cells.copy()
        low = self.points[self.tets].mean(axis=1)[:, 2] < 0.2
        surface = boundary_triangles(self.tets)
        self.foot = surface[(self.points[surface][:, :, 2] == 0.0).all(axis=1)]
        along = np.flatnonzero((self.points[:, 1:] == 0.0).all(axis=1))
        along = along[np.argsort(self.points[along, 0])]
        self.rim = np.stack([along[:-1], along[1:]], axis=1)
        self.stiff, self.soft = np.flatnonzero(low), np.flatnonzero(~low)

    def shuffled(self, seed):
        order = np.random.default_rng(seed).permutation(len(self.points))
        place = np.argsort(order)
        self.points = self.points[order]
        self.tets, self.foot, self.rim = place[self.tets], place[self.foot], place[self.rim]
        return self

    def write(self, path, names=NAMES, more_points=(), **options):
        points = np.vstack([self.points, np.reshape(more_points, (-1, 3))])
        blocks = [
            ("tetra", self.tets[self.soft]), ("triangle", self.foot),
            ("tetra", self.tets[self.stiff]), ("line", self.rim),
        ]  # fmt: skip
        tags = [names[name][0] for name in ("soft", "foot", "stiff", "rim")]
        dimensions = (3, 2, 3, 1)
        sets, cell_data, point_data = {}, {}, {}
        if options["file_format"] == "abaqus":
            sets = {
                name: [np.arange(len(cells)) if k == index else np.empty(0, int)
                       for k, (_, cells) in enumerate(blocks)]
                for index, name in enumerate(("soft", "foot", "stiff", "rim"))
            }  # fmt: skip
        else:
            numbers = [np.full(len(cells), t) for t, (_, cells) in zip(tags, blocks, strict=True)]
            cell_data = {"gmsh:physical": numbers, "gmsh:geometrical": [n.copy() for n in numbers]}
            entities = list(zip(dimensions, tags, strict=True))
            # In format 4.1 each node belongs to an entity, and each entity has nodes.
            owner = np.minimum(np.arange(len(points)), 3)
            point_data = {"gmsh:dim_tags": np.array(entities)[owner]}
        if options["file_format"] == "gmsh22":
            point_data = {}
        meshio.Mesh(
            points, blocks, cell_data=cell_data, point_data=point_data, cell_sets=sets,
            field_data={} if sets else {name: np.array(of) for name, of in names.items()},
        ).write(path, **options)  # fmt: skip
        return path


def centres(positions, cells):
    """Centres in an order that does not depend on the numbers of cells or nodes."""
    rows = np.round(positions[cells].mean(axis=1), 9)
    return rows[np.lexsort(rows.T)]


def assert_same_parts(reading, body):
    positions, cells = reading.mesh.node_positions, reading.mesh.cells
    parts = reading.parts
    assert sorted(parts.regions) == ["soft", "stiff"] and not parts.unusable
    assert list(parts.surfaces) == ["foot"] and list(parts.edges) == ["rim"]
    for name in ("soft", "stiff"):
        expected = centres(body.points, body.tets[getattr(body, name)])
        np.testing.assert_allclose(centres(positions, cells[parts.region(name)]), expected)
    # The triangles are the same, each with its orientation.
    np.testing.assert_allclose(positions[parts.surface("foot")], body.points[body.foot], atol=1e-12)
    np.testing.assert_allclose(positions[parts.edge_set("rim")], body.points[body.rim], atol=1e-12)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("seed", [None, 4])
def test_every_format_gives_the_same_parts(name, seed, block, tmp_path, capfd):
    suffix, options = FORMATS[name]
    body = Body(block())
    if seed is not None:
        body.shuffled(seed)
    path = body.write(tmp_path / f"body{suffix}", **options)
    capfd.readouterr()
    reading = read_solid_mesh(path)
    assert_same_parts(reading, body)
    assert reading.notes == ()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", FORMATS)
def test_repairs_keep_the_parts(name, block, tmp_path):
    suffix, options = FORMATS[name]
    body = Body(block()).shuffled(5)
    expected = Body(block()).shuffled(5)
    # One inverted tetrahedron, one flat one, a node without tetrahedron, and twice the same one.
    body.tets[body.stiff[3]] = body.tets[body.stiff[3]][[1, 0, 2, 3]]
    flat = body.tets[body.soft[0]][[0, 1, 2, 2]]
    twice = body.tets[body.soft[1]]
    body.tets = np.vstack([body.tets, flat, twice])
    body.soft = np.concatenate([[len(body.tets) - 2], body.soft])
    body.stiff = np.append(body.stiff, len(body.tets) - 1)
    path = body.write(tmp_path / f"body{suffix}", more_points=[9.0, 9.0, 9.0], **options)
    reading = read_solid_mesh(path)
    # The repeated tetrahedron is now one cell of both regions.
    expected.stiff = np.append(expected.stiff, expected.soft[1])
    assert_same_parts(reading, expected)
    assert len(reading.notes) == 4


def test_parts_follow_merged_nodes(block, tmp_path):
    suffix, options = FORMATS["msh 2.2 ascii"]
    body, expected = Body(block()), Body(block())
    # The regions share no node; the foot's and the rim's nodes are those of the stiff one.
    count = len(body.points)
    stiff = np.zeros(len(body.tets), bool)
    stiff[body.stiff] = True
    body.tets[stiff] += count
    body.foot, body.rim = body.foot + count, body.rim + count
    body.points = np.vstack([body.points, body.points])
    reading = read_solid_mesh(body.write(tmp_path / f"body{suffix}", **options))
    assert reading.mesh.node_count == count
    assert_same_parts(reading, expected)


def test_a_surface_beside_the_body_is_refused_by_file_and_name(block, tmp_path):
    body = Body(block())
    body.foot = np.vstack([body.foot, [0, 1, len(body.points)]])
    path = body.write(tmp_path / "body.inp", more_points=[9, 9, 9], **FORMATS["inp"][1])
    reading = read_solid_mesh(path)
    with pytest.raises(MeshError) as caught:
        reading.parts.surface("foot")
    assert caught.value.path == path
    assert f"foot is a surface with node {len(body.points)}, which is not" in str(caught.value)
    assert len(reading.parts.region("stiff")) == len(body.stiff)


def test_an_unknown_part_is_refused_with_the_names_that_are_known(block, tmp_path):
    reading = read_solid_mesh(Body(block()).write(tmp_path / "b.msh", **FORMATS["msh 4.1 ascii"][1]))
    with pytest.raises(MeshError, match="no volume region named hard; of this kind it names soft, "):
        reading.parts.region("hard")
    with pytest.raises(MeshError, match="has no surface named stiff; of this kind it names foot"):
        reading.parts.surface("stiff")


@pytest.mark.parametrize("suffix", [".vtk", ".vtu"])
def test_a_vtk_file_is_told_to_have_no_names(suffix, block, tmp_path):
    mesh = block()
    path = tmp_path / f"body{suffix}"
    data = {"material": [np.arange(mesh.cell_count) % 2], "heat": [np.ones(mesh.cell_count)]}
    meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)], cell_data=data).write(path)
    reading = read_solid_mesh(path)
    with pytest.raises(MeshError, match=r"do not name parts \(it has the numbers material of"):
        reading.parts.region("stiff")


def test_physical_groups_without_names_are_told(block, tmp_path):
    body = Body(block())
    path = tmp_path / "body.msh"
    cells = [("tetra", body.tets)]
    numbers = {"gmsh:physical": [np.full(len(body.tets), 7)],
               "gmsh:geometrical": [np.full(len(body.tets), 7)]}  # fmt: skip
    meshio.Mesh(body.points, cells, cell_data=numbers).write(path, "gmsh22", binary=False)
    with pytest.raises(MeshError, match="its physical groups have numbers but no names"):
        read_solid_mesh(path).parts.region("stiff")


def test_quadratic_elements_have_surfaces_of_corners(block, tmp_path):
    mesh = add_mid_edge_nodes(block())
    foot = Body(block()).foot
    between = {tuple(ends): mesh.corner_mesh.node_count + index
               for index, ends in enumerate(mesh.mid_edge_ends.tolist())}  # fmt: skip
    six = [[*corners, *(between[tuple(sorted((corners[k], corners[(k + 1) % 3])))]
                        for k in range(3))] for corners in foot.tolist()]  # fmt: skip
    order = np.random.default_rng(2).permutation(mesh.node_count)
    place, points = np.argsort(order), mesh.node_positions[order]
    cells = [("triangle6", place[np.array(six)]), ("tetra10", place[mesh.cells])]
    tags = [np.full(len(foot), 1), np.full(mesh.cell_count, 2)]
    meshio.Mesh(
        points, cells, field_data={"foot": np.array([1, 2]), "all": np.array([2, 3])},
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": [t.copy() for t in tags]},
    ).write(tmp_path / "body.msh", "gmsh22", binary=False)  # fmt: skip
    reading = read_solid_mesh(tmp_path / "body.msh")
    np.testing.assert_allclose(
        reading.mesh.node_positions[reading.parts.surface("foot")], mesh.node_positions[foot]
    )
    assert len(reading.parts.region("all")) == mesh.cell_count


# A wall, surface entity 3, between two tetrahedra: it belongs to the skin of the second one with
# the opposite orientation. Two groups of different dimensions have the same name.
GMSH = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
4
2 1 "first"
2 2 "second skin"
3 1 "first"
3 2 "both"
$EndPhysicalNames
$Entities
0 0 1 2
3 0 0 0 1 1 0 2 1 -2 0
1 0 0 0 1 1 1 2 1 2 0
2 0 0 0 1 1 1 1 2 1 3
$EndEntities
$Nodes
1 5 1 5
3 1 0 5
1
2
3
4
5
0 0 0
1 0 0
0 1 0
0 0 1
0 0 -1
$EndNodes
$Elements
3 3 1 3
2 3 2 1
1 1 2 3
3 1 4 1
2 1 2 3 4
3 2 4 1
3 1 3 2 5
$EndElements
"""


def test_a_wall_between_two_gmsh_groups_has_the_orientation_of_each(tmp_path):
    path = tmp_path / "body.msh"
    path.write_text(GMSH)
    reading = read_solid_mesh(path)
    parts = reading.parts
    assert {name: cells.tolist() for name, cells in parts.regions.items()} == {
        "first": [0], "both": [0, 1],
    }  # fmt: skip
    assert {name: rows.tolist() for name, rows in parts.surfaces.items()} == {
        "first": [[0, 1, 2]], "second skin": [[2, 1, 0]],
    }  # fmt: skip
    assert reading.notes == ()


def test_a_gmsh_file_may_name_only_some_of_its_entities(tmp_path):
    path = tmp_path / "body.msh"
    path.write_text(GMSH.replace("1 0 0 0 1 1 1 2 1 2 0", "1 0 0 0 1 1 1 0 0"))
    parts = read_solid_mesh(path).parts
    assert {name: cells.tolist() for name, cells in parts.regions.items()} == {"both": [1]}
    assert parts.surface("second skin").tolist() == [[2, 1, 0]]
    names = GMSH[GMSH.index("$PhysicalNames") : GMSH.index("$Entities")]
    path.write_text(path.read_text().replace(names, ""))
    with pytest.raises(MeshError, match="its physical groups have numbers but no names"):
        read_solid_mesh(path).parts.region("both")


ABAQUS = """*HEADING
** written by hand
*NODE
10, 0, 0, 0
20, 1, 0, 0
30, 0, 1, 0
40, 0, 0, 1
50, 0, 0, -1
*ELEMENT, TYPE=S3, ELSET="lid"
7, 10, 20, 30
*ELEMENT, TYPE=C3D4, ELSET=All
100, 10, 20, 30, 40
*ELSET, ELSET=later, GENERATE
100, 102, 2
7, 7
*ELEMENT, type=c3d4h, ELSET=ALL
** a comment between
102, 10, 30, 20, 50
*ELSET, ELSET=both
lower, LID
*ELSET, ELSET=lower
102,
*NSET, NSET=lower
10, 20
"""


def test_abaqus_sets_of_several_blocks_ranges_and_sets_are_read(tmp_path):
    path = tmp_path / "body.inp"
    path.write_text(ABAQUS)
    parts = read_solid_mesh(path).parts
    assert {name: cells.tolist() for name, cells in parts.regions.items()} == {
        "All": [0, 1], "later": [0, 1], "both": [1], "lower": [1],
    }  # fmt: skip
    assert {name: rows.tolist() for name, rows in parts.surfaces.items()} == {
        "lid": [[0, 1, 2]], "later": [[0, 1, 2]], "both": [[0, 1, 2]],
    }  # fmt: skip


@pytest.mark.parametrize("row", ["nowhere", "103", "both"])
def test_an_abaqus_set_of_unknown_members_is_refused(row, tmp_path):
    path = tmp_path / "body.inp"
    path.write_text(ABAQUS.replace("lower, LID", row))
    with pytest.raises(MeshError, match="cannot be read as Abaqus"):
        read_solid_mesh(path)


def abaqus_part(name, ids=1):
    """A unit tetrahedron as a part, its nodes numbered from `ids`."""
    rows = "".join(f"{ids + k}, {x}, {y}, {z}\n"
                   for k, (x, y, z) in enumerate([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]))
    return (f"*Part, name={name}\n*Node\n{rows}*Element, type=C3D4\n1, {ids}, {ids + 1}, {ids + 2}, "
            f"{ids + 3}\n*Elset, elset=ALL, generate\n1, 1, 1\n*Elset, elset=Again\nall\n*End Part\n")


def test_instances_of_abaqus_parts_are_moved_then_turned(tmp_path):
    path = tmp_path / "two.inp"
    path.write_text(
        "*Heading\n" + abaqus_part("A") + abaqus_part("B", 7) + abaqus_part("Unused")
        + "*Assembly, name=X\n*Instance, name=a-1, part=a\n*End Instance\n"
        "*Instance, name=b-1, part=B\n 5., 0., 0.\n 5., 0., 0., 5., 0., 1., 90.\n*End Instance\n"
        "*Elset, elset=Second, instance=B-1\n 1,\n*Nset, nset=n, instance=a-1\n 1,\n*End Assembly\n")
    reading = read_solid_mesh(path)
    np.testing.assert_allclose(
        reading.mesh.node_positions,
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 0, 0], [5, 1, 0], [4, 0, 0], [5, 0, 1]],
        atol=1e-12)  # fmt: skip
    regions = {name: cells.tolist() for name, cells in reading.parts.regions.items()}
    assert regions == {"a-1.ALL": [0], "a-1.Again": [0], "b-1.ALL": [1], "b-1.Again": [1], "Second": [1]}
    assert reading.notes[0] == "Left out the part unused, which no *Instance places."


@pytest.mark.parametrize("text, told", [
    (abaqus_part("A") + abaqus_part("B"), "the parts a, b, and no *Instance"),
    (abaqus_part("A").replace("*Element", "*Ngen\n1, 2, 1\n*Element"), "*Ngen is not read"),
    (abaqus_part("A").replace("*Node", "*Node, system=C"), "*Node is not read"),
])  # fmt: skip
def test_what_is_not_read_of_abaqus_is_refused_by_name(text, told, tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(text)
    with pytest.raises(MeshError) as caught:
        read_solid_mesh(path)
    assert told in str(caught.value)


def test_all_blocks_of_abaqus_nodes_are_read(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text("*Node\n1, 0, 0, 0\n2, 1, 0, 0\n*Node, nset=More\n3, 0, 1, 0\n4, 0, 0, 1\n"
                    "*Element, type=C3D4\n1, 1, 2, 3, 4\n")
    assert read_solid_mesh(path).mesh.volume == pytest.approx(1.0 / 6.0)


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("binary", [0, 1])
def test_gmsh_files_with_parameters_and_script_lines_are_read(version, binary, tmp_path):
    need_gmsh()
    with gmsh_session() as gmsh:
        gmsh.model.occ.addCylinder(0, 0, 0, 6, 0, 0, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [1], 5), "rod")
        gmsh.model.mesh.generate(3)
        options = {"Mesh.MshFileVersion": version, "Mesh.Binary": binary}
        for name, value in options.items():
            gmsh.option.setNumber(name, value)
        for name, parametric in (("plain.msh", 0), ("parametric.msh", 1)):
            gmsh.option.setNumber("Mesh.SaveParametric", parametric)
            gmsh.write(str(tmp_path / name))
    script = (tmp_path / "plain.msh").read_bytes() + b'Show "*";\n//+\nHide "*";\n'
    (tmp_path / "script.msh").write_bytes(script)
    plain, *others = (read_solid_mesh(tmp_path / name)
                      for name in ("plain.msh", "script.msh", "parametric.msh"))  # fmt: skip
    for other in others:
        assert other.mesh.volume == pytest.approx(plain.mesh.volume, rel=1e-12)
        assert other.mesh.cell_count == plain.mesh.cell_count == len(other.parts.region("rod"))
