"""Tetrahedra inside parts of CAD programs; what is wrong with a file is one clear error."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.cad_meshing import (
    cavities_of,
    first_crossing,
    kept_mesh,
    mesh_cache,
    mesh_cad,
    part_size,
    read_shells,
    write_msh,
)
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.quality import radius_ratios
from test.shapes import Sphere
from softrobot_twin.geometry.tet_mesh import TetMesh
from test.cad_parts import box, finger, gmsh_session, joined, need_gmsh, write_step, write_stl

pytestmark = pytest.mark.libraries

MM = 1e-3
CUBE = box((20, 20, 20))


@pytest.fixture(scope="module")
def meshed(tmp_path_factory):
    """The finger as an STL file, meshed."""
    need_gmsh()
    path = write_stl(tmp_path_factory.mktemp("finger") / "finger.stl", finger())
    return path, mesh_cad(path, 6 * MM, MM)


def test_a_part_is_filled_and_its_inner_shell_becomes_a_cavity(meshed):
    _, made = meshed
    assert made.mesh.volume == pytest.approx((60 * 20 * 16 - 40 * 8 * 6) * MM**3, rel=1e-5)
    assert list(made.cavities) == ["cavity_1"] and not made.regions
    assert made.cavity_volume("cavity_1") == pytest.approx(40 * 8 * 6 * MM**3, rel=1e-5)
    np.testing.assert_allclose(
        made.mesh.bounding_box, [[0, -10 * MM, -8 * MM], [60 * MM, 10 * MM, 8 * MM]], atol=1e-8
    )
    assert radius_ratios(made.mesh).min() > 0.05


def test_the_same_part_gives_the_same_mesh(meshed):
    path, made = meshed
    again = mesh_cad(path, 6 * MM, MM)
    assert (again.mesh.node_positions == made.mesh.node_positions).all()
    assert (again.mesh.cells == made.mesh.cells).all()


def test_a_written_mesh_is_in_metres_and_names_its_cavity(meshed, tmp_path):
    _, made = meshed
    write_msh(tmp_path / "finger.msh", made)
    reading = read_solid_mesh(tmp_path / "finger.msh")
    assert reading.mesh.volume == pytest.approx(made.mesh.volume, rel=1e-12)
    assert len(reading.parts.surface("cavity_1")) == len(made.cavities["cavity_1"])
    assert not reading.notes


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "ascii"])
def test_both_kinds_of_stl_files_are_read(tmp_path, binary):
    shells = read_shells(write_stl(tmp_path / "cube.stl", CUBE, binary), MM)
    assert shells.volume == pytest.approx((20 * MM) ** 3, rel=1e-6)
    assert shells.solids == [[0]]


def test_a_binary_file_may_begin_with_solid(tmp_path):
    path = write_stl(tmp_path / "cube.stl", CUBE)
    path.write_bytes(b"solid of a CAD program".ljust(80) + path.read_bytes()[80:])
    assert read_shells(path, MM).volume == pytest.approx((20 * MM) ** 3, rel=1e-6)


def test_a_shell_in_a_shell_is_a_cavity_and_one_in_that_a_body_again(tmp_path):
    nested = joined(CUBE, box((12, 12, 12)), box((4, 4, 4)))
    shells = read_shells(write_stl(tmp_path / "nested.stl", nested), MM)
    assert sorted(shells.solids) == [[0, 1], [2]]
    assert shells.volume == pytest.approx((20**3 - 12**3 + 4**3) * MM**3, rel=1e-6)
    assert any("2 separate bodies" in note for note in shells.notes)


def test_inverted_triangles_are_turned_and_told(tmp_path):
    points, triangles = CUBE
    turned = triangles.copy()
    turned[3] = turned[3][::-1]
    shells = read_shells(write_stl(tmp_path / "cube.stl", (points, turned)), MM)
    assert shells.volume == pytest.approx((20 * MM) ** 3, rel=1e-6)
    assert any("reversed 1 triangles" in note for note in shells.notes)


@pytest.mark.parametrize("turned", [False, True])
def test_repeated_triangles_are_dropped_and_told(tmp_path, turned):
    points, triangles = CUBE
    again = triangles[:3, ::-1] if turned else np.roll(triangles[:3], 1, axis=1)
    part = points, np.vstack([triangles, again])
    shells = read_shells(write_stl(tmp_path / "cube.stl", part), MM)
    assert shells.volume == pytest.approx((20 * MM) ** 3, rel=1e-6)
    assert any("dropped 3 triangles that the file contains more than once" in note
               for note in shells.notes)  # fmt: skip


def test_corners_a_tenth_of_a_micrometre_apart_are_one(tmp_path, drawn_rng):
    points, triangles = CUBE
    corners = points[triangles].reshape(-1, 3)
    apart = drawn_rng.uniform(-1e-4, 1e-4, corners.shape)  # mm
    part = corners + apart, np.arange(len(corners)).reshape(-1, 3)
    shells = read_shells(write_stl(tmp_path / "cube.stl", part), MM)
    assert len(shells.points) == 8 and len(shells.triangles) == 12
    assert shells.volume == pytest.approx((20 * MM) ** 3, rel=1e-4)


@pytest.mark.parametrize("content, word", [
    (b"", "is empty"),
    (b"hello", "is no STL file"),
    (b"solid nothing\nendsolid nothing\n", "has no triangles"),
    (b"\0" * 80 + (12).to_bytes(4, "little") + b"\0" * 100, "12 triangles need 684 bytes"),
], ids=["empty", "text", "no facets", "truncated"])  # fmt: skip
def test_what_is_no_stl_file_is_refused(tmp_path, content, word):
    path = tmp_path / "part.stl"
    path.write_bytes(content)
    refused(path, word)


@pytest.mark.parametrize("part, words", [
    ((CUBE[0], CUBE[1][1:]), ("3 of its edges", " mm")),
    (joined(CUBE, box((20, 20, 20), (5, 5, 5))), ("intersects itself at (",)),
    (joined(CUBE, box((20, 20, 20), (7, 3, 1))), ("intersects itself at (",)),
    (joined(CUBE, box((8, 8, 20), (0, 0, 15))), ("intersects itself at (",)),
    (joined(CUBE, box((20, 20, 20), (20, 0, 0))), ("meets itself",)),
], ids=["open", "overlap", "deep overlap", "through a face", "shared face"])  # fmt: skip
def test_a_surface_that_encloses_no_body_is_refused_with_its_place(tmp_path, part, words):
    refused(write_stl(tmp_path / "part.stl", part), *words)


@pytest.mark.parametrize("size, word", [(21.0, "larger than the part"), (0.01, "tetrahedra of")])
def test_a_size_that_does_not_suit_is_refused_with_the_extents(tmp_path, size, word):
    refused(write_stl(tmp_path / "cube.stl", CUBE), word, "20 × 20 × 20 mm", size=size * MM)


def test_a_file_of_too_many_bytes_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr("softrobot_twin.geometry.cad_meshing.MOST_BYTES", 100)
    refused(write_stl(tmp_path / "cube.stl", CUBE), "fewer facets")


def refused(path: Path, *words: str, size: float = 5 * MM) -> None:
    with pytest.raises(MeshError) as error:
        mesh_cad(path, size, MM)
    assert error.value.path == path and "\n" not in str(error.value)
    for word in words:
        assert word in error.value.reason


def test_a_smooth_closed_surface_does_not_cross_itself():
    turns = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    u, v = np.meshgrid(turns, turns, indexing="ij")
    out = 3.0 + np.cos(v)
    points = np.stack([out * np.cos(u), out * np.sin(u), np.sin(v)], axis=-1).reshape(-1, 3)
    a = np.arange(24 * 24).reshape(24, 24)
    b, d = np.roll(a, -1, 0), np.roll(a, -1, 1)
    c = np.roll(b, -1, 1)
    halves = [np.stack(half, axis=-1).reshape(-1, 3) for half in ((a, b, c), (a, c, d))]
    triangles = np.concatenate(halves)
    assert first_crossing(points, triangles) is None
    shifted = joined((points, triangles), (points + [3.3, 0.1, 0.0], triangles))
    assert first_crossing(*shifted) is not None


def test_solids_of_a_step_file_become_regions_that_share_nodes(tmp_path):
    need_gmsh()
    path = write_step(tmp_path / "two.step", ((0, 0, 0), (30, 10, 4)), ((0, 0, 4), (30, 10, 6)))
    made = mesh_cad(path, 5 * MM)
    volumes = {name: made.mesh.volumes[tets].sum() for name, tets in made.regions.items()}
    assert sorted(volumes.values()) == pytest.approx([1200e-9, 1800e-9], rel=1e-6)
    assert list(volumes) == ["solid_1", "solid_2"]
    shared = np.intersect1d(*(made.mesh.cells[tets] for tets in made.regions.values()))
    assert np.allclose(made.mesh.node_positions[shared, 2], 4 * MM)
    # With the names that CAD programs write:
    named = re.sub(r"Open CASCADE STEP translator[\s\d.]*?\.(\d)'",
                   lambda found: ("layer'", "soft part'")[int(found[1]) - 1], path.read_text())
    path.write_text(named)
    assert list(mesh_cad(path, 5 * MM).regions) == ["layer", "soft_part"]


def test_a_void_of_a_step_solid_is_a_cavity_and_its_unit_is_known(tmp_path):
    need_gmsh()
    path = write_step(tmp_path / "hollow.step", ((0, 0, 0), (40, 16, 16)), cut=[((5, 5, 5), (30, 6, 6))])
    size = part_size(path)
    np.testing.assert_allclose(size.extents, [40 * MM, 16 * MM, 16 * MM], rtol=1e-3)
    made = mesh_cad(path, 8 * MM)
    assert made.cavity_volume("cavity_1") == pytest.approx(1080e-9, rel=1e-6)
    assert size.volume == pytest.approx(made.mesh.volume, rel=1e-6)


def tube(path):
    """A bar of 30 × 12 × 12 mm with a round chamber of 20 mm, written as STEP or STL."""
    with gmsh_session() as gmsh:
        occ = gmsh.model.occ
        occ.cut([(3, occ.addBox(0, 0, 0, 30, 12, 12))], [(3, occ.addCylinder(5, 6, 6, 20, 0, 0, 3))])
        occ.synchronize()
        if path.suffix == ".stl":
            gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 40)
            gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    return path


@pytest.mark.parametrize("suffix", [".step", pytest.param(".stl", marks=pytest.mark.exhaustive)])
def test_round_walls_of_chambers_are_refined_and_what_they_lose_is_told(suffix, tmp_path):
    need_gmsh()
    path = tube(tmp_path / f"tube{suffix}")
    volume = 3.0**2 * np.pi * 20.0
    fine, coarse, turned = (mesh_cad(path, 6 * MM, MM, turn=turn) for turn in (None, 0, 24))
    for made in (fine, coarse, turned):
        true = 1e9 * made.cavity_volume("cavity_1") / (1.0 - made.lost["cavity_1"])
        assert true == pytest.approx(volume, rel=0.02 if suffix == ".stl" else 1e-6)
    assert turned.lost["cavity_1"] < fine.lost["cavity_1"] < 0.03 < 0.08 < coarse.lost["cavity_1"]
    assert not any("cavity_1" in note for note in fine.notes)
    assert any("% off the volume of cavity_1" in note for note in coarse.notes)


def test_small_fillets_of_a_chamber_are_refined_no_more_than_its_volume_needs(tmp_path):
    need_gmsh()
    with gmsh_session() as gmsh:
        occ = gmsh.model.occ
        occ.addBox(10, 4, 4, 40, 8, 8)
        occ.synchronize()
        edges = [tag for _, tag in gmsh.model.getEntities(1)]
        hollow = occ.fillet([1], edges, [0.5])
        occ.cut([(3, occ.addBox(0, 0, 0, 60, 16, 16))], hollow)
        occ.synchronize()
        gmsh.write(str(tmp_path / "box.step"))
    made = mesh_cad(tmp_path / "box.step", 4 * MM)
    assert made.mesh.node_count < 4000 and made.lost["cavity_1"] < 0.03


def test_text_is_no_step_file(tmp_path):
    need_gmsh()
    path = tmp_path / "part.step"
    path.write_text("hello")
    refused(path, "cannot be read as STEP")


@pytest.mark.parametrize("raised, words", [
    ("ModuleNotFoundError('No module named gmsh')", ("pip install gmsh", "not installed")),
    ("OSError('libGLU.so.1: cannot open shared object file')",
     ("libGLU.so.1", "sudo apt install libglu1-mesa")),
], ids=["gmsh", "library"])  # fmt: skip
def test_what_is_missing_is_named_with_the_command_that_installs_it(tmp_path, monkeypatch, raised, words):
    (tmp_path / "gmsh.py").write_text(f"raise {raised}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    refused(write_stl(tmp_path / "cube.stl", CUBE), *words)


def test_a_mesh_is_kept_by_the_content_of_its_file(tmp_path, monkeypatch):
    need_gmsh()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = write_stl(tmp_path / "cube.stl", CUBE)
    first = kept_mesh(path, 10 * MM, MM)
    assert first.path.parent == mesh_cache() and str(first.path) in first.notes[-1]
    written = first.path.stat().st_mtime_ns
    path.touch()
    assert kept_mesh(path, 10 * MM, MM).path == first.path
    assert first.path.stat().st_mtime_ns == written
    assert kept_mesh(path, 12 * MM, MM).path != first.path
    write_stl(path, box((20, 20, 24)))
    assert kept_mesh(path, 10 * MM, MM).path != first.path
    assert len(list(mesh_cache().glob("*.msh"))) == 3


def test_a_kept_mesh_tells_what_was_repaired_and_how_much_its_volume_is_off(tmp_path, monkeypatch):
    need_gmsh()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    ball = Sphere(np.zeros(3), 10.0).surface(1.0)
    turned = ball[1].copy()
    turned[3] = turned[3][::-1]
    path = write_stl(tmp_path / "ball.stl", (ball[0], turned))
    first, again = (kept_mesh(path, 9 * MM, MM) for _ in range(2))
    assert first.path == again.path
    assert first.notes[:-1] == again.notes[:-1] and len(first.notes) > 1
    assert any("reversed 1 triangles" in note for note in again.notes)
    assert "meshed before" in again.notes[-1]


def test_every_inner_shell_of_a_mesh_is_a_cavity_with_its_normals_out_of_the_gas(meshed):
    _, made = meshed
    inner = cavities_of(made.mesh)["cavity_1"]
    corners = made.mesh.node_positions[inner]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = corners.mean(axis=1) - [30 * MM, 0.0, 2 * MM]
    assert (np.einsum("ti,ti->t", normals, away) > 0.0).all()
    assert len(cavities_of(mesh_of_tets(made))) == 0


def mesh_of_tets(made):
    """One tetrahedron of a mesh: a body without inner shells."""
    return TetMesh(made.mesh.node_positions[made.mesh.cells[0]], np.arange(4)[None])
