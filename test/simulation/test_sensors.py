"""Sensors: rows against finite differences, what they show against geometry, and targets for them."""

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.analysis.mesh_error import MeshErrorEstimator
from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Status
from softrobot_twin.study.offline_run import columns_of, run
from softrobot_twin.tables.input_tables import TableFileError, read_targets
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import builder
from test.scene_changes import repeat_step

LINE = [[0.01, 0.003, 0.005], [0.01, 0.003, 0.02], [0.01, 0.003, 0.04], [0.01, 0.003, 0.055]]
SPINE = {"name": "spine", "string": [[0.004, 0.01, z] for _, _, z in LINE]}
FLEX = {"name": "flex", "bend": LINE, "axis": [0, 1, 0]}
BELLY = {"name": "belly", "volume": "air"}


@builder
def bellows(simulate, hollow, /, sensors, kind="cavities", **entries):
    """Makes a hollow block with a chamber that is inflated or sealed, and two cables along its sides."""
    soft, surface = hollow()
    chamber = {"name": "air", "walls": [{"file": surface}]}
    if kind == "none":
        chamber = None
    cables = [{"name": name, "pull_point": [x, 0.01, -0.01], "tension": [0.0, 5.0],
               "points": [[x, 0.01, z] for z in (0.01, 0.03, 0.055)], "shortening": [0.0, 0.02]}
              for name, x in (("left", 0.002), ("right", 0.018))]  # fmt: skip
    sensors = [one | ({"walls": [{"file": surface}]} if one.get("walls") else {}) for one in sensors]
    chambers = {kind: [chamber]} if chamber else {}
    springs = [one for one in SPRINGS if one["name"] in {sensor.get("spring") for sensor in sensors}]
    entries = {"springs": springs, **entries} if springs else entries
    return simulate(body=soft, sensors=sensors, cables=cables, gravity=[0.0, 0.0, 0.0], **chambers, **entries)


def bent(robot):
    """A state in which no symmetry is left."""
    x = robot.state.positions.copy()
    shake = np.random.default_rng(3).normal(0.0, 3e-4, x.shape)
    x[:, 0] += 8.0 * x[:, 2] ** 2
    x[:, 2] *= 0.97
    free = robot.model.nodes.free_nodes
    x[free] += shake[free]
    return x


SEALED = {"name": "tank", "pressure": "air"}
WIRE = {"name": "wire", "string": [[0.01, 0.003, 0.055]], "pull_point": [0.01, 0.043, 0.025]}
EVERY = [SPINE, WIRE, {"name": "rope", "cable": "left"}, FLEX, BELLY, {"name": "inside", "walls": True}, SEALED,
         {"name": "load", "spring": "coil"}, {"name": "both", "spring": "brace"}]
SPRINGS = [{"name": name, "stiffness": 200.0, "rest_length": 0.02, "damping": damping, "ends": [
    {"on": "hollow", "point": [0.01, 0.003, 0.04]}, {"on": on, "point": [0.01, 0.003, 0.055]}]}
           for name, on, damping in (("coil", "world", 0.0), ("brace", "hollow", 0.0), ("damper", "world", 1.0))]


@pytest.mark.parametrize("sensor", EVERY, ids=lambda one: one["name"])
def test_rows_are_finite_differences_of_what_is_shown(bellows, sensor):
    robot = bellows([{**sensor, "weight": 1.0}], "sealed_cavities")
    x, nodes, term = bent(robot), robot.model.nodes, robot.model.wanted_sensors
    rows = np.zeros((nodes.free_node_count, 3))
    blocks, values = term.rows_at(x)
    np.add.at(rows, term.entry_nodes, blocks)
    assert values / term.lengths == pytest.approx(term.readings(x), rel=1e-14)
    rng = np.random.default_rng(5)
    for _ in range(4):
        way = rng.normal(size=(nodes.free_node_count, 3))
        apart = []
        for step in (1e-6, -1e-6):
            moved = x.copy()
            moved[nodes.free_nodes] += step * way
            apart.append(term.readings(moved)[0] * term.lengths[0])
        slope = (apart[0] - apart[1]) / 2e-6
        assert np.vdot(rows, way) == pytest.approx(slope, rel=1e-6, abs=1e-8)


def test_they_show_what_geometry_says(bellows):
    robot = bellows([SPINE, WIRE, FLEX, BELLY, {"name": "inside", "walls": True}, {"name": "rope", "cable": "left"}])
    memory = robot.state.memory
    assert memory["sensors.length"].ravel() == pytest.approx([0.05, 0.05, 0.065], abs=1e-12)
    assert memory["sensors.angle"] == pytest.approx(0.0, abs=1e-12)
    assert memory["sensors.volume"].ravel() == pytest.approx(2 * [0.01 * 0.01 * 0.04], rel=1e-9)
    wound = robot.rest_setpoints - [0.006, 0.0, 0.0]
    result = repeat_step(robot, CommandSetpoints(wound, 1.0), 6)
    told = dict(zip(robot.sensor_names, np.concatenate(
        [result.state.memory[f"sensors.{word}"] for word in ("length", "angle", "volume")])[:, 0]))
    assert told["rope"] == pytest.approx(0.065 - 0.006, rel=1e-9)
    # The cable on the side of -x bends the block about -y.
    assert told["flex"] < -0.1 and told["spine"] < 0.05
    assert told["belly"] == told["inside"]


def test_gas_keeps_pressure_times_volume(bellows):
    robot = bellows([BELLY, SEALED], "sealed_cavities")
    start = robot.state.memory
    result = repeat_step(robot, CommandSetpoints(robot.rest_setpoints - 0.004, 1.0), 6)
    volumes, pressures = (np.array([state["sensors.volume"][0, 0], state["sensors.pressure"][0, 0]])
                          for state in (start, result.state.memory))
    assert pressures[1] > 500.0
    np.testing.assert_allclose(volumes[0] * (volumes[1] + 101325.0),
                               pressures[0] * (pressures[1] + 101325.0), rtol=1e-12)  # fmt: skip


WANTED = [({**FLEX, "weight": 1.0}, 0.25, "angle"), ({**SPINE, "weight": 1.0}, 0.0485, "length"),
          ({**BELLY, "weight": 1.0}, 4.6e-6, "volume"),
          ({"name": "rope", "cable": "right", "weight": 2.0}, 0.062, "length"),
          ({"name": "load", "spring": "coil", "weight": 1.0}, -0.3, "force")]  # fmt: skip


@pytest.mark.parametrize("sensor, value, word", WANTED)
def test_a_wanted_value_is_reached(bellows, sensor, value, word):
    robot = bellows([sensor])
    for _ in range(8):
        result = robot.step(FollowTargets(np.empty((0, 3)), 1.0, sensors=np.array([value])))
    assert result.status is Status.OK
    assert result.state.memory[f"sensors.{word}"][0, 0] == pytest.approx(value, rel=2e-5)


def test_sensors_are_wanted_beside_effectors_and_orientations(bellows):
    tip = {"name": "tip", "points": [[0.002, 0.002, 0.06], [0.018, 0.002, 0.06], [0.01, 0.018, 0.06]],
           "directions": ["x"], "orientation": {"pointing": [0, 0, 1], "weight": 1e-6}}  # fmt: skip
    robot = bellows([{**BELLY, "weight": 1.0}], effectors=[tip])
    targets = robot.effector_positions() + [0.004, 0.0, 0.0]
    for _ in range(8):
        result = robot.step(FollowTargets(targets, 1.0, sensors=np.array([4.4e-6])))
    assert result.effector_errors[0] < 1e-5
    assert result.state.memory["sensors.volume"][0, 0] == pytest.approx(4.4e-6, rel=1e-4)


def test_a_value_out_of_reach_is_missed_with_its_limit_named(bellows):
    robot = bellows([{**FLEX, "weight": 1.0}])
    for _ in range(20):
        result = robot.step(FollowTargets(np.empty((0, 3)), 1.0, sensors=np.array([3.0])))
    assert result.status in (Status.SATURATED, Status.UNREACHABLE)
    assert any(limit.startswith("right") for limit in result.report.active_limits)
    assert result.state.memory["sensors.angle"][0, 0] > 0.3


def test_a_hinge_is_led_to_an_angle_by_a_cable(simulate):
    crank = {
        "name": "crank", "points": [[0, 0, 0], [0, 0, -0.1]], "elements": 4,
        "section": {"circle": {"radius": 0.004}},
        "material": {"young_modulus": 1e9, "poisson_ratio": 0.3, "density": 1000.0},
        "joined": [{"at": "start", "to": "world", "by": "hinge", "axis": [0, 1, 0]}],
    }  # fmt: skip
    rope = {"name": "rope", "body": "crank", "pull_point": [0.1, 0, -0.05], "points": [[0, 0, -0.1]],
            "shortening": [-0.01, 0.06], "tension": [0.0, 10.0]}  # fmt: skip
    knee = {"name": "knee", "hinge": "crank", "at": "start", "weight": 1.0}
    robot = simulate(beams=[crank], cables=[rope], sensors=[knee], gravity=[0, 0, -9.81])
    assert robot.state.memory["sensors.angle"][0, 0] == pytest.approx(0.0, abs=1e-12)
    for _ in range(15):
        result = robot.step(FollowTargets(np.empty((0, 3)), 1.0, sensors=np.array([-0.4])))
    assert result.status is Status.OK
    assert result.state.memory["sensors.angle"][0, 0] == pytest.approx(-0.4, abs=1e-4)


def test_a_file_and_python_give_targets_and_a_run_is_given_back(bellows, tmp_path):
    robot = bellows([{**FLEX, "weight": 1.0}, SPINE])
    path = tmp_path / "targets.csv"
    path.write_text("time_s,flex_angle_rad\n0,0.1\n1,0.2\n")
    table = read_targets(path, robot)
    np.testing.assert_array_equal(table.command(1).sensors, [np.nan, 0.2])
    columns = columns_of(robot, table)
    rows = list(run(robot, table, 0, columns))
    told = dict(zip(columns.names, columns.cells(rows[-1]), strict=True))
    assert told["flex_angle_rad"] == pytest.approx(0.2, abs=1e-3) and told["flex_target_angle_rad"] == 0.2
    assert {"spine_length_m"} <= told.keys()
    output = tmp_path / "run.csv"
    output.write_text("\n".join([",".join(columns.names), *(",".join(columns.texts(row)) for row in rows)]))
    np.testing.assert_array_equal(read_targets(output, robot).wanted["sensors"], table.wanted["sensors"])
    scripted = st.Robot(bellows([{**FLEX, "weight": 1.0}, SPINE]).scene)
    result = scripted.settle(st.targets(flex_angle_rad=0.2))
    assert result["flex_angle_rad"] == pytest.approx(0.2, abs=1e-4)
    assert result["flex_target_angle_rad"] == 0.2


def test_sensors_without_a_weight_add_no_rows_and_take_no_targets(bellows, tmp_path):
    robot = bellows([FLEX])
    assert robot.model.wanted_sensors is None and robot.inverse is None
    assert "flex_angle_rad" in RunColumns(robot).names
    both = bellows([FLEX, {**SPINE, "weight": 1.0}])
    with pytest.raises(CommandError, match="flex.*without a weight"):
        both.step(FollowTargets(np.empty((0, 3)), 1.0, sensors=np.array([np.nan, 0.1])))
    assert both.step(Hold(1.0)).status is Status.OK
    path = tmp_path / "targets.csv"
    path.write_text("time_s,flex_angle_rad\n0,0.1\n")
    with pytest.raises(TableFileError, match="flex_angle_rad: the sensor has no weight"):
        read_targets(path, both)
    path.write_text("time_s,flex_angle_deg\n0,0.1\n")
    with pytest.raises(TableFileError, match="is flex_angle_rad meant"):
        read_targets(path, both)


@pytest.mark.parametrize("sensor, words", [
    ({"name": "s", "string": [[0, 0, 0.01]]}, "needs two places"),
    ({"name": "s", "cable": "left", "pull_point": [0, 0, 0]}, "is where a string begins"),
    ({"name": "s", "bend": LINE}, "axis.*goes with bend"),
    ({"name": "s", "bend": LINE, "axis": [0, 0, 1]}, "is along an end of the line"),
    ({"name": "s", "volume": "aia"}, "is air meant"),
    ({"name": "s", "pressure": "air"}, "which the scene does not have"),
    ({"name": "s", "spring": "damper"}, "has damping"),
    ({"name": "s", "cable": "left", "hinge": "leg", "at": "end"}, "exactly one of"),
    ({"name": "left", "cable": "left"}, "more than once"),
    ({"name": "s", "cable": "left", "on": "hollow"}, "body of a string"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_by_name(bellows, sensor, words):
    with pytest.raises(SceneError, match=words):
        bellows([sensor])


def test_the_error_of_the_mesh_is_told_beside_them(bellows):
    tip = {"name": "tip", "points": [[0.01, 0.003, 0.055]]}
    wrapped = {"name": "drum", "cylinder": {"ends": [[0.05, -0.1, 0.02], [0.05, 0.1, 0.02]], "radius": 0.004}}
    own = dict(effectors=[tip], reactions=[{"name": "foot", "of": "hollow"}], moving_base={})
    robot = bellows([{**FLEX, "weight": 1.0}], obstacles=[wrapped], **own)
    cable = robot.scene.cables[0].changed(wraps=("drum",), pull_point=(0.1, 0.01, 0.0))
    scene = robot.scene.changed(cables=(cable, robot.scene.cables[1]))
    plain = scene.changed(sensors=(), reactions=(), moving_base=None)
    found, expected = (MeshErrorEstimator(one).at_rest() for one in (scene, plain))
    assert found.own.loads == expected.own.loads
