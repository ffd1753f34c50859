"""Files, pictures and times of scenes with cavities: columns, tables, `explain`, `bench`."""

import numpy as np
import pytest
import yaml

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Simulation
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.study.bench_measurement import (
    NothingToFollowError,
    circle_targets,
    given_cases,
    measure,
    swept_setpoints,
)
from softrobot_twin.study.scene_picture import take_snapshot
from softrobot_twin.tables.input_tables import TableFileError, read_commands, read_targets
from softrobot_twin.tables.run_columns import actuator_cells, actuator_columns
from softrobot_twin.view.drawn_parts import CavityDisplay
from test.builder import builder
from test.run_files import rows_of
from test.scene_changes import LEFT_OUT, change_scene, changed, yaml_file


@pytest.fixture(scope="module")
def springy(tmp_path_factory):
    """Scene file of the coarsest Springy, inflated by a pressure, with a cable along its axis."""
    from pathlib import Path

    meshes = Path(__file__).parents[2] / "meshes"
    scene = {
        "name": "springy", "gravity": [0.0, 0.0, 0.0],
        "body": {"mesh": {"file": str(meshes / "springy_400.msh")}, "element": "linear",
                 "material": {"young_modulus": 5.0e4, "poisson_ratio": 0.3, "density": 1070.0},
                 "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-4]}}]},
        "cables": [{"name": "line", "pull_point": [0.02, 0.0, -0.01], "hold_radius": 0.01,
                    "points": [[0.02, 0.0, 0.048]], "shortening": [0.0, 0.005],
                    "tension": [0.0, 5.0]}],
        "cavities": [{"name": "air", "walls": [{"part": "cavity"}], "pressure": [-100.0, 1500.0],
                      "growth": [-2.0e-6, 8.0e-6], "rate": 1.0e4}],
        "effectors": [{"name": "top", "points": [[0.0, 0.0, 0.05]], "directions": ["z"]}],
        "solver": {"newton_iterations": 10, "residual_tolerance": 1e-6}}
    return yaml_file(tmp_path_factory.mktemp("springy") / "springy.yaml", scene)


@builder
def simulation_of(springy, /, change=None, **cavity) -> Simulation:
    """Makes a simulation of that scene; a function may change it."""
    content = written_out(yaml.safe_load(springy.read_text()))
    content["cavities"][0].update(cavity)
    change_scene(content, change)
    return Simulation(scene_from_mapping(content, springy))


def test_what_a_regulator_holds_is_written_once_and_its_volume_beside_it(simulation_of):
    simulation = simulation_of()
    result = simulation.step(CommandSetpoints([*simulation.rest_setpoints[:1], 400.0], 1.0))
    columns = [column(*one) for one in actuator_columns(simulation.actuators)]
    assert columns == ["line_length_m", "line_tension_N", "line_shortening_m",
                       "line_rest_length_m", "line_path_m", "air_pressure_Pa", "air_growth_m3",
                       "air_volume_m3"]
    cells = dict(zip(columns, actuator_cells(result, simulation.actuators), strict=True))
    assert cells["air_pressure_Pa"] == pytest.approx(400.0) == result.efforts[1]
    (volume,) = CavityDisplay(simulation.model).volumes(simulation.state)
    assert cells["air_volume_m3"] == pytest.approx(volume, rel=1e-12)
    assert cells["air_growth_m3"] == pytest.approx(volume - 5.47e-6, rel=1e-3)


def test_what_a_syringe_holds_is_written_with_its_pressure(simulation_of):
    simulation = simulation_of(control="volume")
    simulation.step(CommandSetpoints(simulation.rest_setpoints * [1.0, 1.1], 1.0))
    columns = [column(*one) for one in actuator_columns(simulation.actuators)]
    assert columns[5:] == ["air_volume_m3", "air_pressure_Pa", "air_growth_m3", "air_rest_volume_m3"]
    result = simulation.step(Hold(1.0))
    volume, pressure, growth, rest = actuator_cells(result, simulation.actuators)[5:]
    assert volume == pytest.approx(1.1 * rest) and pressure == result.efforts[1] > 0.0
    assert growth == pytest.approx(volume - rest)


def table_of(reader, folder, simulation, text):
    """What a reader of targets or of commands makes of a file."""
    (folder / "table.csv").write_text(text)
    return reader(folder / "table.csv", simulation)


@builder
def targets(tmp_path, /, simulation, text):
    """Reads a targets file for a simulation."""
    return table_of(read_targets, tmp_path, simulation, text)


@builder
def commands(tmp_path, /, simulation, text):
    """Reads a commands file for a simulation."""
    return table_of(read_commands, tmp_path, simulation, text)


def test_lengths_of_cables_and_pressures_of_cavities_stand_in_one_table(simulation_of, targets, commands):
    simulation = simulation_of()
    command = targets(simulation, "time_s,air_pressure_Pa,line_length_m\n0,300,0.05\n").command(0)
    assert isinstance(command, CommandSetpoints)
    np.testing.assert_array_equal(command.setpoints, [0.05, 300.0])
    table = commands(simulation, "time_s,line_shortening_m,air_pressure_Pa\n0,0,0\n1,0.002,300\n")
    command = table.command(0.5, 0.1)
    assert isinstance(command, CommandSetpoints)
    np.testing.assert_allclose(command.setpoints, simulation.rest_setpoints + [-0.001, 150.0])


def test_tensions_of_cables_and_pressures_of_cavities_are_efforts(simulation_of, targets, commands):
    for control in ("pressure", "volume"):
        simulation = simulation_of(control=control)
        command = targets(simulation, "time_s,air_pressure_Pa,line_tension_N\n0,300,2\n").command(0)
        assert isinstance(command, CommandEfforts)
        np.testing.assert_array_equal(command.efforts, [2.0, 300.0])
        table = commands(simulation, "time_s,line_tension_N,air_pressure_Pa\n0,0,0\n1,2,300\n")
        assert isinstance(table.command(0.5, 0.1), CommandEfforts)


def test_volumes_and_growths_command_a_syringe(simulation_of, targets, commands):
    simulation = simulation_of(control="volume")
    command = targets(simulation, "time_s,air_volume_m3,line_length_m\n0,6e-6,0.05\n").command(0)
    assert isinstance(command, CommandSetpoints)
    np.testing.assert_array_equal(command.setpoints, [0.05, 6e-6])
    table = commands(simulation, "time_s,line_length_m,air_growth_m3\n0,0.05,0\n1,0.05,1e-6\n")
    np.testing.assert_allclose(table.command(1.0, 0.1).setpoints, [0.05, simulation.rest_setpoints[1] + 1e-6])


VOLUME_BESIDE_LENGTH = ("cannot be combined with line_length_m.*setpoints of this scene are "
                        "line_length_m, air_volume_m3")  # fmt: skip


@pytest.mark.parametrize("reader, control, text, column, words", [
    *((read_targets, *row) for row in (
        ("pressure", "time_s,line_length_m,air_volume_m3\n0,1,1\n", "air_volume_m3",
         "this cavity is driven by its pressure, its volume follows: use air_pressure_Pa"),
        ("pressure", "time_s,line_length_m,air_length_m\n0,1,1\n", "air_length_m",
         "this cavity is driven by its pressure"),
        ("volume", "time_s,line_length_m,air_pressure_Pa\n0,1,1\n", "air_pressure_Pa",
         VOLUME_BESIDE_LENGTH),
        ("volume", "time_s,line_length_m,air_volume_m3\n0,1,-1e-6\n", "air_volume_m3",
         "-1e-06 m3: must not be neg"),
        ("pressure", "time_s,line_length_m,air_pressure_Pa\n0,1,high\n", "air_pressure_Pa",
         "'high' Pa: must be a"),
        ("pressure", "time_s,line_length_m,air_kPa\n0,1,1\n", "air_kPa", "<cavity>_pressure_Pa"))),
    *((read_commands, *row) for row in (
        ("pressure", "time_s,line_length_m,air_growth_m3\n0,1,0\n1,1,0\n", "air_growth_m3",
         "air_growth_m3: this cavity is driven by its pressure, its growth follows: "
         "use air_pressure_Pa"),
        ("pressure", "time_s,line_length_m,air_volume_m3\n0,1,0\n1,1,0\n", "air_volume_m3",
         "its volume follows"),
        ("volume", "time_s,line_length_m,air_pressure_Pa\n0,1,0\n1,1,0\n", "air_pressure_Pa",
         VOLUME_BESIDE_LENGTH),
        ("pressure", "time_s,line_length_m,air_kPa\n0,1,0\n1,1,0\n", "air_kPa",
         "<cavity>_pressure_Pa .cavities: air."))),
])  # fmt: skip
def test_a_column_that_does_not_fit_a_cavity_is_refused(
    simulation_of, tmp_path, reader, control, text, column, words
):
    with pytest.raises(TableFileError, match=words) as caught:
        table_of(reader, tmp_path, simulation_of(control=control), text)
    assert caught.value.column == column and "table.csv" in str(caught.value)


@pytest.mark.exhaustive
def test_a_run_of_commands_writes_pressures_and_a_picture(springy, tmp_path, call):
    table = tmp_path / "commands.csv"
    table.write_text("time_s,line_shortening_m,air_pressure_Pa\n0,0,0\n1,0,400\n")
    picture = tmp_path / "springy.png"
    call("simulate", springy, "--commands", table, "--rate", 10, "--picture", picture,
         "--output", tmp_path / "run.csv")
    rows = rows_of(tmp_path / "run.csv")
    pressures = [float(row["air_pressure_Pa"]) for row in rows]
    assert pressures == pytest.approx(np.arange(1, 11) * 40.0)
    assert float(rows[-1]["air_volume_m3"]) > float(rows[0]["air_volume_m3"]) > 5.4e-6
    assert [name for name in rows[0] if name.startswith("air")] == [
        "air_pressure_Pa", "air_growth_m3", "air_volume_m3"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def add_cushion(content):
    """A sealed cavity in a second Springy beside the first."""
    body = content.pop("body")
    twin = {**body, "name": "twin", "mesh": {**body["mesh"], "translation": [0.1, 0.0, 0.0]},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-4]}}]}
    content["bodies"] = [{**body, "name": "first"}, twin]
    content["cavities"][0]["walls"][0]["body"] = "first"
    content["cables"][0]["body"] = content["effectors"][0]["body"] = "first"
    content["sealed_cavities"] = [
        {"name": "cushion", "walls": [{"part": "cavity", "body": "twin"}], "pressure": 200.0}]


def test_a_picture_shows_walls_of_all_cavities_inside_clear_bodies(simulation_of):
    simulation = simulation_of(add_cushion)
    simulation.step(CommandSetpoints([*simulation.rest_setpoints[:1], 400.0], 1.0))
    shot = take_snapshot(simulation, None, "now")
    air, cushion = cavities = [solid for solid in shot.solids if solid.kind == "cavity"]
    assert air.value == pytest.approx(0.4)
    assert 0.0 < cushion.value < 0.2
    assert {solid.look for solid in shot.solids if solid.kind != "cavity"} == {"clear", "thin"}
    tops = [cavity.triangles[..., 2].max() for cavity in cavities]
    assert tops[0] > tops[1] > 0.04


def test_a_scene_without_effector_is_timed_while_its_actuators_move_over_their_limits(simulation_of, springy):
    simulation = simulation_of(changed({"effectors": LEFT_OUT}))
    swept = swept_setpoints(simulation)
    setpoints = np.array([next(swept).setpoints for _ in range(500)])
    np.testing.assert_allclose(setpoints[:, 1].min(), -100.0, rtol=1e-3)
    np.testing.assert_allclose(setpoints[:, 1].max(), 1500.0, rtol=1e-3)
    rest = simulation.rest_setpoints[0]
    np.testing.assert_allclose(setpoints[:, 0].max(), rest, rtol=1e-6)
    np.testing.assert_allclose(setpoints[:, 0].min(), rest - 0.005, rtol=1e-4)
    case = given_cases([springy])[0]
    timed = measure(case._replace(scene=simulation.scene), 5)
    assert timed.row_count == 2 and set(timed.qp_solvers) == {""}


def test_a_scene_with_an_effector_is_timed_on_a_circle_with_inflated_cavities(simulation_of):
    simulation = simulation_of()
    circle_targets(simulation)
    assert simulation.state.efforts[1] == pytest.approx(0.25 * 1500.0, rel=0.5)


def test_a_pressure_without_limit_cannot_be_timed(simulation_of):
    simulation = simulation_of(pressure=[0.0, float("inf")])
    with pytest.raises(NothingToFollowError, match="air.pressure has no upper limit"):
        swept_setpoints(simulation)
