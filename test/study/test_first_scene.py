"""``init``: a first scene that loads and runs as it is; guesses are told, nothing is asked."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.__main__ import main
from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.cad_meshing import CadMesh, mesh_cad, write_msh
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.loading import read_yaml, scene_from_mapping
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.command import CommandSetpoints, Hold
from softrobot_twin.study.first_scene import made_name
from test.cad_parts import box, finger, lines_of, need_gmsh, write_stl
from test.places import MESHES
from test.scene_changes import repeat_step

pytestmark = pytest.mark.sampled

MM = 1e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The mesh of a finger with a chamber, and the scene that init wrote for it."""
    need_gmsh()
    folder = tmp_path_factory.mktemp("first")
    part = write_stl(folder / "finger.stl", finger())
    write_msh(folder / "finger.msh", mesh_cad(part, 8 * MM, MM))
    assert main(["init", str(folder / "finger.msh")]) == 0
    return folder


@pytest.fixture(scope="module")
def scene(folder):
    return load_scene(folder / "finger.yaml")


def write_bar(path, size=(0.02, 0.02, 0.1), scale=1.0, turned=False):
    """A bar in a file, in other units by its scale."""
    mesh = read_box(size, (2, 2, 5)).mesh
    positions = mesh.node_positions * (-1.0 if turned else 1.0) / scale
    cells = mesh.cells[:, [0, 2, 1, 3]] if turned else mesh.cells
    write_msh(path, CadMesh(TetMesh(positions, cells), {}, {}, (), ""))
    return path


def test_the_scene_holds_what_the_mesh_has(scene):
    assert scene.name == "finger"
    assert [cavity.name for cavity in scene.cavities] == ["cavity_1"]
    np.testing.assert_allclose(scene.effectors[0].points, [[60 * MM, 0.0, 0.0]], atol=1e-5)


def test_the_flat_end_face_is_fixed_and_nothing_else(scene):
    body = Simulation(scene, with_warnings=False).model.bodies[0]
    held = body.mesh.node_positions[body.fixed]
    assert np.allclose(held[:, 0], 0.0, atol=1e-7)
    assert np.count_nonzero(np.isclose(body.mesh.node_positions[:, 0], 0.0, atol=1e-7)) == len(held)


def test_the_scene_steps_without_change_and_inflates(scene):
    simulation = Simulation(scene)
    assert not simulation.notes
    repeat_step(simulation, Hold(0.02), 5)
    before = simulation.effector_positions()[0].copy()
    result = repeat_step(simulation, CommandSetpoints(np.array([15.0e3]), 1.0), 4)
    assert result.efforts[0] == pytest.approx(15.0e3, rel=1e-6)
    # The chamber lies above the middle: gas stretches the finger and bends it downwards.
    moved = simulation.effector_positions()[0] - before
    assert moved[2] < -0.03e-3 and abs(moved[1]) < 0.5 * abs(moved[2])


def test_the_first_run_that_is_proposed_ends_at_rest(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_bar(tmp_path / "soft.msh", size=(0.15, 0.02, 0.02))
    assert main(["init", "soft.msh"]) == 0
    proposed = next(line for line in capsys.readouterr().out.splitlines() if "Let it sag:" in line)
    assert main(shlex.split(proposed.partition("softrobot_twin ")[2])) == 0
    told = capsys.readouterr().out
    assert re.search(r"status ok +20 steps", told), told
    assert Path("first.csv").exists() and Path("first.png").exists()


def test_the_examples_in_comments_are_a_scene_too(folder, scene):
    text = (folder / "finger.yaml").read_text()
    head, examples = text.split("# Examples at places", 1)
    examples = "\n".join(re.sub("^# ?", "", line) for line in examples.splitlines()[1:])
    whole = scene_from_mapping(read_yaml(head + examples), folder / "finger.yaml")
    assert len(whole.cables) == 2 and len(whole.markers) == 1
    simulation = Simulation(whole)
    # The points lie in the material: none was moved onto the body.
    assert not simulation.notes
    simulation.step(Hold(0.02))


def test_a_scene_that_exists_is_replaced_only_on_request(folder, capsys):
    before = (folder / "finger.yaml").read_text()
    (folder / "finger.yaml").write_text("mine: true\n")
    assert main(["init", str(folder / "finger.msh")]) == 2
    assert "--force" in capsys.readouterr().err
    assert (folder / "finger.yaml").read_text() == "mine: true\n"
    assert main(["init", str(folder / "finger.msh"), "--force"]) == 0
    assert (folder / "finger.yaml").read_text() == before


@pytest.mark.parametrize("in_file, scale", [("metres", 1.0), ("millimetres", 0.001)])
def test_the_unit_of_a_mesh_file_is_guessed_and_told(tmp_path, capsys, in_file, scale):
    assert main(["init", str(write_bar(tmp_path / "bar.msh", scale=scale))]) == 0
    assert f"guessed: {in_file}" in capsys.readouterr().out
    scene = load_scene(tmp_path / "bar.yaml")
    assert scene.body.mesh.scale == scale
    np.testing.assert_allclose(scene.effectors[0].points, [[0.01, 0.01, 0.1]], atol=1e-9)


def test_a_file_of_hexahedra_gets_their_element(tmp_path):
    shutil.copy(MESHES / "bar_hexa_44.msh", tmp_path / "bar.msh")
    assert main(["init", str(tmp_path / "bar.msh")]) == 0
    scene = load_scene(tmp_path / "bar.yaml")
    assert scene.body.element == "hexahedral"
    Simulation(scene).step(Hold(0.02))


def test_named_regions_are_examples_of_materials(tmp_path):
    mesh = read_box((0.1, 0.02, 0.02), (5, 2, 2)).mesh
    is_root = mesh.node_positions[mesh.cells].mean(axis=1)[:, 0] < 0.04
    regions = {"root": np.flatnonzero(is_root), "soft": np.flatnonzero(~is_root)}
    write_msh(tmp_path / "bar.msh", CadMesh(mesh, regions, {}, (), ""))
    assert main(["init", str(tmp_path / "bar.msh")]) == 0
    text = (tmp_path / "bar.yaml").read_text()
    whole = re.sub(r"^  # (materials:|  - \{region)", r"  \1", text, flags=re.M)
    scene = scene_from_mapping(read_yaml(whole), tmp_path / "bar.yaml")
    assert [part.region for part in scene.body.materials] == ["root", "soft"]
    Simulation(scene).step(Hold(0.02))


def test_a_given_unit_is_taken(tmp_path):
    path = write_bar(tmp_path / "bar.msh")
    assert main(["init", str(path), "--unit", "cm"]) == 0
    assert load_scene(tmp_path / "bar.yaml").body.mesh.scale == 0.01


def test_a_scene_may_lie_in_another_folder_than_its_mesh(tmp_path, capsys):
    path, output = write_bar(tmp_path / "bar.msh"), tmp_path / "my scenes" / "bar.yaml"
    assert main(["init", str(path), "--output", str(output)]) == 0
    told = capsys.readouterr().out.splitlines()[-2:]
    assert [shlex.split(line.partition(":")[2])[:3] for line in told] == [
        ["softrobot_twin", command, str(output)] for command in ("explain", "simulate")]
    scene = load_scene(output)
    assert str(scene.body.mesh.file) == "../bar.msh"
    Simulation(scene).step(Hold(0.02))


def test_without_a_flat_face_a_slice_is_fixed_and_told(tmp_path, capsys):
    """A double cone along x: its ends are points."""
    ring = [[0.05, 0.01, 0.0], [0.05, -0.005, 0.0087], [0.05, -0.005, -0.0087]]
    positions = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], *ring])
    cells = np.array([[0, 2, 3, 4], [1, 2, 4, 3]])
    corners = positions[cells]
    signs = np.linalg.det(corners[:, 1:] - corners[:, :1])
    cells[signs < 0] = cells[signs < 0][:, [0, 2, 1, 3]]
    write_msh(tmp_path / "cone.msh", CadMesh(TetMesh(positions, cells), {}, {}, (), ""))
    assert main(["init", str(tmp_path / "cone.msh")]) == 0
    assert "the nodes at the lowest x, 4 nodes" in capsys.readouterr().out


def shaped(path, shape, size=(0.1, 0.1, 0.06), cells=(12, 12, 6), keep=None):
    """A block of cells, of which some are kept, moved by a function of its points, in a file."""
    mesh = read_box(size, cells).mesh
    points, tets = mesh.node_positions - 0.5 * np.array(size), mesh.cells
    if keep is not None:
        tets = tets[keep(points[tets].mean(axis=1))]
        used, tets = np.unique(tets, return_inverse=True)
        points, tets = points[used], tets.reshape(-1, 4)
    write_msh(path, CadMesh(TetMesh(shape(points.copy()), tets), {}, {}, (), ""))
    assert main(["init", str(path)]) == 0
    scene = load_scene(path.with_suffix(".yaml"))
    return scene, Simulation(scene, with_warnings=False).model.bodies[0]


def rounded(points):
    """Square sections made round."""
    across = points[:, :2]
    largest = np.abs(across).max(axis=1)
    radius = np.linalg.norm(across, axis=1)
    points[:, :2] *= np.where(radius > 0.0, largest / np.where(radius > 0.0, radius, 1.0), 1.0)[:, None]
    return points


@pytest.mark.parametrize(
    "height, legs", [(0.06, (0.034, 0.05)), (0.15, (0.034, 0.05)), (0.06, (0.024, 0.036))]
)
def test_of_a_tripod_the_feet_are_fixed(tmp_path, height, legs):
    """A round plate on three legs, wider than high, higher than wide, and with legs inside its rim."""

    def kept(centres):
        angles = np.arctan2(centres[:, 1], centres[:, 0])
        in_leg = np.cos(3.0 * angles) > 0.6
        reach = np.abs(centres[:, :2]).max(axis=1)
        is_leg = in_leg & (reach > legs[0]) & (reach < legs[1])
        return (centres[:, 2] > height / 6.0) | is_leg

    scene, body = shaped(tmp_path / "tripod.msh", rounded, (0.1, 0.1, height), keep=kept)
    held = body.mesh.node_positions[body.fixed]
    floor = body.mesh.node_positions[:, 2].min()
    assert np.allclose(held[:, 2], floor, atol=1e-6)
    assert len(held) == np.isclose(body.mesh.node_positions[:, 2], floor, atol=1e-6).sum()
    assert scene.effectors[0].points[0][2] == pytest.approx(floor + height, abs=1e-5)


def test_a_taper_that_hangs_is_still_fixed_at_its_broad_end(tmp_path):
    def tapered(points):
        points[:, :2] *= (0.3 + 0.7 * (points[:, 2:] / 0.1 + 0.5))
        return points

    _, body = shaped(tmp_path / "hanging.msh", tapered, (0.03, 0.03, 0.1), (4, 4, 8))
    held = body.mesh.node_positions[body.fixed]
    assert np.allclose(held[:, 2], body.mesh.node_positions[:, 2].max(), atol=1e-6)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("tip", [0.1, 0.25, 0.6])
def test_the_cables_of_a_tapered_body_stay_inside_it(tmp_path, axis, tip):
    def tapered(points):
        points[:, :2] *= 1.0 - (1.0 - tip) * (points[:, 2:] / 0.1 + 0.5)
        points = rounded(points)
        points[:, 0] += 0.1 * (points[:, 2] + 0.05)  # it leans
        return np.roll(points, 1 if axis == 0 else 0, axis=1)

    path = tmp_path / "cone.msh"
    shaped(path, tapered, (0.03, 0.03, 0.1), (4, 4, 10))
    mesh = read_solid_mesh(path).mesh
    text = path.with_suffix(".yaml").read_text()
    examples = text[text.index("# cables:"):text.index("# markers:")]
    cables = read_yaml("\n".join(line[2:] for line in examples.splitlines() if len(line) > 2))
    assert len(cables["cables"]) == 2
    for cable in cables["cables"]:
        ends = np.array(cable["points"])
        shares = np.linspace(0.0, 1.0, 20)[:, None]
        along = np.vstack([a + shares * (b - a) for a, b in zip(ends, ends[1:], strict=False)])
        assert locate_points(mesh, along).distances.max() <= 2e-6
        # They lead along the body.
        assert np.linalg.norm(ends[0] - ends[-1]) == pytest.approx(0.08, rel=0.2)


def test_a_cad_file_is_meshed_by_its_scene(tmp_path, monkeypatch):
    need_gmsh()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = write_stl(tmp_path / "block.stl", box((20, 20, 60), (0, 0, 30)))
    assert main(["init", str(path), "--size", "12mm"]) == 0
    scene = load_scene(tmp_path / "block.yaml")
    assert (scene.body.mesh.size, scene.body.mesh.scale) == (0.012, 0.001)
    simulation = Simulation(scene)
    (kept,) = (tmp_path / "cache").rglob("block_*.msh")
    assert any(str(kept) in note for note in simulation.notes)
    simulation.step(Hold(0.02))


@pytest.mark.parametrize("arguments, word", [
    (["bar.msh", "--size", "6mm"], "has tetrahedra already"),
    (["bar.msh", "--output", "bar.txt"], ".yaml"),
    (["none.msh"], "no such file"),
])  # fmt: skip
def test_what_cannot_be_done_is_one_error_and_writes_nothing(tmp_path, monkeypatch, capsys, arguments, word):
    write_bar(tmp_path / "bar.msh")
    monkeypatch.chdir(tmp_path)
    assert main(["init", *arguments]) == 2
    error = capsys.readouterr().err
    assert word in error and len(lines_of(error)) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bar.msh"]


@pytest.mark.parametrize("stem, name", [
    ("finger", "finger"), ("My part-2", "My_part_2"), ("3d", "robot_3d"), ("é", "robot"),
])  # fmt: skip
def test_the_name_of_a_robot_is_that_of_its_file_in_letters_of_topics(stem, name):
    assert made_name(stem, "robot") == name
