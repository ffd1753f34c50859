"""Accuracy and choice on a column that is inflated, and on one that cables pull too."""

import meshio
import numpy as np
import pytest
import yaml

from specimens import column_mesh

from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.harness.study_rows import write_rows
from softrobot_twin.scene import load_scene
from softrobot_twin.study.accuracy_study import (
    AccuracyError,
    Limits,
    displacements,
    exact_simulation,
    length_path,
    mesh_family,
    prescribed_efforts,
    study_meshes,
    write_mesh,
)
from softrobot_twin.study.choice import Measured, choose
from test.scene_changes import yaml_file

SIZE = (0.03, 0.03, 0.06)
FINEST = 2


def write_column(folder, fineness):
    """Writes a column whose middle is hollow; gives the mesh with the middle, and its cells."""
    cells = (3 * fineness, 3 * fineness, 4 * fineness)
    whole = column_mesh(SIZE, cells)
    middle = np.abs(whole.node_positions[whole.cells].mean(axis=1) - [0.0, 0.0, -0.03])
    hollow = (middle < [0.005, 0.005, 0.015]).all(axis=1)
    used, tets = np.unique(whole.cells[~hollow], return_inverse=True)
    mesh = TetMesh(whole.node_positions[used], tets.reshape(-1, 4))
    write_mesh(folder / f"column_{fineness}.vtk", mesh)
    return whole, hollow


@pytest.fixture(scope="module")
def inflated(tmp_path_factory):
    """Scene file of a hollow column under pressure, with two meshes."""
    folder = tmp_path_factory.mktemp("inflated")
    write_column(folder, 1)
    whole, hollow = write_column(folder, FINEST)
    walls = boundary_triangles(whole.cells[hollow])
    meshio.Mesh(whole.node_positions, [("triangle", walls)]).write(folder / "walls.vtk")
    scene = {
        "name": "column",
        "body": {"mesh": {"file": "column_1.vtk"}, "element": "linear",
                 "material": {"law": "corotational", "young_modulus": 1.0e5,
                              "poisson_ratio": 0.3, "density": 1070.0},
                 "fixed": [{"box": {"minimum": [-1, -1, -1e-4], "maximum": [1, 1, 1e-4]}}]},
        "cavities": [{"name": "air", "walls": [{"file": "walls.vtk"}], "rate": 1.0e4,
                      "pressure": [0.0, 2.0e4], "growth": [0.0, 2.0e-6]}],
        "effectors": [{"name": "tip", "points": [[0.0, 0.0, -0.06]]}]}
    return yaml_file(folder / "column.yaml", scene)


@pytest.fixture(scope="module")
def study(inflated, tmp_path_factory):
    """The study of that column."""
    levels = mesh_family(load_scene(inflated), tmp_path_factory.mktemp("none"))
    return study_meshes(levels, Limits(1_500, 10_000, 10))


def changed(path, change):
    """A copy of a scene file beside it, with a changed content."""
    content = yaml.safe_load(path.read_text())
    change(content)
    copy = yaml_file(path.with_name("changed.yaml"), content)
    return load_scene(copy)


def pull(content):
    content["cables"] = [
        {"name": name, "pull_point": [x, 0.01, 0.0], "points": [[x, 0.01, -0.055]],
         "shortening": [0.0, 0.01], "rate": 0.05, "tension": [0.0, 10.0]}
        for name, x in (("a", 0.01), ("b", -0.01))]


def test_cavities_grow_by_shares_of_their_limits_or_volumes(inflated):
    scene = load_scene(inflated)
    np.testing.assert_allclose(displacements(scene), [[2.0e-7], [4.0e-7]])
    boundless = changed(inflated, lambda content: content["cavities"][0].pop("growth"))
    volume = 0.01 * 0.01 * 0.03
    np.testing.assert_allclose(displacements(boundless), [[0.04 * volume], [0.08 * volume]])


def test_with_cables_all_but_the_last_cable_are_actuated(inflated):
    scene = changed(inflated, pull)
    np.testing.assert_allclose(displacements(scene), [[0.001, 0.0, 4.0e-7], [0.002, 0.0, 3.0e-7]])
    # Pressures are kept, tensions reduced.
    efforts = prescribed_efforts(scene, np.array([[2.0, 3.0, 500.0]]))
    np.testing.assert_allclose(efforts, [[0.3, 0.0, 500.0]])
    simulation = exact_simulation(scene)
    assert [kind.setpoint.word for kind in simulation.actuators.kinds] == [
        "length", "length", "volume"]


def test_every_actuator_oscillates_in_its_own_unit(inflated):
    path = length_path(changed(inflated, pull), 100.0, 400)
    swing = np.ptp(path.displacements, axis=0)
    assert 1e-4 < swing[0] < 1e-3 and swing[1] == 0.0 and 1e-8 < swing[2] < 4.0e-7
    alone = length_path(load_scene(inflated), 100.0, 400)
    assert 0.0 < alone.displacements.min() and np.ptp(alone.displacements) > 5.0e-8


@pytest.mark.exhaustive
def test_errors_at_given_volumes_and_pressures_fall_with_the_mesh(study):
    linear = {row.mesh: row for row in study.rows
              if (row.element, row.law) == ("linear", "corotational")}
    for case in ("error_lengths", "error_tensions", "error_weightless"):
        coarse, fine = (getattr(linear[f"column_{number}"], case) for number in (1, 2))
        assert 0.0 < fine < coarse, case
    assert {*study.references} == {"lengths", "tensions", "weightless"}
    assert all(reference.displacement > 1e-5 for reference in study.references.values())


@pytest.mark.exhaustive
def test_choose_speaks_of_volumes_and_keeps_what_the_scene_controls(inflated, study, tmp_path, capsys):
    write_rows(tmp_path / "rows.csv", study.rows)
    written = tmp_path / "chosen.yaml"

    def fake_clock(scene, rate, iterations):
        return Measured(1e-3 * iterations, 1e-3 * iterations, 1e-5)

    content = yaml.safe_load(inflated.read_text())
    content["cavities"][0]["walls"][0]["file"] = str(inflated.with_name("walls.vtk"))
    content["body"]["mesh"]["file"] = str(inflated.with_name("column_1.vtk"))
    scene = yaml_file(tmp_path / "column.yaml", content)
    assert choose(scene, 100.0, tmp_path / "rows.csv", written, fake_clock) == 0
    output = capsys.readouterr().out
    assert "for given cavity volumes: " in output
    assert "For given cavity pressures the same model has" in output
    chosen = load_scene(written)
    assert chosen.cavities[0].control == "pressure" and chosen.cavities[0].rate == 1.0e4


def test_a_mesh_with_cavities_and_no_family_is_refused(inflated, tmp_path):
    lonely = tmp_path / "lonely.vtk"
    lonely.write_bytes(inflated.with_name("column_1.vtk").read_bytes())
    scene = changed(inflated, lambda content: content["body"]["mesh"].update(file=str(lonely)))
    with pytest.raises(AccuracyError, match="lonely.vtk has no family.*finer meshes beside it"):
        mesh_family(scene, tmp_path)
