"""Accuracy and choice on a column of three meshes, and on the coarse Diamonds."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.study import choice
from softrobot_twin.study.accuracy import hold_radius
from softrobot_twin.study.accuracy_study import (
    MESH,
    NEWTON,
    PRECISION,
    QP,
    AccuracyError,
    Limits,
    approximate_duration,
    mesh_family,
    read_rows,
    study_meshes,
    with_hold_radius,
    write_rows,
)
from softrobot_twin.study.bench_measurement import column_mesh, default_scene_path, write_mesh
from softrobot_twin.study.choice import Measured, choose
from softrobot_twin.study.output_file import OutputError

CELLS = {10: (1, 1, 5), 20: (2, 2, 10), 30: (3, 3, 15)}


def column_scene(folder, mesh_file):
    """A hanging column with three cables, 20 × 20 × 100 mm."""
    cables = [{"name": name, "pull_point": [x, y, 0.02],
               "points": [[x, y, -0.05], [x, y, -0.09]],
               "shortening": [0.0, 0.02], "rate": 0.05, "tension": [0.0, 20.0]}
              for name, x, y in (("a", 0.005, 0.0), ("b", -0.004, 0.004), ("c", -0.004, -0.004))]
    scene = {
        "name": "column",
        "body": {"mesh": {"file": mesh_file},
                 "element": "linear",
                 "material": {"law": "corotational", "young_modulus": 2.0e5,
                              "poisson_ratio": 0.4, "density": 1070.0},
                 "fixed": [{"box": {"minimum": [-1, -1, -1e-4], "maximum": [1, 1, 1e-4]}}]},
        "cables": cables,
        "effectors": [{"name": "tip", "points": [[0.0, 0.0, -0.1]]}]}
    path = folder / "column.yaml"
    path.write_text(yaml.safe_dump(scene, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def family(tmp_path_factory):
    """Scene file of a column with three meshes, the middle one its own."""
    folder = tmp_path_factory.mktemp("family")
    for number, cells in CELLS.items():
        write_mesh(folder / f"column_{number}.vtk", column_mesh((0.02, 0.02, 0.1), cells))
    return column_scene(folder, "column_20.vtk")


@pytest.fixture(scope="module")
def lonely(tmp_path_factory):
    """Scene file of a column with one mesh."""
    folder = tmp_path_factory.mktemp("lonely")
    write_mesh(folder / "column.vtk", column_mesh((0.02, 0.02, 0.1), (1, 1, 5)))
    return column_scene(folder, "column.vtk")


@pytest.fixture(scope="module")
def study(family, tmp_path_factory):
    scene = load_scene(family)
    levels = mesh_family(scene, tmp_path_factory.mktemp("none"))
    return study_meshes(levels, Limits(3_000, 8_000, 20), lambda words: None)


def test_a_mesh_family_is_found_by_the_numbers_in_its_file_names(family, tmp_path):
    levels = mesh_family(load_scene(family), tmp_path)
    assert [level.name for level in levels] == ["column_10", "column_20", "column_30"]
    assert [level.is_own for level in levels] == [False, True, False]
    assert np.all(np.diff([level.size for level in levels]) < 0.0)


def test_a_mesh_without_family_is_refined_with_the_same_fixed_region(lonely, tmp_path):
    levels = mesh_family(load_scene(lonely), tmp_path)
    assert [level.tet_count for level in levels] == [30, 240, 1920]
    finest = Simulation(levels[-1].scene)
    positions = finest.model.nodes.rest_positions
    is_fixed = finest.model.nodes.free_index < 0
    np.testing.assert_array_equal(is_fixed, positions[:, 2] > -1e-9)


def test_errors_fall_with_refinement_and_quadratic_meshes_are_better(study):
    def errors(element, name):
        return [getattr(row, name) for row in study.rows
                if (row.element, row.law) == (element, "corotational")]
    for name in ("error_lengths", "error_tensions", "error_weightless"):
        assert np.all(np.diff(errors("linear", name)) < 0.0)
        assert errors("quadratic", name)[0] < errors("linear", name)[0]


def test_prescribed_displacements_have_smaller_errors_than_forces_on_the_coarsest_mesh(study):
    assert study.rows[0].mesh == "column_10"
    assert study.rows[0].error_lengths < study.rows[0].error_tensions


def test_every_reference_states_its_uncertainty(study):
    for reference in study.references.values():
        assert 0.0 < reference.uncertainty < 0.2
        assert reference.displacement > 1e-4
        assert len(reference.meshes) == 3


@pytest.mark.slow
def test_on_the_diamond_displacements_have_smaller_errors_than_forces(tmp_path):
    scene = load_scene(default_scene_path())
    held = with_hold_radius(scene, hold_radius(scene))
    levels = mesh_family(held, tmp_path)[:3]
    study = study_meshes(levels, Limits(1_500, 20_000, 20), lambda words: None)
    coarsest = study.rows[0]
    assert coarsest.error_lengths < 0.5 * coarsest.error_tensions


def test_rows_are_read_as_they_were_written(study, tmp_path):
    write_rows(tmp_path / "rows.csv", study.rows)
    for read, row in zip(read_rows(tmp_path / "rows.csv"), study.rows, strict=True):
        assert (read.mesh, read.element, read.law, read.dof_count) == (
            row.mesh, row.element, row.law, row.dof_count)
        assert read.error_lengths == pytest.approx(row.error_lengths, rel=1e-5)
        assert np.isnan(read.error_added)


@pytest.mark.slow
def test_the_command_writes_a_table_and_a_picture(family, tmp_path, call):
    done = call("accuracy", family, "--output", tmp_path / "out", "--timed-dof", 3000,
                "--reference-dof", 8000)
    assert done.code == 0, done.errors
    assert "observed order" in done.output
    assert (tmp_path / "out" / "accuracy.png").read_bytes().startswith(b"\x89PNG")
    rows = read_rows(tmp_path / "out" / "accuracy.csv")
    assert {row.knob for row in rows} == {MESH, NEWTON, QP, PRECISION}
    newton = [row.error_added for row in rows if row.knob == NEWTON]
    assert newton[1] < 0.1 * newton[0]
    double, single = (next(row.error_added for row in rows if row.setting.startswith(word))
                      for word in ("double", "single"))
    assert double < single < 1e-2


def fake_clock(scene, rate, iterations):
    """A measurement in which quadratic elements and two linearizations are too slow."""
    time = 1e-3 * (10.0 if scene.body.element == "quadratic" else 1.0) * iterations
    return Measured(time, time, 1e-5)


def test_choose_writes_a_scene_that_loads_and_runs(family, study, tmp_path, capsys):
    write_rows(tmp_path / "rows.csv", study.rows)
    written = tmp_path / "chosen.yaml"
    assert choose(family, 500.0, tmp_path / "rows.csv", written, fake_clock) == 0
    scene = load_scene(written)
    assert scene.mesh_path.name == "column_30.vtk"
    assert (scene.body.element, scene.body.material.law) == ("linear", "corotational")
    assert scene.solver.newton_iterations == 1
    assert scene.cables[0].rate == 0.05 and scene.cables[0].hold_radius > 0.0
    assert "Expected error" in capsys.readouterr().out
    assert written.read_text().startswith("# Made from column.yaml by 'choose' for 500 Hz")
    simulation = Simulation(scene)
    simulation.step(CommandSetpoints(simulation.rest_setpoints, 0.01))


def test_choose_studies_a_refined_mesh_and_keeps_its_files(lonely, tmp_path, monkeypatch):
    monkeypatch.setattr(choice, "QUICK", Limits(1_000, 7_000, 20))
    rows, written = tmp_path / "rows.csv", tmp_path / "chosen.yaml"
    assert choose(lonely, 100.0, rows, written, fake_clock) == 0
    assert len(read_rows(rows)) > 2
    simulation = Simulation(load_scene(written))
    assert simulation.node_count > 24


def test_rows_of_other_meshes_are_refused_by_name(lonely, study, tmp_path):
    write_rows(tmp_path / "rows.csv", study.rows)
    with pytest.raises(AccuracyError, match="none of the meshes of this scene: column"):
        choose(lonely, 100.0, tmp_path / "rows.csv", tmp_path / "chosen.yaml", fake_clock)


def test_a_file_that_accuracy_did_not_write_is_refused(family, tmp_path):
    (tmp_path / "rows.csv").write_text("a,b\n1,2\n")
    with pytest.raises(AccuracyError, match="lacks knob"):
        choose(family, 100.0, tmp_path / "rows.csv", tmp_path / "chosen.yaml", fake_clock)


def test_a_scene_without_effector_is_refused(family, tmp_path, call):
    content = yaml.safe_load(family.read_text())
    del content["effectors"]
    bare = family.parent / "bare.yaml"
    bare.write_text(yaml.safe_dump(content))
    done = call("accuracy", bare, "--output", tmp_path)
    assert done.code == 2 and "lacks cables and cavities, or effectors" in done.errors


def test_too_few_meshes_for_a_reference_are_refused(family, tmp_path):
    levels = mesh_family(load_scene(family), tmp_path)
    with pytest.raises(AccuracyError, match="needs two quadratic meshes of at most 100 dof"):
        study_meshes(levels, Limits(100, 100), lambda words: None)


def test_an_output_that_cannot_be_written_is_refused(family, study, tmp_path):
    write_rows(tmp_path / "rows.csv", study.rows)
    with pytest.raises(OutputError, match="chosen.yaml"):
        choose(family, 500.0, tmp_path / "rows.csv", tmp_path / "no" / "chosen.yaml", fake_clock)


@pytest.mark.parametrize("rate", ["0", "-5", "nan", "abc"])
def test_an_invalid_rate_is_refused(family, rate, call):
    assert call("choose", family, "--rate", rate).code == 2


def left_out_of(scene_file, tmp_path):
    """Names of the meshes of a scene's family, and the messages about skipped files."""
    said = []
    levels = mesh_family(load_scene(scene_file), tmp_path, report_skipped=said.append)
    return [level.name for level in levels], said


@pytest.mark.parametrize("size, reason", [
    ((0.02, 0.022, 0.1), "volume differs by"), ((0.02, 0.0196, 0.1035), "bounds differ by")])
def test_a_mesh_of_another_body_is_excluded_by_name(tmp_path, size, reason):
    write_mesh(tmp_path / "arm_1.vtk", column_mesh((0.02, 0.02, 0.1), (1, 1, 5)))
    write_mesh(tmp_path / "arm_2.vtk", column_mesh(size, (1, 1, 7)))
    write_mesh(tmp_path / "arm_3.vtk", column_mesh((0.02, 0.02, 0.1), (1, 1, 8)))
    names, said = left_out_of(column_scene(tmp_path, "arm_1.vtk"), tmp_path)
    assert names == ["arm_1", "arm_3"]
    assert len(said) == 1 and said[0].startswith("arm_2.vtk is left out") and reason in said[0]


def test_a_mesh_that_cannot_be_read_is_excluded_by_name(tmp_path):
    write_mesh(tmp_path / "arm_1.vtk", column_mesh((0.02, 0.02, 0.1), (1, 1, 5)))
    write_mesh(tmp_path / "arm_3.vtk", column_mesh((0.02, 0.02, 0.1), (1, 1, 8)))
    (tmp_path / "arm_2.vtk").write_text("not a mesh")
    names, said = left_out_of(column_scene(tmp_path, "arm_1.vtk"), tmp_path)
    assert names == ["arm_1", "arm_3"] and said[0].startswith("arm_2.vtk is left out")


def test_versions_of_a_robot_are_not_a_mesh_family(tmp_path):
    for version in (1, 2):
        write_mesh(tmp_path / f"arm_v{version}.vtk", column_mesh((0.02, 0.02, 0.1), (1, 1, 4)))
    names, said = left_out_of(column_scene(tmp_path, "arm_v1.vtk"), tmp_path)
    assert names == ["arm_v1", "arm_v1_refined_1", "arm_v1_refined_2"] and said == []


def test_rows_of_another_mesh_of_the_same_name_are_refused(family, study, tmp_path):
    rows = [replace(row, node_count=row.node_count + 1) for row in study.rows]
    write_rows(tmp_path / "rows.csv", rows)
    with pytest.raises(AccuracyError, match="is of another mesh column_10"):
        choose(family, 500.0, tmp_path / "rows.csv", tmp_path / "chosen.yaml", fake_clock)


def test_an_uncertain_reference_is_refused_before_timing(family, study, tmp_path):
    rows = [replace(row, uncertainty_lengths=0.9) for row in study.rows]
    write_rows(tmp_path / "rows.csv", rows)
    with pytest.raises(AccuracyError, match="an uncertainty of 90 %"):
        choose(family, 500.0, tmp_path / "rows.csv", tmp_path / "chosen.yaml", None)
    assert not (tmp_path / "chosen.yaml").exists()


def test_a_choice_with_a_large_error_is_warned_of_on_the_terminal_and_in_the_scene(
        family, study, tmp_path, capsys):
    rows = [replace(row, error_lengths=0.46 + 0.1 * row.error_lengths) for row in study.rows]
    write_rows(tmp_path / "rows.csv", rows)
    choose(family, 500.0, tmp_path / "rows.csv", tmp_path / "chosen.yaml", fake_clock)
    head = [line for line in (tmp_path / "chosen.yaml").read_text().splitlines()
            if line.startswith("# CAUTION")]
    assert "given cable lengths the error of the effector is 4" in head[0]
    assert "warning: CAUTION" in capsys.readouterr().err
    load_scene(tmp_path / "chosen.yaml")


def test_a_study_predicts_its_duration(lonely, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(choice, "QUICK", Limits(200, 2_000, 8))
    monkeypatch.setattr(choice, "study_meshes", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        choose(lonely, 100.0, None, tmp_path / "chosen.yaml", fake_clock)
    assert "Their study takes about " in capsys.readouterr().err


@pytest.mark.parametrize("seconds, words", [
    (1.0, "about 5 s"), (42.0, "about 40 s"), (300.0, "about 5 minutes")])
def test_durations_are_printed_in_rounded_units(seconds, words):
    assert approximate_duration(seconds) == words
