"""``bench`` over mesh sizes: its output, its files and its measurements."""

import csv
import gc

import numpy as np
import pytest
from specimens import column_mesh

from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.schema import Control, Observer
from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.superlu import SuperLU
from softrobot_twin.study import bench
from softrobot_twin.study.bench import SOFA_RATIOS
from softrobot_twin.study.bench_measurement import (
    CONTROL,
    OBSERVER,
    OUTSIDE,
    WHOLE_STEP,
    BenchCase,
    default_scene_path,
    flop_count,
    given_cases,
    growth_exponent,
    measure,
    standard_cases,
    without_garbage_collection,
)
from softrobot_twin.study.timing import SuperLUReference
from test.run_files import rows_of

COLUMNS = """
scene family nodes tets dof modes points rows contacts factorization threads steps stage median_ms p99_ms
max_ms ratio_to_superlu growth_exponent superlu_ms superlu_samples superlu_page_faults
interrupted_share factor_flop solves_flop dgemm_flop_per_s share_of_dgemm_speed factor_bytes
resident_bytes full_ms ratio_to_full python_calls kernel_share beside_step_ms
"""


@pytest.fixture(scope="module")
def measured(column):
    return measure(given_cases([column])[0], 5)


@pytest.mark.libraries
def test_bench_writes_a_row_for_each_stage_and_a_picture(column, tmp_path, call):
    done = call("bench", column, "--steps", 5, "--output", tmp_path / "made")
    assert done.code == 0, done.errors
    simulation = Simulation.from_scene_file(column)
    rows = rows_of(tmp_path / "made" / "bench.csv")
    assert list(rows[0]) == COLUMNS.split()
    assert [row["stage"] for row in rows] == [*simulation.stages, OUTSIDE, WHOLE_STEP]
    for row in rows:
        assert 0.0 < float(row["median_ms"]) <= float(row["p99_ms"]) <= float(row["max_ms"])
        assert row["growth_exponent"] == ""  # a single size has no growth
        assert (row["scene"], row["steps"]) == ("column", "5")
    assert (tmp_path / "made" / "bench.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.exhaustive
def test_an_observer_is_a_stage_beside_the_step(measured):
    scene = load_scene(default_scene_path()).changed(observer=Observer())
    case = given_cases([default_scene_path()])[0]._replace(scene=scene)
    assert measure(case, 5).stages[OBSERVER].median > 0.0
    assert OBSERVER not in measured.stages


@pytest.mark.exhaustive
def test_control_is_a_stage_beside_the_step(measured):
    path = default_scene_path().with_name("finger.yaml")
    scene = load_scene(path).changed(
        integration="dynamic", cables={"rate": None}, control=Control(inputs="efforts"))
    case = given_cases([path])[0]._replace(scene=scene)
    assert measure(case, 5).stages[CONTROL].median > 0.0
    assert CONTROL not in measured.stages


def test_several_scenes_are_fitted_together(column, tmp_path, call):
    finer = tmp_path / "finer.yaml"
    text = column.read_text().replace("column.vtk", str(column.parent / "column.vtk"))
    finer.write_text(text.replace("-0.001], maximum: [1.0, 1.0, 0.001]",
                                  "-0.001], maximum: [1.0, 1.0, 0.021]"))
    done = call("bench", column, finer, "--steps", 2)
    assert done.code == 0, done.errors
    assert "Growth" in done.output and "(2 sizes)" in done.output


def test_stages_and_the_remainder_sum_to_at_most_the_slowest_step(measured):
    inner = [times for name, times in measured.stages.items() if name != WHOLE_STEP]
    assert measured.stages[WHOLE_STEP].maximum <= sum(times.maximum for times in inner) + 1e-9
    assert measured.stages[OUTSIDE].median > 0.0
    assert sum(measured.statuses.values()) == measured.step_count == 5


def test_the_growth_of_a_power_is_its_exponent():
    sizes = np.array([500.0, 1000.0, 4000.0, 40000.0])
    assert growth_exponent(sizes, 3e-7 * sizes**1.75) == pytest.approx(1.75, rel=1e-12)
    assert growth_exponent([*sizes, 7.0], [*(2.0 * sizes), np.nan]) == pytest.approx(1.0)
    assert np.isnan(growth_exponent([10.0], [1.0]))
    assert np.isnan(growth_exponent([10.0, 10.0], [1.0, 2.0]))


def test_a_verdict_states_the_bar_and_both_times(measured):
    met, tail = bench.check_requirements(measured)
    assert met.startswith(f"required {bench.REQUIRED_RATIO}: ")
    assert ("not met" in met) == (measured.ratio > bench.REQUIRED_RATIO)
    assert f"{measured.ratio:.3f}" in met and f"{measured.tail:.2f}" in tail
    assert ("not met" in tail) == (measured.tail >= bench.REQUIRED_TAIL)


def test_the_yardstick_reads_the_matrix_that_superlu_assembles(column):
    scene = load_scene(column)
    solver = scene.solver.model_copy(update={"factorization": "superlu"})
    matrices = []
    for chosen in (scene, scene.model_copy(update={"solver": solver})):
        simulation = Simulation(chosen)
        simulation.warm_up()
        matrices.append(SuperLUReference(simulation.model.factorization).matrix())
    ours, theirs = matrices
    assert abs(ours - ours.T).max() < 1e-9 * abs(ours).max()
    assert abs(ours - theirs).max() < 1e-9 * abs(theirs).max()


def test_flops_of_a_dense_matrix_are_the_textbook_count():
    from softrobot_twin.solvers.multifrontal import Multifrontal
    nodes = 6
    rows, columns = np.tril_indices(nodes)
    factorization = Multifrontal(rows, columns, nodes)
    n, k = 3 * nodes, 2
    counted = flop_count(factorization, np.array([0]), k)
    assert counted.factor == n * (n + 1) * (2 * n + 1) / 6
    triangle = n * (n + 1)  # a multiplication and an addition for each entry of L
    assert counted.solves == (k + 1) * triangle + (k + 1) * (k + 2) * n + triangle


def test_a_factorization_without_fronts_has_no_flop_count():
    assert flop_count(SuperLU(np.array([0]), np.array([0]), 1), np.array([0]), 1) is None


def test_the_standard_sizes_reach_from_500_to_50_000_dof_and_carry_one_bar():
    cases = standard_cases()
    assert [case.name for case in cases if case.has_requirements] == ["diamond_600"]
    assert all(body.mesh.box is not None or case.scene.file_path(body.mesh.file).is_file()
               for case in cases for body in case.scene.deformables)
    first = Simulation(cases[0].scene)
    assert first.dof_count == pytest.approx(500, rel=0.05) and first.notes == ()
    assert 3 * 13 * 13 * 98 == pytest.approx(50_000, rel=0.05)
    assert [case.name for case in cases[-14:]] == [
        "column_12x12x98", "grasper", "octoleg", "trunk_700", "trunk_900", "springy",
        "pneunet_inverse", "fetch", "fetch_reduced", "cantilever", "flexo", "stifface",
        "diamond_quadratic", "diamond_reduced"]
    assert {case.name: case.paper.required for case in cases[-9:] if case.paper} == {
        "springy": 4.0e-3, "pneunet_inverse": 2.0e-3, "fetch_reduced": 0.25e-3,
        "flexo": 0.4e-3, "stifface": 3.0e-3, "diamond_reduced": 0.3e-3}


def test_a_column_fills_its_box_with_good_elements():
    mesh = column_mesh((0.03, 0.03, 0.2), (2, 3, 18))
    assert mesh.volume == pytest.approx(0.03 * 0.03 * 0.2)
    assert mesh.bounding_box == pytest.approx(
        np.array([[-0.015, -0.015, -0.2], [0.015, 0.015, 0.0]]))
    assert radius_ratios(mesh).min() > 0.15


def test_garbage_collection_is_off_inside_and_restored_after():
    assert gc.isenabled()
    with pytest.raises(KeyError), without_garbage_collection():
        assert not gc.isenabled()
        raise KeyError
    assert gc.isenabled()


def test_the_picture_shows_sofa_as_measured_and_at_its_best():
    assert sorted(SOFA_RATIOS.values()) == [0.78, 1.37]


@pytest.mark.exhaustive
def test_a_reduced_model_is_compared_with_its_full_one(tmp_path, call):
    reduced = default_scene_path().parent / "diamond_reduced.yaml"
    done = call("bench", reduced, "--steps", 3, "--output", tmp_path)
    assert done.code == 0, done.errors
    assert "times faster than its full model diamond_quadratic (" in done.output
    assert "required 0.300 ms" in done.output and "required p99 <= 1.3 × median" in done.output
    assert "Growth" not in done.output  # two models of one mesh are no family
    theirs, ours = (row for row in rows_of(tmp_path / "bench.csv") if row["stage"] == WHOLE_STEP)
    # Sizes are those of the mesh.
    assert (ours["nodes"], ours["tets"]) == (theirs["nodes"], theirs["tets"])
    modes = int(ours["modes"])
    assert 10 < modes < 60 and int(ours["dof"]) == modes and int(ours["points"]) > modes
    assert theirs["modes"] == theirs["points"] == theirs["full_ms"] == ""
    assert ours["full_ms"] == theirs["median_ms"]
    # A factorization of so few unknowns is no yardstick.
    assert ours["superlu_ms"] == "" and float(theirs["superlu_ms"]) > 0.0


@pytest.mark.exhaustive
def test_a_reduced_model_alone_is_timed(call, tmp_path):
    package = default_scene_path().parents[2]
    scene = (package / "config" / "scenes" / "diamond_reduced.yaml").read_text()
    alone = tmp_path / "alone.yaml"
    alone.write_text(scene.replace("../../meshes", str(package / "meshes")))
    done = call("bench", alone, "--steps", 3, "--output", tmp_path)
    assert done.code == 0, done.errors
    assert "give its full scene too" in done.output and " modes" in done.output


def test_cases_of_given_scenes_are_one_family_without_a_bar(column):
    case = given_cases([column])[0]
    assert isinstance(case, BenchCase) and not case.has_requirements


@pytest.mark.exhaustive
def test_a_step_that_grew_is_marked_beside_an_earlier_run(column, tmp_path, call):
    done = call("bench", column, "--steps", 4, "--output", tmp_path)
    assert done.code == 0, done.errors
    rows = rows_of(tmp_path / "bench.csv")
    whole = next(row for row in rows if row["stage"] == WHOLE_STEP)
    assert float(whole["python_calls"]) > 100.0
    assert 0.05 < float(whole["kernel_share"]) < 1.0
    assert float(whole["beside_step_ms"]) > 0.0

    def earlier(name, ratio, calls):
        path = tmp_path / f"{name}.csv"
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerow(whole | {"ratio_to_superlu": ratio, "python_calls": calls})
        return path

    slow, lean = earlier("slow", 1e6, 1e6), earlier("lean", 1e-6, 1.0)
    same = call("bench", column, "--steps", 4, "--compare", slow)
    assert same.code == 0 and "An earlier run" in same.output and "slower" not in same.output
    grown = call("bench", column, "--steps", 4, "--compare", lean)
    assert "slower, more calls" in grown.output
