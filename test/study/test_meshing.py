"""``mesh``: a part in tetrahedra, its quality told, its size searched for the time of a step."""

from __future__ import annotations

import shlex

import pytest

from softrobot_twin.__main__ import main
from softrobot_twin.command_line.commands import length, step_time
from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.cad_meshing import mesh_cad, write_msh
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.study import meshing
from softrobot_twin.study.first_scene import MeshSource, first_scene
from softrobot_twin.study.meshing import MeshingError, StepTime, scene_command, size_for
from test.cad_parts import box, lines_of, need_gmsh, write_stl


@pytest.mark.parametrize("text, value", [
    ("6mm", 6e-3), ("0.006m", 6e-3), ("6e-3", 6e-3), ("0.6 cm", 6e-3), ("6000um", 6e-3),
    ("1in", 0.0254),
])  # fmt: skip
def test_a_length_has_its_unit(text, value):
    assert length(text) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("text, value", [("2ms", 2e-3), ("0.002s", 2e-3), ("2e-3", 2e-3)])
def test_a_time_has_its_unit(text, value):
    assert step_time(text) == pytest.approx(value, rel=1e-12)


def power_law(exponent):
    """Time of a step by size: 10 ms at 5 mm."""
    tried = []

    def measure(size):
        tried.append(size)
        return 0.01 * (size / 0.005) ** exponent

    return measure, tried


@pytest.mark.parametrize("exponent", [-2.0, -3.0, -4.0, -5.0])
@pytest.mark.parametrize("wanted", [0.002, 0.01, 0.05])
def test_the_size_for_a_step_time_is_found_in_few_trials(exponent, wanted):
    measure, tried = power_law(exponent)
    size = size_for(wanted, 0.008, 0.05, measure)
    assert size in tried and len(tried) <= meshing.TRIALS
    assert 0.5 * wanted < 0.01 * (size / 0.005) ** exponent <= wanted


def test_a_step_time_that_no_size_keeps_is_refused_with_the_fastest():
    measure, _ = power_law(-3.0)
    with pytest.raises(MeshingError, match="one of 20 mm takes 0.156 ms on this machine"):
        size_for(1e-5, 0.008, 0.02, measure)


def test_a_size_that_cannot_be_meshed_is_too_large():
    measure, tried = power_law(-3.0)

    def measure_small(size: float) -> float:
        if size > 0.012:
            raise MeshError("part.stl", "cannot be meshed")
        return measure(size)

    wanted = 0.01 * (0.011 / 0.005) ** -3.0
    assert size_for(wanted, 0.02, 0.05, measure_small) in tried
    with pytest.raises(MeshError, match="cannot be meshed"):
        size_for(wanted, 0.2, 0.5, measure_small)


@pytest.mark.exhaustive
def test_the_size_is_searched_for_a_step_time(tmp_path, capsys, monkeypatch):
    """With steps whose time is that of a law, so that the test does not depend on the machine."""
    need_gmsh()
    monkeypatch.setattr(meshing, "measured_step", lambda scene: step_of(scene))
    monkeypatch.setattr(meshing, "print_mesh_error", lambda scene, begin: None)

    def step_of(scene):
        return StepTime(2e-6 * read_solid_mesh(scene.mesh_path).mesh.cell_count, 1.0)

    part, output = write_stl(tmp_path / "block.stl", box((60, 20, 20))), tmp_path / "block.msh"
    wanted = ["--unit", "mm", "--step-time", "1ms"]
    assert main(["mesh", str(part), *wanted, "--output", str(output)]) == 0
    out, err = capsys.readouterr()
    cells = read_solid_mesh(output).mesh.cell_count
    assert 200 < cells <= 500
    assert "at most 5 meshes" in out and "step" in out and not lines_of(err)


@pytest.mark.exhaustive
def test_steps_are_measured_in_a_process_of_their_own(tmp_path):
    need_gmsh()
    write_msh(tmp_path / "block.msh", mesh_cad(write_stl(tmp_path / "block.stl", box((6, 2, 2))), 1.0, 1.0))
    source = MeshSource(tmp_path / "block.msh", 1e-2, None, "")
    reading = read_solid_mesh(tmp_path / "block.msh", scale=1e-2)
    _, scene, _ = first_scene(tmp_path / "block.yaml", source, reading, tmp_path)
    step = meshing.measured_step(scene)
    assert step.median > 0.0 and step.slowdown >= 1.0


def test_a_scene_of_a_part_of_metres_is_made_by_the_printed_command(tmp_path):
    for extent, unit in ((0.1, []), (1.9, []), (3.0, ["--unit", "m"])):
        words = shlex.split(scene_command(tmp_path / "a part.msh", extent))
        assert words[:3] == ["softrobot_twin", "init", str(tmp_path / "a part.msh")]
        assert words[3:] == unit


@pytest.mark.parametrize("arguments, word", [
    (["folder", "--size", "5mm"], "folder: is a folder"),
    (["open.stl", "--size", "5mm"], "is open"),
    (["cube.stl", "--size", "1m"], "larger than the part"),
    (["cube.stl", "--size", "1um"], "more than 1000000"),
    (["none.stl", "--size", "5mm"], "no such file"),
    (["cube.step", "--size", "5mm", "--unit", "mm"], "states its unit"),
    (["cube.stl", "--size", "5mm", "--output", "cube.vtk"], ".msh"),
])  # fmt: skip
def test_a_part_that_cannot_be_meshed_is_one_error_and_leaves_its_output(
    tmp_path, monkeypatch, capsys, arguments, word
):
    monkeypatch.chdir(tmp_path)
    cube = box((20, 20, 20))
    (tmp_path / "folder").mkdir()
    write_stl(tmp_path / "cube.stl", cube)
    write_stl(tmp_path / "open.stl", (cube[0], cube[1][1:]))
    (tmp_path / "cube.step").write_text("a STEP file")
    kept = tmp_path / f"{arguments[0].partition('.')[0]}.msh"
    kept.write_text("an earlier mesh")
    unit = [] if "--unit" in arguments or "step" in arguments[0] else ["--unit", "mm"]
    assert main(["mesh", *arguments, *unit]) == 2
    error = capsys.readouterr().err
    assert word in error and len(lines_of(error)) == 1
    assert kept.read_text() == "an earlier mesh"
    assert not list(tmp_path.glob(".*"))
