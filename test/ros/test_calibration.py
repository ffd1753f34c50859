"""An ordinary run over ROS is enough to calibrate: the robot moves to some targets and rests there."""

import time

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from std_srvs.srv import SetBool

from softrobot_twin.command_line.commands import program
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.scene import load_scene
from softrobot_twin.study.calibration import MARKERS

TRUE_MODULUS, TRUE_ZERO = 1.5e5, 8.0e-4
E, ZERO = "body.material.young_modulus", "cables.*.offset"
ROBOT = [f"body.material.young_modulus={TRUE_MODULUS}", f"cables.north.offset={TRUE_ZERO}"]
PLACES = [(0.0, 0.0, 0.128), (0.008, 0.0, 0.132), (-0.006, 0.007, 0.130), (0.0, -0.009, 0.126),
          (0.007, 0.006, 0.124), (-0.008, -0.004, 0.128), (0.004, -0.007, 0.133)]  # fmt: skip
"""Targets of the tip [m]."""
STAY = 2.5
"""How long the robot has for each: it goes there, and rests for more than a second [s]."""


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
def robot(world, make_twin, small_scene_file, tmp_path):
    """A twin, and a softer robot with a zero error of a winch."""
    twin = make_twin(record=str(tmp_path / "run.mcap"), use_device=True, rate=20.0)
    world.add(DeviceNode, device_scene_file=str(small_scene_file), device_scene_changes=ROBOT,
              scene_file=str(small_scene_file), device_seed=int(time.time()) % 1000)  # fmt: skip
    return twin


@pytest.mark.slow
def test_a_recorded_run_of_twin_and_device_gives_the_numbers_of_the_device(
    world, robot, small_scene_file, tmp_path, capsys
):
    move_about(world)
    robot.recording.close()
    written = tmp_path / "calibrated.yaml"
    words = ["calibrate", small_scene_file, "--data", tmp_path / "run.mcap", "--fit", E, ZERO,
             "--output", written]  # fmt: skip
    chosen = program("softrobot_twin").parse_args(list(map(str, words)))
    code = chosen.run(chosen)
    told = capsys.readouterr()
    print(told.out, told.err)
    assert code == 0
    scene = load_scene(written)
    assert scene.body.material.young_modulus == pytest.approx(TRUE_MODULUS, rel=0.03)
    offsets = [cable.offset for cable in scene.cables]
    assert offsets == pytest.approx([TRUE_ZERO, 0.0, 0.0, 0.0], abs=2e-4)
