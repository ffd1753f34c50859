"""Arbitrary messages, others in each run, end no node, and every command of the twin stays within
its limits.
"""

import array
import itertools
import math
import random
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped, PoseStamped, Twist
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, JointState, PointCloud2
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, Trigger

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.loop_timing import TickClock
from softrobot_twin.control.twin_loop import CONTESTED
from softrobot_twin.ros import ticking_node
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.messages import markers_message
from softrobot_twin.ros.parameters import ALL_TABLES
from softrobot_twin.ros.process import spin
from softrobot_twin.ros.target_node import TargetNode
from softrobot_twin.ros.topics import largest_message
from softrobot_twin.ros.twin_node import TwinNode
from test.builder import builder
from test.places import ROOT
from test.scene_changes import yaml_file

UNNUMBERED = {"publication_sequence_number": None, "source_timestamp": 0}
"""What rclpy tells of a message: by this, all are of one publisher."""

NODES = (TwinNode, DeviceNode, TargetNode)
"""In the order of `ALL_TABLES`."""
AIR = 101325.0
MESHES = {"diamond": "diamond_200", "trunk": "trunk_700"}
COUNTS, EVERY = [1_000, pytest.param(4_000, marks=pytest.mark.exhaustive)], 40
"""Number of messages of each of 18 cases, more than seventy thousand in all, and number per tick.
Each run draws other ones.
"""
_MANY = 40
MOST, HALF = 2**32 - 1, 2**31
NUMBERS = (0.0, -0.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 1e-12, 1e6, -1e6, 1.0, -1.0)
SIZES = (0, 1, 3, 15, 16, 17, 255, 65535, HALF - 1, HALF, HALF + 1, MOST - 15, MOST)
SECONDS = (-HALF, -1, 0, 1, HALF - 1)
FRAMES = ("", "map", "/base_link", "base_link ", "\0", "é" * 300, "x" * 5000)


class Hostile:
    """Fills messages with arbitrary values, and every second time with nearly valid values.

    Args:
        seed: Of all that it draws.
        node: The node that gets them.
        names: Names of its actuators.
        rest: Valid setpoint of each actuator [m], of cavities [Pa] or [m³].
        markers: Ids and positions of its markers.
        tip: Where an honest target is [m].
        reach: How far honest setpoints are from the valid ones, in the same units.
    """

    def __init__(self, seed, node, names, rest, markers, tip, reach=None):
        self.random = random.Random(seed)
        self._node, self._names, self._rest, self._tip = node, list(names), rest, tip
        self._markers = markers_message(*markers, Header())
        self._fill = {PointStamped: self.point, Twist: self.twist, JointState: self.joints,
                      PoseStamped: self.pose, PointCloud2: self.cloud,
                      FluidPressure: self.pressure}
        self._reach = [0.02] * len(rest) if reach is None else list(reach)

    def message(self, kind):
        message = kind()
        is_honest = self.random.random() < 0.5
        if hasattr(message, "header"):
            self.header(message.header, is_honest)
        self._fill[kind](message, is_honest)
        return message

    def number(self, honest, reach, is_honest):
        """A value near the valid one, or an arbitrary one."""
        if is_honest or self.random.random() < 0.5:
            return honest + self.random.uniform(-reach, reach)
        return self.random.choice(NUMBERS)

    def header(self, header, is_honest):
        now = self._node.get_clock().now().nanoseconds
        draw = self.random.random()
        if is_honest or draw < 0.6:
            header.stamp = Time(sec=now // 10**9, nanosec=now % 10**9)
        elif draw < 0.9:
            header.stamp = Time(sec=now // 10**9 + self.random.choice((-3600, -5, -1, 0, 1, 3600)),
                                nanosec=self.random.choice((0, 10**9 - 1, 10**9, MOST)))
        else:
            header.stamp = Time(sec=self.random.choice(SECONDS), nanosec=self.random.choice(SIZES))
        is_ours = is_honest or self.random.random() < 0.8
        header.frame_id = "base_link" if is_ours else self.random.choice(FRAMES)

    def point(self, message, is_honest):
        for axis, honest in zip("xyz", self._tip, strict=True):
            setattr(message.point, axis, self.number(honest, 0.05, is_honest))

    def twist(self, message, is_honest):
        for part in (message.linear, message.angular):
            for axis in "xyz":
                setattr(part, axis, self.number(0.0, 1.0, is_honest))

    def pose(self, message, is_honest):
        for axis in "xyz":
            setattr(message.pose.position, axis, self.number(0.05, 0.1, is_honest))
        turn = [self.number(0.0, 1.0, is_honest) for _ in range(4)]
        if is_honest:
            length = math.hypot(*turn)
            turn = [part / length for part in turn]
        for axis, part in zip("xyzw", turn, strict=True):
            setattr(message.pose.orientation, axis, part)

    def pressure(self, message, is_honest):
        message.fluid_pressure = self.number(AIR + 2e3, 1e4, is_honest)
        message.variance = self.number(0.0, 1.0, is_honest)

    def joints(self, message, is_honest):
        names, rest = list(self._names), self._rest + [0.1] * _MANY
        reach = self._reach + [0.02] * _MANY
        if not is_honest:
            for _ in range(self.random.randrange(3)):
                self.random.choice((self.random.shuffle, list.clear, self.double, self.rename))(names)
        message.name = names
        if self.random.random() < 0.8:
            count = len(names) if is_honest else self.random.choice((0, 1, len(names), _MANY))
            message.position = [self.number(rest[i], reach[i], is_honest) for i in range(count)]
        if self.random.random() < 0.5:
            count = len(names) if is_honest else self.random.choice((0, 1, len(names), _MANY))
            message.effort = [self.number(1.0, 3.0, is_honest) for _ in range(count)]

    def double(self, names):
        names += names[:2]

    def rename(self, names):
        names.append(self.random.choice(FRAMES))

    def cloud(self, message, is_honest):
        honest = self._markers
        for name in ("height", "width", "is_bigendian", "point_step", "row_step", "data"):
            setattr(message, name, getattr(honest, name))
        # Fields are objects; changing them would change the valid message.
        message.fields = [type(field)(name=field.name, offset=field.offset, count=field.count,
                                      datatype=field.datatype) for field in honest.fields]
        if is_honest:
            return
        for _ in range(self.random.randrange(4)):
            self.random.choice((self.resize, self.spoil_data, self.spoil_field))(message)

    def resize(self, message):
        name = self.random.choice(("height", "width", "point_step", "row_step"))
        setattr(message, name, self.random.choice(SIZES))

    def spoil_data(self, message):
        draw = self.random.random()
        if draw < 0.3:
            message.data = array.array("B", self.random.randbytes(len(message.data)))
        elif draw < 0.6:
            message.data = array.array("B", self.random.randbytes(self.random.randrange(400)))
        elif draw < 0.8:
            message.data = array.array("B")
        else:
            message.is_bigendian = not message.is_bigendian

    def spoil_field(self, message):
        if self.random.random() < 0.1 or not message.fields:
            message.fields = list(message.fields) * self.random.randrange(60)
            return
        field = self.random.choice(message.fields)
        field.offset = self.random.choice(SIZES)
        field.datatype = self.random.choice((field.datatype, 0, 6, 7, 8, 255))
        field.count = self.random.choice((0, 1, 2, MOST))
        field.name = self.random.choice((field.name, "x", "id", "", "é" * 200))


class Witness:
    """Replaces the twin's publisher and checks each command.

    It is the device too, where there is one: it is at its last command.

    Attributes:
        count: Commands that came.
        lengths: Setpoints of the device [m], of cavities [Pa] or [m³].
    """

    def __init__(self, twin):
        simulation = twin.loop.simulation
        self._limits = simulation.limits
        self._low, self._high = self._limits.setpoint_range(np.array(simulation.rest_setpoints))
        is_metre = np.array([kind.setpoint.unit == "m" for kind in simulation.actuators.kinds])
        scale = np.where(is_metre, 0.04, self._limits.drive_scale)
        self.lengths = self._high - 0.1 * np.minimum(self._high - self._low, scale)
        self._noise, self._near = 2.5e-4 * scale, 2.5e-3 * scale
        self._within = 1e-9 * np.where(is_metre, 1.0, scale)
        self._twin, self._last, self._measured = twin, None, []
        self.count = 0
        twin.cables.publish = self.judge

    def measurement(self, random, end):
        """The message of a correct device on a topic."""
        position = [length + random.gauss(0.0, noise)
                    for length, noise in zip(self.lengths, self._noise, strict=True)]
        names = list(self._twin.loop.simulation.actuator_names)
        if end.msg_type is FluidPressure:
            name = end.topic_name.rpartition("/")[2]
            if name in self._twin.loop.cavities.by_volume:
                return FluidPressure(fluid_pressure=AIR)
            return FluidPressure(fluid_pressure=float(AIR + position[names.index(name)]))
        return JointState(name=names, position=position, effort=[0.0] * len(names))

    def tick(self):
        """One tick of the twin. After a tick without a command it may start again at measured
        lengths.
        """
        count = self.count
        self._twin.tick()
        assert_no_tick_failed(self._twin)
        if self.count == count and self._twin.loop.use_device:
            self._last = None
        if self._last is not None:
            self._measured.clear()

    def begin_anew(self):
        """Disables the twin, measures, and enables it, as an operator does after a fault."""
        self.measure_until_uncontested()
        for is_on in (False, True):
            response = self._twin.enable(SetBool.Request(data=is_on), SetBool.Response())
            assert response.success, response.message

    def ticks_until_a_command(self, most):
        """Ticks with a correct device and no other message until a command comes; at most these."""
        draw, count = random.Random(0), self.count
        for tick in range(most):
            self.measure(draw)
            self.tick()
            if self.count > count:
                return tick
        return most

    def measure_until_uncontested(self):
        """Measures as one correct device does, until no contradiction by another is remembered.

        While one is, the twin is disabled, sends nothing and refuses to start, with this reason.
        """
        twin, draw, began = self._twin, random.Random(0), time.monotonic()
        while True:
            self.measure(draw)
            if not (twin.loop.use_device and twin.loop.device.places.is_disputed(twin.monotonic())):
                return
            assert time.monotonic() - began < 60.0
            count = self.count
            self.tick()
            if twin.loop.device.places.is_contested(twin.monotonic()):
                response = twin.enable(SetBool.Request(data=True), SetBool.Response())
                # The contest may have ended while the request was answered.
                if twin.loop.device.places.is_contested(twin.monotonic()):
                    assert not response.success and response.message == CONTESTED
                    assert not twin.loop.is_enabled and self.count == count
            time.sleep(0.02)

    def measure(self, draw):
        """Sends what a correct device measures."""
        for end in inputs(self._twin):
            if is_measurement(end):
                end.callback(serialize_message(self.measurement(draw, end)), UNNUMBERED)
                self.heard()

    def heard(self):
        """Stores measured lengths that the twin accepted; it may start from one of them."""
        if (lengths := self._twin.loop.device.setpoints) is not None:
            self._measured = [*self._measured[-400:], lengths]

    def _is_safe(self, lengths, before, reach):
        """True when the rates allow setpoints after these; None is an unknown start."""
        start = lengths if before is None else before
        # A device outside its limits is not moved further out.
        shortest = np.minimum(self._low, start) - self._within
        longest = np.maximum(self._high, start) + self._within
        is_near = np.abs(lengths - start) <= reach
        return bool((is_near & (shortest <= lengths) & (lengths <= longest)).all())

    def judge(self, message):
        message = deserialize_message(message, JointState)
        lengths, tensions = np.array(message.position), np.array(message.effort)
        assert np.isfinite(lengths).all() and np.isfinite(tensions).all()
        limits, within = self._limits, self._within
        slack = 1e-9 * np.maximum(1.0, limits.effort_scale)
        is_free = limits.is_effort_driven  # Its effort is its setpoint.
        assert ((tensions <= limits.effort_max + slack) | is_free).all()
        assert ((tensions >= limits.effort_min - slack) | is_free).all()
        assert (tensions[is_free] == lengths[is_free]).all()
        reach = limits.rate * self._twin.loop.settings.period + within
        starts = [self._last]
        if self._last is None and self._twin.loop.use_device:
            # The setpoints of the resynchronisation, within the tolerance of a solution.
            starts, reach = self._measured, reach + self._near
        assert any(self._is_safe(lengths, start, reach) for start in starts)
        self._last = self.lengths = lengths
        self.count += 1


def assert_no_tick_failed(node):
    """An exception in a tick, also one of a check in a publisher, ends only the tick."""
    assert node.failed_ticks == 0, node.failure


@builder
def parameters(tmp_path, air_scene, posed_scene_file, /, robot):
    """Parameters of a robot, its scene on a coarse mesh; of the block with cavities, `air`, and of
    the Diamond whose tip has an orientation, `posed`.
    """
    if robot == "air":
        file = yaml_file(tmp_path / "air.yaml", air_scene)
        return {"scene_file": str(file), "device_scene_file": str(file)}
    if robot == "posed":
        return {"scene_file": str(posed_scene_file)}
    given = yaml.safe_load((ROOT / f"config/{robot}.yaml").read_text())["/**"]["ros__parameters"]
    mesh = MESHES.get(robot)
    for name in ("scene_file", "device_scene_file"):
        text = (ROOT / "config" / given[name]).read_text().replace("../../meshes", str(ROOT / "meshes"))
        if mesh:
            text = re.sub(rf"{robot}_\d+\.vtk", f"{mesh}.vtk", text)
        file = tmp_path / f"{robot}_{name}.yaml"
        file.write_text(text)
        given[name] = str(file)
    return {name: value for name, value in given.items() if value != [""]}


@pytest.fixture(autouse=True)
def quiet_nodes():
    """Suppresses thousands of warnings; restores the log level, which belongs to the process."""
    for name in ("twin", "device"):
        set_logger_level(name, LoggingSeverity.FATAL)
    yield
    for name in ("twin", "device"):
        set_logger_level(name, LoggingSeverity.UNSET)


def begin(world, parameters, robot, node_class=TwinNode, **changes):
    node = world.add(node_class, **{**parameters(robot), **changes})
    node.stop()
    return node


def hostile_to(twin, seed):
    simulation = twin.loop.simulation
    tip = (0.0, 0.0, 0.13)
    if simulation.effector_names:
        tip = simulation.effector_positions()[0]
    markers = simulation.marker_ids, simulation.marker_positions()
    kinds, scale = simulation.actuators.kinds, simulation.limits.drive_scale
    reach = [0.02 if kind.setpoint.unit == "m" else 0.3 * float(own)
             for kind, own in zip(kinds, scale, strict=True)]
    return Hostile(seed, twin, simulation.actuator_names, list(simulation.rest_setpoints), markers,
                   tip, reach)


def inputs(node):
    """The subscriptions of a node's loop: neither those of rclpy nor that of other twins' claims."""
    return [entry for entry in node.subscriptions if entry.msg_type not in (Clock, String)]


def is_measurement(end):
    """True for a topic on which a device tells its lengths or pressures."""
    return end.topic_name.startswith("/twin/measured_")


def draw_seed():
    seed = random.randrange(2**32)
    print(f"seed {seed}")
    return seed


CASES = [
    ("diamond", "inverse", False), ("diamond", "inverse", True), ("diamond", "direct", True),
    ("trunk", "inverse", False), ("trunk", "inverse", True), ("trunk", "direct", True),
    ("grasper", "direct", False), ("grasper", "direct", True),
    ("octoleg", "direct", False), ("octoleg", "direct", True),
    ("air", "inverse", True), ("air", "direct", True), ("posed", "inverse", False),
]  # fmt: skip


def run_hostile(world, parameters, case, seed, count, every):
    robot, mode, use_device = case
    twin = begin(world, parameters, robot, mode=mode, use_device=use_device,
                 closed_loop=robot == "diamond", deadline=0.0)
    hostile, witness, ends = hostile_to(twin, seed), Witness(twin), inputs(twin)
    draw, pauses = hostile.random, count // 1000
    for number in range(count):
        end = draw.choice(ends)
        is_measured = is_measurement(end)
        # The twin never starts from a device with mostly invalid messages, and sends nothing.
        if is_measured and draw.random() < 0.97:
            message = witness.measurement(draw, end)
            hostile.header(message.header, True)
        else:
            message = hostile.message(end.msg_type)
        end.callback(serialize_message(message), UNNUMBERED)
        if is_measured:
            witness.heard()
        if draw.random() < 0.01 and not twin.loop.is_enabled:
            if pauses and twin.loop.why_given_up == CONTESTED:
                # Otherwise the twin would be disabled from the first contradiction to the end.
                pauses -= 1
                witness.measure_until_uncontested()
            twin.enable(SetBool.Request(data=True), SetBool.Response())
        if number % every == every - 1:
            witness.tick()
            if draw.random() < 0.02:
                twin.reset(Trigger.Request(), Trigger.Response())
    return witness


@pytest.mark.sampled
@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
@pytest.mark.parametrize("count", COUNTS)
def test_no_message_ends_a_twin_or_causes_an_unsafe_command(world, parameters, case, count):
    witness = run_hostile(world, parameters, case, draw_seed(), count, EVERY)
    # How many commands came before depends on the seed: a twin that was disabled stays so.
    witness.begin_anew()
    assert witness.ticks_until_a_command(most=1000) < 1000


@pytest.mark.sampled
@pytest.mark.parametrize("robot", ["diamond", "trunk", "grasper", "octoleg", "air"])
@pytest.mark.parametrize("count", COUNTS)
def test_no_message_ends_a_device(world, parameters, robot, count):
    seed = draw_seed()
    device = begin(world, parameters, robot, DeviceNode)
    simulation = device.device.simulation
    markers = simulation.marker_ids, simulation.marker_positions()
    hostile = Hostile(seed, device, simulation.actuator_names, list(simulation.rest_setpoints),
                      markers, (0.0, 0.0, 0.1))
    measured, ends, period = [], inputs(device), device.tick_clock.period
    device.cables.publish = measured.append
    # Few ticks: a palm that is pressed into all around it takes seconds a step.
    every = 250
    # Its own time: after a long wait on a busy machine it would be carried far into other bodies.
    times = [0.0]
    device.tick_clock = TickClock(period, lambda: times[-1])
    for number in range(count):
        end = hostile.random.choice(ends)
        end.callback(serialize_message(hostile.message(end.msg_type)), UNNUMBERED)
        if number % every == every - 1:
            times.append(times[-1] + period)
            device.tick()
            assert_no_tick_failed(device)
    lengths = np.array([list(message.position) for message in measured])
    assert len(lengths) == count // every and np.isfinite(lengths).all()


def test_no_message_ends_a_target(world):
    target = world.add(TargetNode)
    target.stop()
    hostile = Hostile(2, target, (), [], (np.empty(0, np.uint32), np.empty((0, 3))), (0, 0, 0.1))
    (end,) = inputs(target)
    sent = []
    target.targets.publish = sent.append
    for _ in range(1000):
        end.callback(serialize_message(hostile.message(PointStamped)), UNNUMBERED)
    for _ in range(10):
        target.tick()
    assert_no_tick_failed(target)
    assert len(sent) == 10
    assert all(math.isfinite(value) for message in sent
               for value in (message.point.x, message.point.y, message.point.z))


@pytest.fixture
def told(world, parameters, monkeypatch, node_class, robot):
    """A node that does not tick, and a list of what it warns of."""
    given = {} if node_class is TargetNode else parameters(robot)
    known = {entry.name for entry in ALL_TABLES[NODES.index(node_class)]}
    node = world.add(node_class, **{key: given[key] for key in given.keys() & known})
    node.stop()
    told = []
    monkeypatch.setattr(node, "get_logger", lambda: SimpleNamespace(warning=told.append))
    return node, told


@pytest.mark.sampled
@pytest.mark.parametrize("robot", ["diamond", "trunk", "grasper", "air"])
@pytest.mark.parametrize("node_class", [TwinNode, DeviceNode, TargetNode])
def test_a_message_that_is_too_large_is_refused_unread_on_every_topic(told, monkeypatch, node_class):
    def read(content, kind):
        raise AssertionError(f"{len(content)} bytes of a {kind.__name__} are read")

    node, told = told
    monkeypatch.setattr(ticking_node, "read_message", read)
    ends = inputs(node)
    for end in 2 * ends:
        end.callback(bytes(2**21), UNNUMBERED)
    assert len(ends) == len(told)  # Once in two seconds.
    assert all("refused, too_large" in line for line in told)
    if node_class is TwinNode:
        loop = node.loop
        assert loop.markers.refusals.by_word() == {"too_large": 2}
        assert loop.device.refusals.of(Refusal.TOO_LARGE) >= 2


@pytest.mark.parametrize("robot", ["diamond"])
@pytest.mark.parametrize("node_class", [TwinNode, TargetNode])
def test_bytes_that_are_no_message_are_refused_on_every_topic(told):
    node, told = told
    ends = inputs(node)
    for end in ends:
        for content in (b"", b"\0", b"\0\1\0\0" + b"\xff" * 40):
            end.callback(content, UNNUMBERED)
    assert len(ends) == len(told)
    assert all(end.topic_name in line and "unreadable" in line for end, line in zip(ends, told))
    assert node.refused_requests == 0


def test_a_message_that_names_all_actuators_is_never_too_large():
    for count, length in itertools.product((1, 30, 1000), (1, 20, 200)):
        names = ["é" * length + f"_{number}" for number in range(count)]
        values = [0.1] * count
        message = JointState(name=names, position=values, velocity=values, effort=values)
        message.header.frame_id = "x" * 1000
        assert len(serialize_message(message)) < largest_message(JointState, names)
    cloud = markers_message(np.arange(10_000), np.zeros((10_000, 3)), Header())
    assert len(serialize_message(cloud)) < largest_message(PointCloud2)


@pytest.mark.parametrize("seed", [3, pytest.param(None, marks=pytest.mark.exhaustive)])
def test_hostile_messages_over_the_network_leave_the_twin_ticking(world, parameters, seed):
    seed = draw_seed() if seed is None else seed
    twin = world.add(TwinNode, **{**parameters("diamond"), "use_device": False, "rate": 50.0})
    hostile, witness = hostile_to(twin, seed), Witness(twin)
    speakers = [(end.msg_type, world.speaker(end.msg_type, end.topic_name)) for end in inputs(twin)]
    left = [300]

    def send():
        kind, publisher = hostile.random.choice(speakers)
        publisher.publish(hostile.message(kind))
        left[0] -= 1
        return left[0] <= 0

    spin(twin, world.executor, send)
    before = twin.tick_clock.ticks
    spin(twin, world.executor, lambda: twin.tick_clock.ticks > before + 5)
    assert_no_tick_failed(twin)
    assert witness.count > 5


def test_requests_that_rclpy_cannot_handle_are_refused_and_the_twin_continues(world, parameters):
    """rclpy raises an exception for an unknown parameter type instead of answering."""
    twin = world.add(TwinNode, **{**parameters("diamond"), "use_device": False, "rate": 50.0})
    draw = random.Random(4)
    client = world.probe.create_client(SetParameters, "/twin/set_parameters")
    world.until(client.service_is_ready)
    names = ("rate", "deadline", "workspace_min", "on_lost_device", "use_sim_time", "mode", "",
             "a b", "x" * 5000, "no.such")
    settings = twin.loop.settings
    for _ in range(60):
        value = ParameterValue(
            type=draw.choice((0, 1, 2, 3, 4, 5, 8, 9, 77, 255)), double_value=math.nan,
            integer_value=-(2**63), string_value="é" * 1000, double_array_value=[math.inf],
        )
        client.call_async(SetParameters.Request(parameters=[Parameter(name=draw.choice(names), value=value)]))
        before = twin.tick_clock.ticks
        spin(twin, world.executor, lambda before=before: twin.tick_clock.ticks > before)
    assert_no_tick_failed(twin)
    assert twin.refused_requests > 0
    assert twin.loop.settings == settings


def test_an_unsafe_command_fails_the_hostile_runs(world, parameters):
    twin = begin(world, parameters, "diamond", use_device=False)
    witness = Witness(twin)
    witness.tick()
    assert witness.count == 1
    witness._last = witness._last + 1.0  # No rate allows the next command after this one.
    with pytest.raises(AssertionError, match="AssertionError: "):
        witness.tick()
