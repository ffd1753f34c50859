"""Zero errors of winches, motors and regulators, and the frame of the cameras."""

from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.cavity_pressures import CavityPressures
from softrobot_twin.control.inputs import MarkerInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.scene.schema import MarkerFrame
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.equilibrium import bring_to_rest

SCENES = Path(__file__).resolve().parents[2] / "config" / "scenes"
OFFSETS = np.array([6e-4, -4e-4, 3e-4, -7e-4])
SHORTENINGS = np.array([0.012, 0.004, 0.010, 0.006])
FRAME = MarkerFrame(position=[0.1, -0.02, 0.3], rotation=[0.2, -0.1, 0.7])


def at_rest(scene, drives):
    simulation = Simulation(scene)
    assert bring_to_rest(simulation, simulation.actuators.setpoints(drives)).is_reached
    return simulation


@pytest.fixture(scope="module")
def diamond():
    return load_scene(SCENES / "diamond.yaml", {"body.mesh.file": "../../meshes/diamond_400.vtk"})


def test_a_zero_error_of_a_winch_is_in_its_length_and_nowhere_else(diamond):
    wrong = changed_scene(diamond, {f"cables[{i}].offset": e for i, e in enumerate(OFFSETS)})
    true, told = at_rest(diamond, SHORTENINGS), at_rest(wrong, SHORTENINGS)
    assert np.allclose(told.state.positions, true.state.positions, rtol=0.0, atol=1e-9)
    assert told.state.setpoints - true.state.setpoints == pytest.approx(OFFSETS, abs=1e-15)
    same_length = at_rest(wrong, SHORTENINGS + OFFSETS)
    assert same_length.state.setpoints == pytest.approx(true.state.setpoints, abs=1e-15)
    assert np.abs(same_length.state.positions - true.state.positions).max() > 1e-4


def test_angles_of_a_pulley_count_from_the_zero_of_its_winch(diamond):
    pulley = {"cables[0].pulley": {"radius": 0.01}}
    true = Simulation(changed_scene(diamond, pulley))
    wrong = Simulation(changed_scene(diamond, pulley | {"cables[0].offset": 1e-3}))
    lengths = true.rest_setpoints - 0.005
    assert wrong.pulleys.angles(lengths) == true.pulleys.angles(lengths) == pytest.approx([0.5])
    assert wrong.pulleys.angles(wrong.rest_setpoints) == pytest.approx([-0.1])


def test_a_zero_error_of_a_hinge_is_in_its_angle_and_nowhere_else():
    strider = load_scene(SCENES / "strider.yaml")
    wrong = Simulation(changed_scene(strider, {"hinge_motors[1].offset": 0.05}))
    true = Simulation(strider)
    own = true.actuators.of_section("hinge_motors")
    assert (wrong.rest_setpoints - true.rest_setpoints)[own] == pytest.approx([0, 0.05, 0, 0])
    assert wrong.actuators.drives(wrong.rest_setpoints)[own].tolist() == [0.0] * 4


def test_gain_and_zero_of_a_regulator_are_in_messages_only():
    scene = load_scene(SCENES / "fetch.yaml")
    name = scene.cavities[1].name
    changed = changed_scene(
        scene, {"cavities[1].pressure_gain": 0.9, "cavities[1].pressure_offset": 150.0})
    simulation = Simulation(changed)
    cavities = CavityPressures(simulation, 1e5)
    told = cavities.absolute(np.full(simulation.actuators.count, 900.0))
    assert told[name] == pytest.approx(1e5 + 1150.0)
    assert [cavities.gauge(one, told[one]) for one in told] == pytest.approx([900.0] * len(told))
    assert set(CavityPressures(Simulation(scene), 1e5).absolute(np.full(len(told), 900.0)).values()) \
        == {100900.0}


def test_the_frame_of_the_cameras_turns_and_moves_what_they_see():
    points = np.random.default_rng(3).normal(size=(5, 3))
    assert np.allclose(FRAME.of_cameras(FRAME.of_robot(points)), points, atol=1e-15)
    assert FRAME.of_robot(np.zeros(3)) == pytest.approx(FRAME.position)
    turned = MarkerFrame(rotation=[0.5 * np.pi, 0.0, 0.5 * np.pi])
    assert np.allclose(turned.of_robot(np.array([0.0, 1.0, 0.0])), [0.0, 0.0, 1.0])
    assert MarkerFrame().of_robot(points) is points


def test_measured_markers_come_to_the_loop_in_the_frame_of_the_robot():
    markers = MarkerInput(np.array([4, 2], np.uint32), "base", LoopSettings(), FRAME.of_robot)
    points = np.array([[0.0, 0.1, 0.2], [0.3, np.nan, 0.1]])
    assert markers.accept(np.array([2, 4], np.uint32), FRAME.of_cameras(points),
                          Arrival("base", 10**9, 10**9, 1.0)) is None  # fmt: skip
    assert markers.positions[1] == pytest.approx(points[0])
    assert np.isnan(markers.positions[0]).all()
