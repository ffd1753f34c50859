"""Accuracy and choice on a column of three meshes, and on the coarse Diamonds."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from specimens import column_mesh

from softrobot_twin.harness.output_file import OutputError
from softrobot_twin.harness.study_rows import write_rows
from softrobot_twin.reduction.body_training import reduce
from softrobot_twin.reduction.training_options import TrainingOptions
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.study import accuracy_study, choice
from softrobot_twin.study.accuracy import full_row
from softrobot_twin.study.accuracy_study import (
    MESH,
    REDUCED,
    AccuracyError,
    Limits,
    Setting,
    differences,
    mesh_family,
    read_study,
    study_meshes,
    study_reduced,
    with_hold_radius,
    write_mesh,
    write_scene_copy,
)
from softrobot_twin.study.bench_measurement import default_scene_path
from softrobot_twin.study.choice import Measured, choose
from softrobot_twin.study.reduced_models import beside, every_level, reduced_models
from test.scene_changes import yaml_file

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
    return yaml_file(folder / "column.yaml", scene)


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
def levels(family, tmp_path_factory):
    scene = load_scene(family)
    held = with_hold_radius(scene)
    return mesh_family(held, tmp_path_factory.mktemp("none"))


@pytest.fixture(scope="module")
def study(levels):
    return study_meshes(levels, Limits(3_000, 4_000, 8))


@pytest.fixture(scope="module")
def fine_study(levels):
    return study_meshes(levels, Limits(3_000, 8_000, 8))


@pytest.fixture(scope="module")
def trained(family, levels, tmp_path_factory):
    """File of the reduced model of the middle mesh, trained for the poses of a study."""
    folder = tmp_path_factory.mktemp("trained")
    scene, file = folder / "column_20.yaml", folder / "column_20_reduced.npz"
    write_scene_copy(scene, levels[1].scene, Setting("column_20", "linear", "corotational", 1), [])
    reduce(scene, TrainingOptions(
        energy=1.0e-5, tolerance=5.0e-3, snapshots=60, states=0, workers=1, output=file, tilt=np.pi,
        ranges=tuple(f"{name}_shortening_m=0:0.008" for name in "abc")))
    return file


def test_a_mesh_family_is_found_by_the_numbers_in_its_file_names(family, tmp_path):
    levels = mesh_family(load_scene(family), tmp_path)
    assert [level.name for level in levels] == ["column_10", "column_20", "column_30"]
    assert np.all(np.diff([level.size for level in levels]) < 0.0)


def test_a_mesh_without_family_is_refined_with_the_same_fixed_region(lonely, tmp_path):
    levels = mesh_family(load_scene(lonely), tmp_path)
    assert [level.tet_count for level in levels] == [30, 240, 1920]
    finest = Simulation(levels[-1].scene)
    positions = finest.model.nodes.rest_positions
    is_fixed = finest.model.nodes.free_index < 0
    np.testing.assert_array_equal(is_fixed, positions[:, 2] > -1e-9)


@pytest.mark.exhaustive
def test_errors_fall_with_refinement_and_quadratic_meshes_are_better(fine_study):
    def errors(element, name):
        return [getattr(row, name) for row in fine_study.rows
                if (row.element, row.law) == (element, "corotational")]
    for name in ("error_lengths", "error_tensions", "error_weightless"):
        assert np.all(np.diff(errors("linear", name)) < 0.0)
        assert errors("quadratic", name)[0] < errors("linear", name)[0]


@pytest.mark.exhaustive
def test_every_reference_states_its_uncertainty(fine_study):
    for reference in fine_study.references.values():
        assert 0.0 < reference.uncertainty < 0.2
        assert reference.displacement > 1e-4
        assert len(reference.meshes) == (2 if reference.limit.order is None else 3)


@pytest.mark.exhaustive
def test_the_command_writes_a_table_and_a_picture(family, trained, tmp_path, call, monkeypatch):
    # Times do not matter here.
    monkeypatch.setattr(accuracy_study, "Limits", partial(Limits, timed_steps=8))
    done = call("accuracy", family, "--output", tmp_path / "out", "--timed-dof", 3000,
                "--reference-dof", 8000, "--reduced", trained)
    assert "extrapolated by" in done.output and "Reduced models: " in done.output
    assert (tmp_path / "out" / "accuracy.png").read_bytes().startswith(b"\x89PNG")
    rows = read_study(tmp_path / "out" / "accuracy.csv")
    assert {row.knob for row in rows} == {MESH, REDUCED}
    assert [row.mesh for row in rows if row.knob == REDUCED] == ["column_20"]


def fake_clock(scene, rate, iterations):
    """A measurement in which quadratic elements and two linearizations are too slow."""
    time = 1e-3 * (10.0 if scene.body.element == "quadratic" else 1.0) * iterations
    return Measured(time, time, 1e-5)


def test_choose_writes_a_scene_that_loads_and_runs(family, study, tmp_path, capsys):
    # Rows of a machine that other programs keep busy would be left out as much too slow.
    write_rows(tmp_path / "rows.csv", [replace(row, step_ms=1.0) for row in study.rows])
    written = tmp_path / "chosen.yaml"
    assert choose(family, 500.0, tmp_path / "rows.csv", written, fake_clock) == 0
    scene = load_scene(written)
    assert scene.mesh_path.name == "column_30.vtk"
    assert (scene.body.element, scene.body.material.law) == ("smoothed", "corotational")
    assert scene.solver.newton_iterations == 1
    assert scene.cables[0].rate == 0.05 and scene.cables[0].hold_radius > 0.0
    assert "Expected error" in capsys.readouterr().out
    assert written.read_text().startswith("# Made from column.yaml by 'choose' for 500 Hz")
    simulation = Simulation(scene)
    simulation.step(CommandSetpoints(simulation.rest_setpoints, 0.01))


@pytest.mark.exhaustive
def test_choose_studies_a_refined_mesh_and_keeps_its_files(lonely, tmp_path, monkeypatch):
    monkeypatch.setattr(choice, "QUICK", Limits(1_000, 2_000, 8))
    rows, written = tmp_path / "rows.csv", tmp_path / "chosen.yaml"
    assert choose(lonely, 100.0, rows, written, fake_clock) == 0
    assert len(read_study(rows)) > 2
    simulation = Simulation(load_scene(written))
    assert simulation.node_count > 24


def as_written(rows):
    return rows


@pytest.mark.parametrize("scene, rows, output, words", [
    ("lonely", as_written, "chosen.yaml", "none of the meshes of this scene: column"),
    ("family", None, "chosen.yaml", "lacks knob"),
    ("family", as_written, "no/chosen.yaml", "chosen.yaml"),
    ("family", lambda rows: [replace(row, node_count=row.node_count + 1) for row in rows],
     "chosen.yaml", "is of another mesh column_10"),
    ("family", lambda rows: [replace(row, uncertainty_lengths=0.9) for row in rows],
     "chosen.yaml", "an uncertainty of 90 %"),
], ids=["other meshes", "another file", "no folder", "another mesh", "uncertain"])  # fmt: skip
def test_what_cannot_be_chosen_from_is_refused_by_name(request, study, tmp_path, scene, rows, output, words):
    if rows is None:
        (tmp_path / "rows.csv").write_text("a,b\n1,2\n")
    else:
        write_rows(tmp_path / "rows.csv", rows(study.rows))
    # Nothing is timed of what is too uncertain.
    clock = None if "uncertainty" in words else fake_clock
    with pytest.raises(OutputError if "/" in output else AccuracyError, match=words):
        choose(request.getfixturevalue(scene), 500.0, tmp_path / "rows.csv", tmp_path / output, clock)
    assert not (tmp_path / output).exists()


def test_too_few_meshes_for_a_reference_are_refused(family, tmp_path):
    levels = mesh_family(load_scene(family), tmp_path)
    with pytest.raises(AccuracyError, match="needs two quadratic meshes of at most 100 dof"):
        study_meshes(levels, Limits(100, 100))


@pytest.mark.parametrize("size, reason", [
    ((0.02, 0.022, 0.1), "volume differs by"), ((0.02, 0.0196, 0.1035), "bounds differ by"),
    (None, ""),
])  # fmt: skip
def test_a_mesh_of_another_body_or_that_cannot_be_read_is_excluded_by_name(tmp_path, size, reason, capsys):
    for number, layers in ((1, 5), (3, 8)):
        write_mesh(tmp_path / f"arm_{number}.vtk", column_mesh((0.02, 0.02, 0.1), (1, 1, layers)))
    if size is None:
        (tmp_path / "arm_2.vtk").write_text("not a mesh")
    else:
        write_mesh(tmp_path / "arm_2.vtk", column_mesh(size, (1, 1, 7)))
    levels = mesh_family(load_scene(column_scene(tmp_path, "arm_1.vtk")), tmp_path)
    assert [level.name for level in levels] == ["arm_1", "arm_3"]
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("warning: arm_2.vtk is left out") and reason in said


def test_a_choice_with_a_large_error_is_warned_of_on_the_terminal_and_in_the_scene(
        family, study, tmp_path, capsys):
    rows = [replace(row, error_lengths=0.46 + 0.1 * row.error_lengths, uncertainty_lengths=0.01)
            for row in study.rows]
    write_rows(tmp_path / "rows.csv", rows)
    choose(family, 500.0, tmp_path / "rows.csv", tmp_path / "chosen.yaml", fake_clock)
    head = [line for line in (tmp_path / "chosen.yaml").read_text().splitlines()
            if line.startswith("# CAUTION")]
    assert "given cable lengths the error of the effector is 4" in head[0]
    assert "warning: CAUTION" in capsys.readouterr().err
    load_scene(tmp_path / "chosen.yaml")


def test_a_reduced_model_is_found_by_what_it_was_made_from(trained, levels):
    (model,) = reduced_models((), beside(trained.parent), every_level(levels, ()))
    assert (model.level.name, model.level.scene.body.element) == ("column_20", "linear")
    assert model.mode_count % 3 == 0 and model.point_count > model.mode_count


def test_a_file_of_another_body_is_refused_where_it_is_given_and_else_left_out(trained, levels):
    others = [levels[0], levels[2]]
    assert reduced_models((), (trained,), others) == []
    with pytest.raises(AccuracyError, match="none of the meshes column_10, column_30"):
        reduced_models((trained,), (), others)


@pytest.mark.parametrize("name, reason", [("none.npz", "does not exist"), ("bad.npz", "is no ")])
def test_a_file_that_is_no_reduced_model_is_refused(name, reason, levels, tmp_path):
    (tmp_path / "bad.npz").write_text("not an archive")
    with pytest.raises(AccuracyError, match=f"{name}: {reason}"):
        reduced_models((tmp_path / name,), (), levels)


def test_the_error_of_a_reduced_model_includes_that_of_its_mesh(trained, study, levels):
    (model,) = reduced_models((trained,), (), levels)
    row = study_reduced(model, study, 8)
    full = full_row(study.rows, row)
    assert (row.knob, row.file, row.dof_count) == (REDUCED, trained.name, model.mode_count)
    assert row.node_count == full.node_count
    # The poses served for no choice; the mesh's own error is some 30 %.
    for name in ("error_lengths", "error_weightless", "error_tensions"):
        assert getattr(row, name) == pytest.approx(getattr(full, name), abs=0.02), name
    assert full.error_lengths > 0.1
    # What `choose` measures where there is no study is the distance from the full model.
    apart = differences(model.level.scene, model.scene)
    assert 0.0 < apart.moved < 0.02 and 0.0 < apart.pressed < 0.05


def test_a_scene_with_patterns_is_copied_with_its_cables_written_out(tmp_path):
    original = default_scene_path()
    assert "repeat" in original.read_text()
    scene = load_scene(original)
    held = with_hold_radius(scene, 0.004)
    write_scene_copy(tmp_path / "held.yaml", held,
                     Setting("diamond_1600", "linear", "corotational", 2), [])
    copied = load_scene(tmp_path / "held.yaml")
    assert [cable.name for cable in copied.cables] == [cable.name for cable in scene.cables]
    assert {cable.hold_radius for cable in copied.cables} == {0.004}


def clock_of_reduced(scene, rate, iterations):
    """A measurement in which only reduced models and the coarsest mesh are fast."""
    is_small = (scene.mesh_path.stem, scene.body.element) == ("column_10", "linear")
    time = (1e-4 if is_small or scene.body.reduced is not None else 1e-1) * iterations
    return Measured(time, time, 1e-5)


def test_choose_writes_a_scene_with_the_reduced_model_that_is_there(family, trained, study, tmp_path, capsys):
    write_rows(tmp_path / "rows.csv", study.rows)
    written = tmp_path / "made" / "chosen.yaml"
    written.parent.mkdir()
    choose(family, 500.0, tmp_path / "rows.csv", written, clock_of_reduced, reduced=[trained])
    told = capsys.readouterr().out
    assert "column_20, linear tets, corotational law, reduced by column_20_reduced.npz" in told
    assert "by mesh, element, law and reduction" in told
    scene = load_scene(written)
    assert scene.file_path(scene.body.reduced.file).samefile(trained)
    simulation = Simulation(scene)
    assert simulation.dof_count < 100 and simulation.node_count > 30
    simulation.step(CommandSetpoints(simulation.rest_setpoints, 0.01))

    # From that scene on: its own reduced model is a candidate, and a full one may be chosen.
    again = tmp_path / "again.yaml"
    choose(written, 500.0, tmp_path / "rows.csv", again, clock_of_reduced)
    assert load_scene(again).body.reduced is not None
    choose(written, 1.0, tmp_path / "rows.csv", again, fake_clock)
    assert load_scene(again).body.reduced is None


def test_choose_takes_the_error_of_a_reduced_model_from_the_file_of_errors(
        family, trained, study, levels, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(choice, "differences", lambda *_: 1 / 0)
    (model,) = reduced_models((trained,), (), levels)
    full = next(row for row in study.rows if row.mesh == "column_20")
    known = replace(full, knob=REDUCED, file=model.path.name, mode_count=model.mode_count,
                    point_count=model.point_count, error_lengths=0.0123, error_weightless=0.0)
    write_rows(tmp_path / "rows.csv", [*study.rows, known])
    choose(family, 500.0, tmp_path / "rows.csv", tmp_path / "chosen.yaml", clock_of_reduced,
           reduced=[trained])
    assert "Expected error of the effector for given cable lengths: 1.23 %" in capsys.readouterr().out
