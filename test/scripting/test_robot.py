"""A robot in Python: results, states, copies, read-outs, pictures, files."""

import copy
import inspect
import pickle
import subprocess
import sys
import warnings

import meshio
import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.analysis.apparent_compliance import apparent_compliance
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.study.direct_run import DEFAULT_RATE
from softrobot_twin.view import ViewError
from test.places import ROOT

pytestmark = pytest.mark.libraries


def test_a_result_gives_effectors_and_columns_by_name(finger):
    result = finger.step(st.targets(tip=[0.1, 0.01, 0.012]))
    assert np.array_equal(result.tip, result.outcome.effector_positions[0])
    assert result["tip_z_m"] == result.tip[2]
    assert result["upper_tension_N"] == result.outcome.efforts[0]
    assert result.errors["tip"] == result["tip_error_m"] == result.outcome.effector_errors[0]
    assert result.time == result["time_s"] == 0.02
    assert "tip" in dir(result)


def test_a_result_does_not_change_in_later_steps(held):
    first = held.step(poses={"palm": [0.0, 0.01, 0.01]})
    held.step()
    assert first["palm_x_m"] == first.poses["palm"].position[0] == pytest.approx(-0.008)


def test_an_unknown_column_of_a_result_is_refused_with_the_nearest(finger):
    with pytest.raises(KeyError, match="is upper_tension_N meant"):
        finger.step()["upper_tensoin_N"]
    with pytest.raises(st.SoftRobotTwinError):
        finger.step()["upper_tensoin_N"]


def test_after_reset_the_same_steps_follow_to_the_bit(finger):
    first = finger.run(st.setpoints(upper_shortening_m=0.002), steps=4)
    finger.reset()
    second = finger.run(st.setpoints(upper_shortening_m=0.002), steps=4)
    assert list(first["tip_z_m"]) == list(second["tip_z_m"])


def test_a_saved_state_can_be_put_back(finger):
    state = finger.step(st.setpoints(upper_shortening_m=0.001)).outcome.state
    there = finger.step()
    finger.state = state
    assert np.array_equal(finger.step().positions, there.positions)


def test_what_is_no_state_is_refused(finger, held):
    for state in (None, held.state):
        with pytest.raises(st.SoftRobotTwinError, match="state: "):
            finger.state = state


@pytest.mark.parametrize("copied", [
    copy.copy, copy.deepcopy, lambda robot: pickle.loads(pickle.dumps(robot))])
def test_a_copy_goes_on_in_the_same_way_and_by_itself(held, copied):
    held.step(st.setpoints(upper_shortening_m=0.001), poses={"palm": [0.01, 0.01, 0.01]})
    other = copied(held)
    assert np.array_equal(other.positions, held.positions) and other.time == held.time
    assert np.array_equal(other.step().positions, held.step().positions)
    other.reset()
    assert held.time == 0.04


@pytest.mark.exhaustive
def test_a_copy_in_contact_goes_on_from_the_efforts_of_the_original():
    """From no efforts at all, this robot on a slide between cylinders took others: 3 mm away."""
    robot = st.load(ROOT / "config/scenes/trunk_cylinders_reduced.yaml")
    target = robot.step(st.hold()).tip + [0.02, 0.01, 0.03]
    for _ in range(40):
        robot.step(st.targets(tip=target))
    other = robot.copy()
    for _ in range(3):
        target = target + [0.001, 0.0, 0.002]
        apart = (other.step(st.targets(tip=target)).positions - robot.step(st.targets(tip=target)).positions)
        assert np.abs(apart).max() < 1e-4


def test_a_copy_knows_where_a_table_sent_guided_bodies(held):
    held.run({"time_s": [0.0, 0.04], "palm_x_m": [0.01, 0.01], "palm_y_m": [0.01, 0.01],
              "palm_z_m": [0.01, 0.01], "upper_shortening_m": [0.0, 0.0],
              "lower_shortening_m": [0.0, 0.0]}, rate=50)
    other = held.copy()
    there, here = other.step().poses["palm"].position, held.step().poses["palm"].position
    assert np.array_equal(there, here) and here[0] == pytest.approx(-0.004)


def test_a_result_is_pickled_without_its_robot(held):
    result = held.step(poses={"palm": [0.01, 0.01, 0.01]})
    dumped = pickle.dumps(result)
    other = pickle.loads(dumped)
    assert other.values == result.values and np.array_equal(other.tip, result.tip)
    assert np.array_equal(other.poses["palm"].position, result.poses["palm"].position)
    assert repr(other) == repr(result)
    assert len(dumped) < 20 * result.positions.nbytes


def test_settling_ends_at_rest_and_says_where_it_does_not(finger):
    result = finger.settle(st.setpoints(upper_shortening_m=0.005))
    assert result.is_at_rest and result.status is st.Status.OK
    assert result["upper_shortening_m"] == pytest.approx(0.005)
    assert finger.step().is_at_rest
    assert not finger.settle(st.setpoints(upper_shortening_m=0.01), most_steps=2).is_at_rest


def test_a_robot_that_has_begun_to_move_is_not_at_rest_however_short_its_steps(entries):
    robot = st.build(**entries | {"integration": "dynamic"})
    result = robot.settle(st.efforts(upper_tension_N=0.01), time_step=1e-5, most_steps=5)
    assert result.status is st.Status.OK and not result.is_at_rest
    assert robot.settle(st.efforts(upper_tension_N=0.01), time_step=100.0).is_at_rest


def test_a_material_that_relaxes_slowly_is_not_at_rest(entries):
    entries["body"]["material"] |= {"law": "neo_hookean", "viscosity": [{"share": 0.3, "time": 1e3}]}
    robot, command = st.build(**entries), st.setpoints(upper_shortening_m=0.01, lower_shortening_m=0.0)
    early = robot.settle(command, time_step=0.02, most_steps=60)
    assert early.status is st.Status.OK and not early.is_at_rest
    late = robot.settle(command, time_step=1e5)
    assert late.is_at_rest and early["upper_tension_N"] > 1.3 * late["upper_tension_N"]


def test_a_jacobian_has_the_columns_of_the_actuators(finger):
    finger.settle(st.setpoints(upper_shortening_m=0.002, lower_shortening_m=0.002))
    jacobian = finger.jacobian("tip")
    assert jacobian.columns == ("upper_shortening_m", "lower_shortening_m")
    found = apparent_compliance(finger.simulation)
    assert np.array_equal(np.asarray(jacobian), found.jacobian[0])
    assert np.array_equal(jacobian["upper_shortening_m"], found.jacobian[0, :, 0])
    assert jacobian["upper_shortening_m"][2] > 0.0 > jacobian["lower_shortening_m"][2]
    with pytest.raises(st.SoftRobotTwinError, match="is upper_shortening_m meant"):
        jacobian["uper_shortening_m"]


def test_the_jacobian_is_the_slope_of_settled_positions(finger):
    at = {"upper_shortening_m": 0.002, "lower_shortening_m": 0.002}
    finger.settle(st.setpoints(at))
    slope, step = finger.jacobian("tip")["upper_shortening_m"], 1.0e-5
    ends = [finger.settle(st.setpoints({**at, "upper_shortening_m": 0.002 + move})).tip
            for move in (-step, step)]
    assert (ends[1] - ends[0]) / (2 * step) == pytest.approx(slope, rel=1e-3, abs=1e-6)


def test_after_efforts_the_jacobian_is_by_efforts_and_the_robot_is_softer(finger):
    finger.settle(st.setpoints(upper_shortening_m=0.004, lower_shortening_m=0.004))
    held = finger.compliance("tip")
    finger.settle(st.efforts(upper_tension_N=2.0, lower_tension_N=2.0))
    assert finger.jacobian("tip").columns == ("upper_tension_N", "lower_tension_N")
    assert finger.compliance("tip")["z_N"][2] > 2.0 * held["z_N"][2]


def test_the_least_stiffness_is_the_inverse_of_the_greatest_compliance(finger):
    finger.settle()
    stiffness, directions = finger.stiffness("tip")
    compliance = np.asarray(finger.compliance("tip"))
    assert compliance @ directions[0] == pytest.approx(directions[0] / stiffness[0], rel=1e-6)


def test_an_unknown_effector_is_refused_with_the_nearest(finger):
    for ask in (finger.jacobian, finger.compliance, finger.stiffness):
        with pytest.raises(st.SoftRobotTwinError, match="is tip meant"):
            ask("tpi")


@pytest.mark.exhaustive
def test_a_picture_is_written_or_returned(finger, tmp_path):
    pytest.importorskip("matplotlib")
    finger.step(st.targets(tip=[0.1, 0.01, 0.012]))
    assert finger.plot(tmp_path / "finger.png") is None
    assert (tmp_path / "finger.png").read_bytes().startswith(b"\x89PNG")
    figure = finger.plot()
    assert figure.get_axes() or figure.texts
    for name, view, said in (("a.no", None, "a.no"), ("a.png", (1,), "view"), ("a.png", (0, np.nan), "view")):
        with pytest.raises(st.SoftRobotTwinError, match=said):
            finger.plot(tmp_path / name, view=view)


def test_a_vtu_file_has_all_parts_and_their_displacements(held, tmp_path):
    held.settle()
    parts = held.save_vtu(tmp_path / "held.vtu")
    assert parts == ("body", "palm", "upper", "lower")
    mesh = meshio.read(tmp_path / "held.vtu")
    body = held.simulation.model.bodies[0].mesh
    moved = mesh.point_data["displacement"][: body.node_count]
    rest = mesh.points[: body.node_count] - moved
    assert np.abs(rest - body.node_positions).max() < 1e-15
    assert [block.type for block in mesh.cells] == ["tetra", "triangle", "line"]
    assert np.array_equal(mesh.cells[0].data, body.cells)
    assert {int(n) for block in mesh.cell_data["part"] for n in block} == {0, 1, 2, 3}
    with pytest.raises(st.SoftRobotTwinError, match="held.nothing"):
        held.save_vtu(tmp_path / "held.nothing")


@pytest.mark.parametrize("element, kind", [("quadratic", "tetra10"), ("hexahedral", "hexahedron")])
def test_a_vtu_file_has_the_cells_of_the_element(entries, tmp_path, element, kind):
    entries["body"]["element"] = element
    robot = st.build(**entries)
    robot.save_vtu(tmp_path / "finger.vtu")
    mesh, volume = meshio.read(tmp_path / "finger.vtu"), 0.1 * 0.02 * 0.02
    assert mesh.cells[0].type == kind
    # Corners come first in all kinds of cells: boxes of hexahedra, or six tetrahedra in each.
    corners = mesh.points[mesh.cells[0].data[:, :4 if kind == "tetra10" else 8]]
    if kind == "tetra10":
        sides = corners[:, 1:] - corners[:, :1]
        assert np.abs(np.linalg.det(sides)).sum() / 6.0 == pytest.approx(volume)
        middles = mesh.points[mesh.cells[0].data[:, 4]]
        assert middles == pytest.approx(corners[:, :2].mean(axis=1))
    else:
        assert np.ptp(corners, axis=1).prod(axis=1).sum() == pytest.approx(volume)


def test_a_view_writes_every_step(finger, tmp_path):
    with finger.view(tmp_path / "finger.rrd") as view:
        finger.step()
        finger.run(st.hold(), steps=3)
        finger.run(seconds=0.04)
    assert (tmp_path / "finger.rrd").stat().st_size > 10_000
    assert view.shown_count == 1 + 1 + 3 + 2
    finger.step()
    assert view.shown_count == 7 and "closed" in repr(view)


def test_a_view_shows_targets_and_is_replaced_by_the_next(held, tmp_path):
    first = held.view(tmp_path / "first.rrd")
    held.step(st.targets(tip=[0.1, 0.01, 0.012]))
    second = held.view(tmp_path / "second.rrd")
    assert not first.is_open and second.is_open
    second.close()
    assert first.failure is None and second.failure is None


@pytest.mark.exhaustive
def test_names_of_the_package_are_imported_when_they_are_used():
    code = ("import sys, softrobot_twin as st; assert 'numpy' not in sys.modules; "
            "assert {name for name in dir(st) if name[0] != '_'} == set(st.__all__); "
            "st.load; assert 'numba' in sys.modules; "
            "assert 'rerun' not in sys.modules and 'matplotlib' not in sys.modules")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unknown_name_of_the_package_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'lode'"):
        st.lode


@pytest.mark.parametrize("suffix", [".msh", ".vtk", ".vtu", ".inp", ".stl", ".step"])
def test_loading_a_mesh_says_how_a_scene_is_made_of_it(suffix):
    with pytest.raises(SceneError, match=f"`softrobot_twin init part{suffix}` writes"):
        st.load(f"meshes/part{suffix}")


@pytest.mark.parametrize("command, words", [
    (st.setpoints(upper_shortening_m=5.0), "upper: a shortening of 5 m is .*: is it in m?"),
    (st.setpoints(upper_length_m=110.0), "upper: a shortening of 110 m is"),
    (st.efforts(lower_tension_N=3000.0), "lower: a tension of 3e.03 N is .*: is it in N?"),
])  # fmt: skip
def test_setpoints_and_efforts_far_out_of_scale_are_questioned(entries, command, words):
    robot = st.build(**entries)
    with pytest.warns(st.SceneWarning, match=words):
        robot.step(command)


def test_large_setpoints_in_the_range_of_the_scene_are_not_questioned(entries):
    robot = st.build(**entries)
    with warnings.catch_warnings():
        warnings.simplefilter("error", st.SceneWarning)
        robot.step(st.setpoints(upper_shortening_m=0.02, lower_shortening_m=0.0))
        robot.step(st.efforts(upper_tension_N=20.0))


@pytest.mark.parametrize("time_step", [0.0, -0.01])
def test_a_step_takes_time(finger, time_step):
    with pytest.raises(CommandError, match="time_step: .* s must be above 0"):
        finger.step(time_step=time_step)
    with pytest.raises(CommandError, match="time_step: .* s must be above 0"):
        finger.settle(time_step=time_step)


def test_a_view_into_a_file_of_another_kind_is_refused(finger, tmp_path):
    with pytest.raises(ViewError, match="is a .rrd file"):
        finger.view(tmp_path / "finger.txt")
    assert not list(tmp_path.iterdir())


def test_the_time_step_is_the_same_by_default_wherever_a_robot_runs(finger):
    step = inspect.signature(st.Robot.step).parameters["time_step"].default
    assert step == inspect.signature(st.Robot.settle).parameters["time_step"].default
    assert 1.0 / step == DEFAULT_RATE == LoopSettings().rate
    for table in (finger.run(steps=2), finger.run(st.hold(), steps=2)):
        assert np.diff(table["time_s"]) == pytest.approx(step)


@pytest.mark.parametrize(("name", "key", "value"), [
    ("diamond", "body.material.young_modulus", 1.5e5), ("finger", "body.material.density", 900.0),
])
def test_a_changed_robot_steps_as_one_built_anew_to_the_bit(name, key, value):
    with warnings.catch_warnings(action="ignore"):
        robot = st.load(ROOT / f"config/scenes/{name}.yaml")
    target = robot.effectors[robot.effector_names[0]] + np.array([0.001, 0.0, 0.002])
    command = st.targets(**{robot.effector_names[0]: target})
    robot.step(command)
    anew = st.Robot(changed_scene(robot.scene, {key: value}), robot.state)
    robot.change({key: value})
    for one in (command, command, st.hold(), command):
        robot.step(one), anew.step(one)
        assert np.array_equal(robot.positions, anew.positions)
        assert np.array_equal(robot.state.efforts, anew.state.efforts)


def test_other_numbers_keep_the_state():
    robot = st.load(ROOT / "config/scenes/finger.yaml", {"body.material.young_modulus": 2e5})
    robot.step(st.setpoints(flexor_shortening_m=0.002))
    before, mesh = robot.state, robot.simulation.model.bodies[0].mesh.node_count
    robot.change({"body.material.young_modulus": 3e5})
    assert robot.scene.body.material.young_modulus == 3e5
    assert np.array_equal(robot.state.positions, before.positions)
    with pytest.raises(st.SoftRobotTwinError, match="young_modulus"):
        robot.change({"body.material.young_modulus": -1.0})
    assert robot.scene.body.material.young_modulus == 3e5
    assert robot.simulation.model.bodies[0].mesh.node_count == mesh


def test_a_push_is_found_from_markers():
    scene = ROOT / "config/scenes/diamond.yaml"
    mesh = {"body.mesh.file": str(ROOT / "meshes/diamond_200.vtk"), "body.element": "linear"}
    twin = st.load(scene, {"observer": {}, "marker_frame": {"rotation": [0.0, 0.02, 0.0]}, **mesh})
    real = st.load(scene, {"touches": [{"name": "hand", "points": [[0.0, 0.0, 0.125]]}], **mesh})
    twin.settle()
    real.settle(touches={"hand_force_N": [0.3, 0.0, 0.1]})
    markers = twin.simulation.scene.marker_frame.of_cameras(real.simulation.marker_positions())
    seen = {marker: place for marker, place in enumerate(markers) if marker != 2}  # One is hidden.
    for _ in range(8):
        found = twin.observe(seen)["tip"]
        result = twin.step()
    assert found.force == pytest.approx([0.3, 0.0, 0.1], abs=0.02)
    assert found.is_detected and not found.torque.any() and result["tip_force_x_N"] == found.force[0]
    assert result["tip_by_cameras_x_m"] == pytest.approx(result.tip @ [np.cos(0.02), 0.0, -np.sin(0.02)])
    assert found.place == pytest.approx(result.tip, abs=1e-3)
    for markers, why in (({99: [0, 0, 0]}, "99"), (markers[:3], "shape"), ({0: [0.0]}, "3 numbers")):
        with pytest.raises(CommandError, match=why):
            twin.observe(markers)
    twin.reset()
    assert twin.step()["tip_force_x_N"] == 0.0
    with pytest.raises(CommandError, match="observer"):
        real.observe({})
