"""The nodes of the hardware example: servos on a simulated bus behind a twin, and a tracker."""

import math
import random
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PointStamped, Pose, PoseArray, PoseStamped
from sensor_msgs.msg import FluidPressure, JointState, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from softrobot_twin.ros.messages import markers_message, read_markers
from softrobot_twin.ros.process import spin

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "hardware"
sys.path.insert(0, str(FOLDER))

from hardware_node import HardwareNode, NoHardware  # noqa: E402
from mocap_node import MocapFrame, MocapNode, fit_frame, quaternion_of, rotation_of  # noqa: E402
from regulators import read_regulators  # noqa: E402
from simulated_regulators import SimulatedRegulators  # noqa: E402
from simulated_servos import SimulatedBus, SimulatedServo, Terminal  # noqa: E402
from test.builder import builder

NAMES = ["north", "west", "south", "east"]
NUMBERS = (0.0, -0.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 1e-3, 1e6, -1.0)


class Robot:
    """Simulated servos at the rest of a robot, and the file that describes them."""

    def __init__(self, folder, rest):
        given = yaml.safe_load((FOLDER / "servos.yaml").read_text())
        self.servos = {entry["id"]: SimulatedServo(entry["zero_ticks"], 40960.0)
                       for entry in given["servos"]}  # fmt: skip
        self.bus = SimulatedBus(self.servos)
        self.terminal = Terminal(self.bus)
        given |= {"port": self.terminal.path, "baud_rate": 115200, "answer_time": 0.3}
        for entry, length in zip(given["servos"], rest, strict=True):
            entry |= {"zero_length": float(length), "least_length": float(length) - 0.045,
                      "greatest_length": float(length) + 0.002}  # fmt: skip
        self.file = folder / "servos.yaml"
        self.file.write_text(yaml.safe_dump(given))

    def has_torque(self):
        return [servo.has_torque for servo in self.servos.values()]


@pytest.fixture
def robot(tmp_path, make_twin):
    """Servos of the small Diamond, with its twin as `robot.twin`."""
    twin = make_twin(use_device=True, rate=20.0)
    robot = Robot(tmp_path, twin.loop.simulation.rest_setpoints)
    robot.twin = twin
    yield robot
    robot.bus.silent.clear()
    robot.terminal.close()


@pytest.fixture
def hardware(world, robot):
    node = world.add(HardwareNode, servos_file=str(robot.file), device_rate=20.0)
    yield node
    # While its servos still answer.
    if node.device is not None:
        node.stop()
        node.device.close()


def enable(world):
    world.until(lambda: world.ask(SetBool, "/twin/enable", SetBool.Request(data=True)).success)


def test_a_twin_leads_the_tip_by_servos(world, robot, hardware):
    assert not any(robot.has_torque())
    enable(world)
    speaker = world.speaker(PointStamped, "/twin/target/tip")
    rest = robot.twin.loop.simulation.effector_positions()[0]
    wanted = rest + [0.004, 0.0, 0.002]

    def is_there():
        speaker.publish(world.target_message(wanted))
        world.run(0.05)
        tip = robot.twin.loop.simulation.effector_positions()[0]
        commanded = robot.twin.window.newest.command
        measured = robot.twin.loop.device.setpoints
        return (np.linalg.norm(tip - wanted) < 5e-4 and commanded is not None
                and np.abs(measured - commanded.setpoints).max() < 2e-4)  # fmt: skip

    world.until(is_there, 60.0)
    assert all(robot.has_torque()) and hardware.bus_errors == 0
    # Lengths in metres arrive at the servos as ticks, of south and east the other way round.
    lengths = robot.twin.loop.device.setpoints - robot.twin.loop.simulation.rest_setpoints
    ticks = np.array([servo.position for servo in robot.servos.values()]) - 2048
    turns = np.array([1, 1, -1, -1]) * ticks / 4096
    np.testing.assert_allclose(-lengths, 2 * np.pi * 0.010 * turns, atol=1e-3)


def test_a_bus_that_fails_is_a_lost_device_and_is_used_again(world, robot, hardware):
    enable(world)
    world.until(lambda: all(robot.has_torque()))
    robot.bus.silent.add(3)
    world.until(lambda: hardware.bus_errors and robot.twin.loop.device_is_lost(robot.twin.monotonic()))
    robot.bus.silent.clear()
    world.until(lambda: not robot.twin.loop.device_is_lost(robot.twin.monotonic()))


def test_the_torque_is_off_after_the_node(world, robot, hardware):
    enable(world)
    world.until(lambda: all(robot.has_torque()))
    world.executor.remove_node(hardware)
    world.nodes.remove(hardware)
    hardware.destroy_node()
    assert not any(robot.has_torque())


def test_servos_that_do_not_answer_end_the_start_with_one_line(world, robot):
    robot.bus.silent.add(2)
    with pytest.raises(NoHardware, match="servo 2: no answer"):
        world.add(HardwareNode, servos_file=str(robot.file))
    assert "/device" not in [f"/{name}" for name in world.probe.get_node_names()]


def test_a_lost_twin_stops_the_servos(world, robot, hardware):
    enable(world)
    world.until(lambda: all(robot.has_torque()))
    robot.twin.stop()
    world.until(lambda: "no command arrives" in hardware.device.trouble)


def test_no_message_moves_a_servo_out_of_its_lengths(world, robot, hardware):
    seed = random.randrange(2**32)
    print(f"seed {seed}")
    draw = random.Random(seed)
    robot.twin.stop()
    hardware.stop()
    rest = robot.twin.loop.simulation.rest_setpoints
    hardware.tick()
    for index in range(3000):
        count = draw.choice((0, 1, 4, 4, 4, 5))
        names = draw.sample(NAMES, 4)[:count] if draw.random() < 0.8 else ["x"] * count
        honest = draw.random() < 0.5
        lengths = [float(length) + draw.uniform(-0.06, 0.01) if honest
                   else draw.choice(NUMBERS) for length in rest][:count]  # fmt: skip
        header = Header(stamp=world.stamp(), frame_id="base_link")
        hardware.take(JointState(header=header, name=names, position=lengths))
        if index % 100 == 0:
            hardware.tick()
            for servo, length in zip(robot.servos.values(), rest, strict=True):
                goal = int.from_bytes(servo.table[116:120], "little", signed=True)
                assert abs(goal - 2048) * 2 * np.pi * 0.010 / 4096 <= 0.0451
    assert hardware.device.refused > 100


@pytest.fixture
def regulators(tmp_path):
    """Simulated regulators, and the file that describes them."""
    described = read_regulators(FOLDER / "regulators.yaml")
    simulated = SimulatedRegulators(described)
    given = yaml.safe_load((FOLDER / "regulators.yaml").read_text())
    given |= {"host": "127.0.0.1", "port": simulated.module.port, "answer_time": 0.3}
    simulated.file = tmp_path / "regulators.yaml"
    simulated.file.write_text(yaml.safe_dump(given))
    yield simulated
    simulated.module.close()


def test_commands_fill_chambers_and_without_them_all_are_vented(world, regulators):
    node = world.add(HardwareNode, regulators_file=str(regulators.file), device_rate=20.0)
    heard = world.hear(FluidPressure, "/twin/measured_pressures/chamber_3")
    speaker, names = world.speaker(JointState, "/twin/cables"), list(regulators.pressures)

    def is_filled():
        header = Header(stamp=world.stamp(), frame_id="base_link")
        speaker.publish(JointState(header=header, name=names, position=[0.0, 0.0, 3e3, 1e3]))
        world.run(0.05)
        return heard and abs(heard[-1].fluid_pressure - 104325.0) < 30.0

    world.until(is_filled)
    assert heard[-1].variance > 0.0 and node.bus_errors == 0
    assert regulators.pressures["chamber_4"] == pytest.approx(1e3, abs=20.0)
    world.until(lambda: "no command arrives" in node.device.trouble)
    world.until(lambda: max(regulators.pressures.values()) < 30.0)
    regulators.module.is_silent = True
    world.until(lambda: node.bus_errors > 0)
    regulators.module.is_silent = False
    node.stop()
    assert node.device.close() == []


POSE = [0.1, -0.2, 0.3, 0.0, 0.0, math.sin(0.35), math.cos(0.35)]


def pose_at(position):
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = map(float, position)
    return pose


@builder
def make_mocap(world, /, kind, **parameters):
    node = world.add(MocapNode, mocap_type=kind, mocap_topic="/mocap", **parameters)
    heard = world.hear(PointCloud2, "/twin/markers")
    world.until(lambda: node.count_subscribers("/twin/markers"))
    return node, heard


@pytest.mark.parametrize("kind", ["PoseArray", "PoseStamped", "PointCloud2"])
def test_markers_of_a_tracker_arrive_in_metres_in_the_robots_frame(world, make_mocap, kind):
    own = np.array([[0.01, 0.02, 0.1], [-0.01, 0.0, 0.12], [0.0, 0.03, 0.09]])
    tracked = 1e3 * (own @ rotation_of(np.array(POSE[3:])).T + POSE[:3])
    header = Header(stamp=world.stamp(), frame_id="studio")
    ids = {"PoseArray": [4, 5, 6], "PoseStamped": [4], "PointCloud2": [70, 4, 71, 5, 72, 6]}[kind]
    node, heard = make_mocap(kind, mocap_ids=ids, mocap_pose=POSE, mocap_frame="studio")
    if kind == "PoseArray":
        message = PoseArray(header=header, poses=[pose_at(place) for place in tracked])
    elif kind == "PoseStamped":
        message = PoseStamped(header=header, pose=pose_at(tracked[0]))
    else:
        # A marker that the scene does not have is left out.
        places = np.vstack([tracked, [0, 0, 1]])
        message = markers_message(np.array([70, 71, 72, 99]), places, header)
    speaker = world.speaker(type(message), "/mocap")
    speaker.publish(message)
    world.until(lambda: heard)
    found, positions = read_markers(heard[0])
    count = 1 if kind == "PoseStamped" else 3
    assert found.tolist() == [4, 5, 6][:count]
    np.testing.assert_allclose(positions, own[:count], atol=1e-6)
    assert heard[0].header.frame_id == "base_link"
    assert node.refusals.total == 0


def test_hidden_markers_are_hidden_and_wrong_messages_are_counted(world, make_mocap):
    node, heard = make_mocap("PoseArray", mocap_ids=[1, 2, 3], mocap_frame="studio")
    header = Header(frame_id="studio")
    places = [[0.0, 0.0, 0.0], [math.nan, 0.0, 1.0], [10.0, 20.0, 30.0]]
    node.receive(PoseArray(header=header, poses=[pose_at(place) for place in places]))
    world.until(lambda: heard)
    _, positions = read_markers(heard[0])
    assert np.isnan(positions[:2]).all()
    np.testing.assert_allclose(positions[2], [0.01, 0.02, 0.03], atol=1e-7)
    node.receive(PoseArray(header=header, poses=[pose_at(places[2])]))
    node.receive(PoseArray(header=Header(frame_id="other"), poses=[pose_at(places[2])] * 3))
    assert node.refusals.by_word() == {"wrong_size": 1, "wrong_frame": 1}
    world.run(0.1)
    assert len(heard) == 1


def test_no_message_of_a_tracker_ends_its_node(world, make_mocap):
    seed = random.randrange(2**32)
    print(f"seed {seed}")
    draw = random.Random(seed)
    node, heard = make_mocap("PoseArray", mocap_ids=[1, 2, 3])
    for _ in range(2000):
        places = [[draw.choice(NUMBERS) for _ in range(3)] for _ in range(draw.choice((0, 3, 4)))]
        node.receive(PoseArray(header=Header(frame_id=draw.choice(("", "é" * 300))),
                                poses=[pose_at(place) for place in places]))  # fmt: skip
    node.receive(PoseArray(header=Header(), poses=[pose_at([10.0, 20.0, 30.0])] * 3))
    spin(node, world.executor, lambda: bool(heard) or node.tick_clock.ticks > 1)
    world.until(lambda: heard and np.isfinite(read_markers(heard[-1])[1]).all())


def test_the_frame_of_a_tracker_is_found_from_markers_at_rest(drawn_rng):
    draw = drawn_rng
    for _ in range(20):
        known = draw.normal(scale=0.1, size=(5, 3))
        turn = draw.normal(size=4)
        turn *= np.sign(turn[3]) / np.linalg.norm(turn)
        origin = draw.normal(size=3)
        pose, rest = fit_frame(known @ rotation_of(turn).T + origin, known)
        np.testing.assert_allclose(pose, [*origin, *turn], atol=1e-8)
        assert rest < 1e-12
        back = MocapFrame("mm", pose).to_robot(1e3 * (known @ rotation_of(turn).T + origin))
        np.testing.assert_allclose(back, known, atol=1e-9)
    # Three points in a plane are enough, and noise remains as a rest.
    flat = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    pose, _ = fit_frame(flat + [1.0, 2.0, 3.0], flat)
    np.testing.assert_allclose(pose, [1, 2, 3, 0, 0, 0, 1], atol=1e-9)
    noisy = known + 1e-3 * draw.normal(size=known.shape)
    assert 1e-4 < fit_frame(noisy, known)[1] < 5e-3
