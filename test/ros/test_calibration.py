"""An ordinary run over ROS is enough to calibrate: the robot moves to some targets and rests there."""

import time

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PointStamped
from std_srvs.srv import SetBool, Trigger

from softrobot_twin.command_line.commands import program
from softrobot_twin.control.rest_watch import RestPose
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.scene import load_scene
from test.scene_changes import entries_of

TRUE_MODULUS, TRUE_ZERO = 1.5e5, 8.0e-4
E, ZERO = "body.material.young_modulus", "cables.*.offset"
ROBOT = [f"body.material.young_modulus={TRUE_MODULUS}", f"cables.north.offset={TRUE_ZERO}"]
PLACES = [(0.0, 0.0, 0.128), (0.008, 0.0, 0.132), (-0.006, 0.007, 0.130), (0.0, -0.009, 0.126),
          (0.007, 0.006, 0.124)]
"""Targets of the tip [m]."""
STAY = 2.5
"""How long the robot has for each: it goes there, and rests for more than a second [s]."""


def calibrate(world):
    return world.ask(Trigger, "/twin/calibrate", Trigger.Request())


def move_about(world):
    """An ordinary run: the twin is enabled and gets a target now and then."""
    target = world.speaker(PointStamped, "/twin/target/tip")
    world.until(lambda: world.ask(SetBool, "/twin/enable", SetBool.Request(data=True)).success)
    for place in PLACES:
        end = time.monotonic() + STAY
        while time.monotonic() < end:
            target.publish(world.target_message(place))
            world.run(0.1)


@pytest.fixture
def own_scene_file(small_scene_file, tmp_path):
    """A copy of the scene, beside which files may be written."""
    file = tmp_path / "small.yaml"
    file.write_text(small_scene_file.read_text())
    return file


@pytest.fixture
def robot(world, make_twin, own_scene_file, tmp_path, drawn_seed):
    """A twin, and a softer robot with a zero error of a winch."""
    seed = drawn_seed % 2**16
    twin = make_twin(scene_file=str(own_scene_file), record=str(tmp_path / "run.mcap"), use_device=True,
                     rate=20.0, calibrate_fit=[E, ZERO])  # fmt: skip
    world.add(DeviceNode, device_scene_file=str(own_scene_file), device_scene_changes=ROBOT,
              scene_file=str(own_scene_file), device_seed=seed)  # fmt: skip
    return twin


def assert_found(file):
    scene = load_scene(file)
    assert scene.body.material.young_modulus == pytest.approx(TRUE_MODULUS, rel=0.03)
    offsets = [cable.offset for cable in scene.cables]
    assert offsets == pytest.approx([TRUE_ZERO, 0.0, 0.0, 0.0], abs=2e-4)


@pytest.mark.exhaustive
@pytest.mark.timeout(400)
def test_an_ordinary_run_gives_the_numbers_of_the_device_live_and_from_its_record(
    world, robot, diagnostics, own_scene_file, tmp_path, capsys
):
    move_about(world)
    before = robot.loop.simulation.scene
    answer = calibrate(world)
    assert answer.success, answer.message
    proposal = tmp_path / "small_calibrated.yaml"
    assert "poses at rest" in answer.message and str(proposal) in answer.message
    again = calibrate(world)
    assert not again.success and "under way" in again.message
    # The loop goes on meanwhile, and is what it was.
    ticks = robot.tick_clock.ticks
    told = diagnostics("calibration", lambda one: one.values["proposal"], 250.0)
    assert robot.tick_clock.ticks > ticks
    assert told.values["proposal"] == str(proposal) and int(told.values["poses"]) >= 4
    assert robot.loop.simulation.scene is before
    assert_found(proposal)
    # The same poses may be fitted by hand, as may the record.
    assert (tmp_path / "small_rests.csv").read_text().startswith("north_length_m,")
    robot.recording.close()
    written = tmp_path / "by_hand.yaml"
    words = ["calibrate", own_scene_file, "--data", tmp_path / "run.mcap", "--fit", E, ZERO,
             "--output", written]  # fmt: skip
    chosen = program("softrobot_twin").parse_args(list(map(str, words)))
    assert chosen.run(chosen) == 0, capsys.readouterr()
    assert_found(written)


def test_without_rests_or_markers_the_service_says_so_and_writes_nothing(
    world, make_twin, diagnostics, own_scene_file, tmp_path
):
    make_twin(scene_file=str(own_scene_file))
    answer = calibrate(world)
    assert not answer.success and "0 poses at rest" in answer.message and "3 are needed" in answer.message
    assert diagnostics("calibration").message == "0 poses at rest"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.yaml"]


def test_a_scene_without_markers_has_nothing_to_calibrate_by(world, make_twin, own_scene_file):
    scene = entries_of(own_scene_file, {"markers": []})
    scene["effectors"][0].pop("measured_by", None)
    own_scene_file.write_text(yaml.safe_dump(scene))
    twin = make_twin(scene_file=str(own_scene_file))
    answer = calibrate(world)
    assert not answer.success and "has no markers" in answer.message
    assert twin.calibration is None


def test_a_folder_that_cannot_be_written_is_named(world, make_twin, diagnostics, own_scene_file):
    twin = make_twin(scene_file=str(own_scene_file), rate=20.0)
    calibration, simulation = twin.calibration, twin.loop.simulation
    calibration.rests.mkdir()  # where the file of the poses would be
    for number in range(4):
        at = simulation.rest_setpoints - 0.002 * number
        pose = RestPose(at, simulation.marker_positions() + 1e-3 * number, np.full((1, 3), np.nan),
                        np.full(4, np.nan), np.zeros((0, 3)))  # fmt: skip
        calibration.watch.found.append(pose)
    assert calibrate(world).success
    told = diagnostics("calibration", lambda one: "cannot be written" in one.message)
    assert "small_rests.csv" in told.message and told.level == b"\x01"
