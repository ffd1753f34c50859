"""Repair of surfaces from files: edges that do not match, triangles with wrong orientation."""

import base64

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.ear_clipping import clip_ears
from softrobot_twin.geometry.mass_properties import surface_mass_properties
from test.shapes import Box, Capsule
from softrobot_twin.geometry.surface_reading import read_solid_surface

pytestmark = pytest.mark.libraries

SIZE = np.array([0.04, 0.03, 0.02])


def written(path, points, triangles):
    meshio.write(path, meshio.Mesh(points, [("triangle", np.asarray(triangles))]), binary=True)
    return path


def volume(solid):
    closed_surface(solid.triangles, len(solid.points))
    return surface_mass_properties(solid.points, solid.triangles).volume


@pytest.fixture
def box():
    return Box([0.1, 0.2, 0.3], SIZE).surface(np.inf)


def test_a_flipped_surface_is_reversed_and_the_report_names_its_file(tmp_path, box):
    notes = []
    path = written(tmp_path / "rock.stl", box[0], box[1][:, ::-1])
    solid = read_solid_surface(path, notes=notes)
    assert volume(solid) == pytest.approx(SIZE.prod(), rel=1e-6)
    assert len(notes) == 1
    assert notes[0].startswith("rock.stl: reversed")


@pytest.mark.parametrize("seed", range(5))
def test_triangles_with_the_wrong_orientation_are_reversed(tmp_path, seed):
    points, triangles = Capsule([[0, 0, 0], [0, 0, 0.05]], 0.02).surface(0.01)
    random = np.random.default_rng(seed)
    some = random.choice(len(triangles), len(triangles) // 4, replace=False)
    before = surface_mass_properties(points, triangles).volume
    triangles = triangles.copy()
    triangles[some] = triangles[some, ::-1]
    notes = []
    solid = read_solid_surface(written(tmp_path / "rock.stl", points, triangles), notes=notes)
    assert volume(solid) == pytest.approx(before, rel=1e-5)
    assert f"rock.stl: reversed {len(some)} triangles" in notes[0]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 10.0])
def test_a_t_junction_is_cut_open_and_closed(tmp_path, scale):
    """One side has its edge cut in the middle twice, its neighbour has it whole."""
    points, triangles = Box([0, 0, 0], [0.04, 0.03, 0.02]).surface(np.inf)
    t = triangles[0]
    middles = [points[t[0]] + f * (points[t[1]] - points[t[0]]) for f in (0.37, 0.71)]
    n = len(points)
    points = np.vstack([points, middles]) * scale
    triangles = np.vstack([triangles[1:], [[t[0], n, t[2]], [n, n + 1, t[2]], [n + 1, t[1], t[2]]]])
    with pytest.raises(MeshError):
        closed_surface(triangles, len(points))
    notes = []
    solid = read_solid_surface(written(tmp_path / "rock.stl", points, triangles), notes=notes)
    assert volume(solid) == pytest.approx(SIZE.prod() * scale**3, rel=1e-6)
    assert "T-junction" in notes[0]


def test_triangles_without_area_are_dropped(tmp_path, box):
    points, triangles = box
    t = triangles[0]
    n = len(points)
    points = np.vstack([points, 0.5 * (points[t[0]] + points[t[1]])])
    # The seam is closed by a triangle of no area between both halves and the whole edge.
    triangles = np.vstack([triangles[1:], [[t[0], n, t[2]], [n, t[1], t[2]], [t[0], t[1], n]]])
    notes = []
    solid = read_solid_surface(written(tmp_path / "rock.stl", points, triangles), notes=notes)
    assert volume(solid) == pytest.approx(SIZE.prod(), rel=1e-6)
    assert any("without area" in note for note in notes)


def test_a_hollow_solid_keeps_its_cavity(tmp_path, box):
    points, triangles = box
    inner = 0.5 * (points - points.mean(axis=0)) + points.mean(axis=0)
    both = np.vstack([triangles, triangles[:, ::-1] + len(points)])
    notes = []
    path = written(tmp_path / "rock.stl", np.vstack([points, inner]), both)
    solid = read_solid_surface(path, notes=notes)
    assert notes == []
    assert volume(solid) == pytest.approx(SIZE.prod() * 7 / 8, rel=1e-6)


def test_a_surface_that_is_open_or_encloses_nothing_is_refused_by_file_name(tmp_path, box):
    leaf = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2], [2, 1, 0]]
    for part, told in (((box[0], box[1][1:]), ": its surface is open: 3 of its edges .*mesh rock.stl --repair"),
                       (leaf, "")):  # fmt: skip
        with pytest.raises(MeshError, match=rf"rock\.stl{told}"):
            read_solid_surface(written(tmp_path / "rock.stl", *part), notes=[])


def test_distances_of_a_surface_are_those_of_its_shape_and_zero_inside(tmp_path, box):
    solid = read_solid_surface(written(tmp_path / "box.stl", *box), notes=[])
    points = np.random.default_rng(2).uniform([0.06, 0.16, 0.27], [0.14, 0.24, 0.33], (200, 3))
    exact = Box([0.1, 0.2, 0.3], SIZE).distances(points)
    assert 5 < np.count_nonzero(exact == 0.0) < 100
    np.testing.assert_allclose(solid.distances(points), exact, atol=1e-7)


# --- files as programs write them: a box of 4 × 2 × 2 ---------------------------------------------

CORNERS = [(x, y, z) for x in (0, 4) for y in (0, 2) for z in (0, 2)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
HALVES = [(q[0], q[a], q[a + 1]) for q in QUADS for a in (1, 2)]


def rows(values):
    return "".join(" ".join(map(str, row)) + "\n" for row in values)


def binary_stl(head=b"", tail=b"", attribute=0):
    data = head.ljust(80) + len(HALVES).to_bytes(4, "little")
    for half in HALVES:
        numbers = np.array([(0, 0, 0), *(CORNERS[corner] for corner in half)], "<f4")
        data += numbers.tobytes() + attribute.to_bytes(2, "little")
    return data + tail


def text_stl(name="box", line="\n", comment=""):
    text = f"solid {name}\n{comment}"
    for half in HALVES:
        corners = "".join("vertex %g %g %g\n" % CORNERS[corner] for corner in half)
        text += f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n"
    return f"{text}endsolid {name}\n".replace("\n", line).encode("latin-1")


def obj(faces, words="{}", more=""):
    points = "".join("v %g %g %g\n" % corner for corner in CORNERS)
    return (f"o box\n{points}{more}" + "".join(
        "f " + " ".join(words.format(corner + 1) for corner in face) + "\n" for face in faces)
    ).encode()  # fmt: skip


def polydata(faces, version=3, binary=False):
    sizes = [len(face) for face in faces]
    head = f"# vtk DataFile Version {version}.0\nbox\n{'BINARY' if binary else 'ASCII'}\n"
    if version >= 5:
        first = np.cumsum([0, *sizes])
        arrays = [("POINTS 8 double", CORNERS, ">f8"),
                  (f"POLYGONS {len(first)} {sum(sizes)}\nOFFSETS vtktypeint64", first, ">i8"),
                  ("CONNECTIVITY vtktypeint64", np.concatenate(faces), ">i8")]  # fmt: skip
    else:
        own = np.concatenate([(len(face), *face) for face in faces])
        arrays = [("POINTS 8 float", CORNERS, ">f4"), (f"POLYGONS {len(faces)} {len(own)}", own, ">i4")]
    text = (head + "DATASET POLYDATA\n").encode()
    for word, values, kind in arrays:
        values = np.asarray(values, kind).ravel()
        plain = " ".join(map(str, values.tolist())).encode()
        text += word.encode() + b"\n" + (values.tobytes() if binary else plain) + b"\n"
    return text


def polydata_xml(faces, binary=False):
    arrays = {"Points": ("Float64", CORNERS), "connectivity": ("Int64", np.concatenate(faces)),
              "offsets": ("Int64", np.cumsum([len(face) for face in faces]))}  # fmt: skip
    words = {}
    for name, (kind, values) in arrays.items():
        values = np.asarray(values, {"Float64": "<f8", "Int64": "<i8"}[kind]).ravel()
        packed = base64.b64encode(np.uint32(values.nbytes).tobytes() + values.tobytes()).decode()
        words[name] = (f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="'
                       f'{3 if name == "Points" else 1}" format="{"binary" if binary else "ascii"}">'
                       f'{packed if binary else " ".join(map(str, values))}</DataArray>')
    return ('<VTKFile type="PolyData" byte_order="LittleEndian" header_type="UInt32"><PolyData>'
            f'<Piece NumberOfPoints="8"><Points>{words.pop("Points")}</Points>'
            f'<Polys>{"".join(words.values())}</Polys></Piece></PolyData></VTKFile>').encode()


def ply(faces, ending="\n"):
    return (f"ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
            f"property float z\nelement face {len(faces)}\nproperty list uchar int "
            f"vertex_indices\nend_header\n{rows(CORNERS)}"
            f"{rows((len(face), *face) for face in faces)}").replace("\n", ending).encode()


OFF = f"8 6 12\n{rows(CORNERS)}{rows((4, *face) for face in QUADS)}"
FILES = {
    "plain.stl": binary_stl(), "solid.stl": binary_stl(b"solid part"),
    "tail.stl": binary_stl(tail=b"\0" * 150), "solid_tail.stl": binary_stl(b"solid", b"\r\n"),
    "colour.stl": binary_stl(b"COLOR=\xa0\xa0\xa0\xff", attribute=0x7FFF),
    "text.stl": text_stl(), "crlf.stl": text_stl(line="\r\n"), "cr.stl": text_stl(line="\r"),
    "upper.stl": text_stl().upper(), "latin1.stl": text_stl("pi\xe8ce n\xb01"),
    "comment.stl": text_stl(comment="; exported\n"), "bom.stl": b"\xef\xbb\xbf" + text_stl(),
    "words.stl": text_stl("a facet endsolid vertex"),
    "triangles.obj": obj(HALVES), "quads.obj": obj(QUADS), "cr.obj": obj(QUADS).replace(b"\n", b"\r"),
    "normals.obj": obj(QUADS, "{}//1", "vn 0 0 1\n"), "texture.obj": obj(HALVES, "{}/1", "vt 0 0\n"),
    "both.obj": obj(QUADS, "{}/1/1", "vt 0 0\nvn 0 0 1\n"),
    "material.obj": b"mtllib none.mtl\n# pi\xe8ce\n" + obj(QUADS),
    "triangles.vtk": polydata(HALVES), "quads.vtk": polydata(QUADS),
    "binary.vtk": polydata(QUADS, binary=True), "new.vtk": polydata(QUADS, 5),
    "new_binary.vtk": polydata(HALVES + QUADS[:0], 5, True), "mixed.vtk": polydata(HALVES[:2] + QUADS[1:]),
    "text.vtp": polydata_xml(QUADS), "binary.vtp": polydata_xml(HALVES, True),
    "quads.ply": ply(QUADS), "crlf.ply": ply(HALVES, "\r\n"),
    "quads.off": b"OFF\n# made\n" + OFF.encode(), "one_line.off": b"OFF " + OFF.encode(),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_read_as_programs_write_it(name, tmp_path, capfd):
    path = tmp_path / name
    path.write_bytes(FILES[name])
    solid = read_solid_surface(path, notes=(notes := []))
    assert notes == [] and capfd.readouterr() == ("", "")
    assert len(solid.points) == 8 and volume(solid) == pytest.approx(16.0, rel=1e-6)


@pytest.mark.parametrize("name, content, told", [
    ("cut.stl", binary_stl()[:400], "12 triangles need 684 bytes, it has 400"),
    ("cut_text.stl", text_stl()[:400], "it has no endsolid"),
    ("comma.stl", text_stl().replace(b"vertex 4 ", b"vertex 4,5 "), "cannot be read"),
    ("strips.vtk", polydata(QUADS).replace(b"POLYGONS", b"TRIANGLE_STRIPS"), "strips of triangles"),
    ("far.vtk", polydata([(0, 1, 9)]), "triangles of point 9, but only 8"),
    ("far.obj", obj([(0, 1, 9)]), "far.obj"),
    ("ends.vtk", polydata(QUADS)[:-20], "it ends before 30 numbers"),
    ("points.obj", obj([]), "has no triangles"), ("text.off", b"hello", "does not begin with OFF"),
])  # fmt: skip
def test_a_damaged_file_is_refused_by_name(name, content, told, tmp_path, capfd):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(MeshError) as caught:
        read_solid_surface(path, notes=[])
    assert told in str(caught.value) and caught.value.path == path
    assert "SystemExit" not in str(caught.value) and capfd.readouterr() == ("", "")


def test_a_polygon_with_inward_corners_is_split_into_triangles_that_do_not_overlap(tmp_path, drawn_rng):
    random = drawn_rng
    for _ in range(20):
        count = int(random.integers(5, 12))
        angles = 2.0 * np.pi * (np.arange(count) + random.uniform(-0.3, 0.3, count)) / count
        radii = random.uniform(0.2, 1.0, count)
        floor = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
        points = [(*place, z) for z in (0.0, 1.0) for place in floor]
        around = [(i, (i + 1) % count, (i + 1) % count + count, i + count) for i in range(count)]
        first = random.integers(count)
        base = np.roll(np.arange(count), first)
        faces = [base[::-1], base + count, *around]
        path = tmp_path / "star.obj"
        path.write_text("".join("v %.9g %.9g %.9g\n" % place for place in points) + "".join(
            "f " + " ".join(str(corner + 1) for corner in face) + "\n" for face in faces))
        solid = read_solid_surface(path, notes=[])
        x, y = floor.T
        area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
        assert volume(solid) == pytest.approx(area, rel=1e-5)
        corners = solid.points[solid.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert 0.5 * np.abs(normals[:, 2]).sum() == pytest.approx(2.0 * area, rel=1e-5)


def test_a_polygon_that_crosses_itself_has_no_ears():
    assert clip_ears(np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1.1, 0]], float)) is None


def test_several_solids_are_refused_with_the_remedy_where_a_hull_may_be_taken(tmp_path, box):
    points, triangles = box
    both = np.vstack([points, points + [0.1, 0.0, 0.0]]), np.vstack([triangles, triangles + 8])
    path = written(tmp_path / "two.stl", *both)
    with pytest.raises(MeshError, match="2 separate solids.*mesh two.stl --repair .*`hull: true`"):
        read_solid_surface(path, notes=[], hull=False)
    hull = read_solid_surface(path, notes=[], hull=True)
    assert volume(hull) == pytest.approx(0.14 * 0.03 * 0.02, rel=1e-5)
    # Chambers in one file are no solids.
    assert volume(read_solid_surface(path, notes=[])) == pytest.approx(2 * SIZE.prod(), rel=1e-5)


def test_the_hull_of_an_open_surface_is_closed(tmp_path, box):
    path = written(tmp_path / "cup.stl", box[0], box[1][1:])
    with pytest.raises(MeshError, match="is open.*hull: true"):
        read_solid_surface(path, notes=[], hull=False)
    assert volume(read_solid_surface(path, notes=[], hull=True)) == pytest.approx(SIZE.prod(), rel=1e-5)
    leaf = written(tmp_path / "leaf.stl", box[0], box[1][:1])
    with pytest.raises(MeshError, match="no convex hull"):
        read_solid_surface(leaf, notes=[], hull=True)


def test_what_is_left_out_of_a_file_is_told_above_a_hundredth(tmp_path, box):
    speck = 1e-3 * (box[0] - box[0].mean(axis=0)) * 1e-3 + box[0][0]
    both = np.vstack([box[0], speck]), np.vstack([box[1], box[1] + 8])
    solid = read_solid_surface(written(tmp_path / "dust.stl", *both), notes=(notes := []))
    assert volume(solid) == pytest.approx(SIZE.prod(), rel=1e-5)
    assert len(notes) == 1 and "left out 12 of 24 triangles (50 %)" in notes[0]
