"""The topics and services of the three nodes: each is declared once, with its type, its quality of
service, its unit and its meaning.

The nodes open topics by these tables only; ``docs/topics.md`` and ``--help`` are made from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import Enum
from importlib import import_module
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, Twist, Vector3Stamped, WrenchStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import FluidPressure, JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from softrobot_twin.tables.channels import Channel, measured, registered

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT

NEWEST = QoSProfile(depth=1, reliability=RELIABLE)
"""Of targets, commands and results: only the newest counts, and it is sent again if it is lost."""
LAST_FEW = QoSProfile(depth=5, reliability=RELIABLE)
"""Of commands that arrive during a step of the simulated device: with a delay, an older one takes
effect."""
STREAM = QoSProfile(depth=1, reliability=BEST_EFFORT)
"""Of what is measured many times a second: a subscription of this kind accepts both kinds of
publishers."""
CLAIM = QoSProfile(depth=10, reliability=BEST_EFFORT)
"""Of what each of several nodes says many times a second."""
LATCHED = QoSProfile(depth=1, reliability=RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of what changes rarely: who subscribes late receives the last message."""
ALL_LATCHED = QoSProfile(depth=100, reliability=RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""That of `/tf_static`."""
DIAGNOSTICS = QoSProfile(depth=10, reliability=RELIABLE)
TRANSFORMS = QoSProfile(depth=100, reliability=RELIABLE)
"""That of tf2."""


class Direction(Enum):
    """Whether a node receives a topic or publishes it."""

    IN = "in"
    OUT = "out"


IN, OUT = Direction.IN, Direction.OUT


class Topic(NamedTuple):
    """One topic, or one for each object of a kind.

    Attributes:
        name: Its name; ``~`` is the node, ``<twin>`` the parameter ``twin``, and a further word in
            brackets the object, such as ``~/target/<effector>``.
        direction: Whether the node receives or publishes it.
        kind: Class of its messages, or its name where the package may be missing.
        quality: Quality of service with which the node opens it.
        unit: Units of its values, or an empty string.
        meaning: What it means, in markdown; no upper case at its beginning.
        call: Of an input of the twin the call of its loop that takes the messages, such as
            ``markers.accept``; see `TwinLoop.calls`.
    """

    name: str
    direction: Direction
    kind: type | str
    quality: QoSProfile
    unit: str
    meaning: str
    call: str = ""

    @property
    def type_name(self) -> str:
        """Name of the type, such as ``sensor_msgs/JointState``."""
        return self.kind if isinstance(self.kind, str) else type_name(self.kind)

    def full_name(self, name: str = "", twin: str = "") -> str:
        """Name by which it is opened.

        Args:
            name: Name of the object, for a topic of each object of a kind.
            twin: Value of the parameter ``twin``, for a topic of another node's twin.
        """
        found = self.name.replace("<twin>", twin)
        if "<" in found:
            found = found[: found.index("<")] + name + found[found.index(">") + 1 :]
        return found


class Service(NamedTuple):
    """One service.

    Attributes:
        name: Its name; ``~`` is the node.
        kind: Class of its requests and responses.
        meaning: What it does, in markdown.
    """

    name: str
    kind: type
    meaning: str

    @property
    def type_name(self) -> str:
        """Name of the type, such as ``std_srvs/SetBool``."""
        return type_name(self.kind)


def type_name(kind: type) -> str:
    """Name of the class of a message or service, such as ``sensor_msgs/JointState``.

    Args:
        kind: Class of a message or service.
    """
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def class_named(name: str) -> type:
    """Class of a message by its `type_name`.

    Args:
        name: The name, as fields of messages state it too.
    """
    package, _, word = name.partition("/")
    return getattr(import_module(f"{package}.msg"), word)


def quality_in_words(quality: QoSProfile) -> str:
    """A quality of service, such as ``reliable, newest 1``, ``reliable, latched, newest 1``.

    Args:
        quality: The quality of service.
    """
    words = ["reliable" if quality.reliability == RELIABLE else "best effort"]
    if quality.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("latched")
    return ", ".join([*words, f"newest {quality.depth}"])


def open_publisher(node: Node, topic: Topic, name: str = "", twin: str = "") -> Publisher:
    """Publishes a declared topic; see `Topic.full_name`."""
    return node.create_publisher(topic.kind, topic.full_name(name, twin), topic.quality)


_LARGEST = {PointCloud2: 2**20, Path: 2**17}
_LARGEST_OTHER = 4096
_SIZE_OF_JOINT = 64
"""Most bytes of a joint's values and of the length of its name, twice as many as needed."""


def largest_message(kind: type, names: Iterable[str] = ()) -> int:
    """Size above which a received message is refused unread [bytes].

    Reading a message takes time that grows with its size: 20 ms for 10⁵ names.

    Args:
        kind: Type of the messages.
        names: Names of actuators that messages may contain.
    """
    of_names = sum(2 * len(name.encode()) + _SIZE_OF_JOINT for name in names)
    return _LARGEST.get(kind, _LARGEST_OTHER + of_names)


def open_subscription(
    node: Node, topic: Topic, receive: Callable[[bytes], None], name: str = "", twin: str = ""
) -> Subscription:
    """Receives a declared topic as serialized messages; see `Topic.full_name`."""
    return node.create_subscription(topic.kind, topic.full_name(name, twin), receive, topic.quality, raw=True)


def _by_name(*topics: Topic) -> dict[str, Topic]:
    return {topic.name: topic for topic in topics}


TWIN_TOPICS = _by_name(
    Topic("~/target/<effector>", IN, PointStamped, NEWEST, "m",
          "limited to the workspace", "targets.accept_point"),
    Topic("~/target_pose/<effector>", IN, PoseStamped, NEWEST, "m",
          "of effectors with `orientation`: position, and turn from rest",
          "targets.accept_pose"),
    Topic("~/target_path/<effector>", IN, Path, NEWEST, "m",
          "in scenes with `control`: where the target will be at the stamp of each pose",
          "targets.accept_path"),
    Topic("~/target_stiffness/<effector>", IN, Vector3Stamped, NEWEST, "N/m",
          "along x, y, z, NaN where free; replaces `stiffness.target` until `~/reset` "
          "or `~/enable`", "stiffness.accept"),
    Topic("~/target_sensors", IN, JointState, NEWEST, "m, rad, m³, Pa, N",
          "of sensors with a `weight`: wanted values in `position`, NaN where free; others keep "
          "theirs until `~/reset` or `~/enable`", "sensors.accept"),
    Topic("~/target_velocity", IN, Twist, NEWEST, "m/s, rad/s",
          "integrated, limited in speed and workspace, until `velocity_timeout`; the angular part "
          "turns an effector with `orientation`",
          "targets.accept_velocity"),
    Topic("~/touch_force/<touch>", IN, WrenchStamped, STREAM, "N",
          "force on the robot; zero or NaN ends the touch; refused above `force_limit`",
          "touches.accept_force"),
    Topic("~/touch_position/<touch>", IN, PointStamped, STREAM, "m",
          "the touched point is held there; NaN ends the touch", "touches.accept_place"),
    Topic("~/markers", IN, PointCloud2, STREAM, "m",
          "x y z float32, id uint32; NaN = hidden",
          "markers.accept"),
    Topic("~/measured_cables", IN, JointState, STREAM, "m, N",
          "measured setpoints and efforts, as in `~/cables`; cavities under pressure and cables "
          "with pulleys may be omitted", "device.accept"),
    Topic("~/measured_angles", IN, JointState, STREAM, "rad, N m",
          "of pulleys and hinge motors: angle in `position`, torque in `effort` (optional)", "measured_angles.accept"),
    Topic("~/measured_pressures/<cavity>", IN, FluidPressure, STREAM, "Pa, absolute",
          "of a cavity under pressure; `frame_id` and `variance` are not used", "measured_pressures.accept"),
    Topic("~/base_pose", IN, PoseStamped, STREAM, "m",
          "pose of a `moving_base` in a frame that does not accelerate. In its place `base_frame` "
          "names a frame of `/tf`",
          "measured_base.accept"),
    Topic("~/command/cables", IN, JointState, NEWEST, "m, N",
          "setpoints in `position` or efforts in `effort`, by names of actuators or motors. In "
          "`mode: direct` the others follow earlier messages of this kind, or hold. In `mode: "
          "inverse` they are optimised; an empty message commands none",
          "commands.accept"),
    Topic("~/command/angles", IN, JointState, NEWEST, "rad",
          "in `position`, by names of cables or motors with pulleys; others stay", "angles.accept"),
    Topic("~/command/pressures/<cavity>", IN, FluidPressure, NEWEST, "Pa, absolute",
          "commands this cavity; others stay. In `mode: inverse` an empty message on "
          "`~/command/cables` ends it", "pressures.accept"),
    Topic("~/command/pose/<guided body>", IN, PoseStamped, NEWEST, "m",
          "limited to the workspace and in speed and turn rate", "poses.accept"),
    Topic("~/cables", OUT, JointState, NEWEST, "m, N",
          "`position` and `effort`: length and tension of a cable, position and force of a "
          "slide, angle [rad] and torque [N m] of a hinge motor, pressure [Pa] twice of a "
          "cavity, or with `control: volume` its volume [m³] and pressure"),
    Topic("~/cable_paths", OUT, JointState, NEWEST, "m",
          "length of each cable's path, shorter than in `~/cables` where it is slack; on demand"),
    Topic("~/cables/claim", OUT, String, CLAIM, "",
          "5 Hz: this twin lives, and is enabled or not. A later twin stays silent"),
    Topic("~/angles", OUT, JointState, NEWEST, "rad, N m",
          "angle and torque of each pulley, with the stamp of `~/cables`"),
    Topic("~/pressures/<cavity>", OUT, FluidPressure, NEWEST, "Pa, absolute",
          "gauge plus `ambient_pressure`, with the stamp of `~/cables`; `variance` 0 (unknown)"),
    Topic("~/effectors/<effector>", OUT, PointStamped, NEWEST, "m", "predicted position"),
    Topic("~/effector_poses/<effector>", OUT, PoseStamped, NEWEST, "m",
          "of effectors with `orientation`: predicted position, and turn from rest"),
    Topic("~/stiffness/<effector>", OUT, Vector3Stamped, NEWEST, "N/m",
          "the stiffness shown, NaN where none is wanted"),
    Topic("~/touch/<touch>", OUT, JointState, NEWEST, "m, N",
          "names x, y, z: `position` = displacement since the touch began [m], `effort` = force "
          "on the robot [N]"),
    Topic("~/figures", OUT, JointState, NEWEST, "as the names say",
          "what optional effects report, in `position`"),
    Topic("~/compliance/<effector>", OUT, Float64MultiArray, NEWEST, "m/N",
          "3×3: motion by a force while the actuators hold; on demand"),
    Topic("~/jacobian/<effector>", OUT, Float64MultiArray, NEWEST, "m per unit of the actuator",
          "3 × actuators, in the order of `~/cables`: motion by each; labels name columns and "
          "units; on demand"),
    Topic("~/external_forces/<force>", OUT, WrenchStamped, NEWEST, "N, N m",
          "force on the robot that the `observer` found; a torque only on a rigid body"),
    Topic("~/force_deviations/<force>", OUT, JointState, NEWEST, "N, m",
          "names x, y, z: `position` = place of that force [m], `effort` = its standard "
          "deviation [N]"),
    Topic("~/external_contacts", OUT, JointState, NEWEST, "1",
          "names of observed forces: `position` = 1 where the force is beyond noise, else 0"),
    Topic("~/predicted_markers", OUT, PointCloud2, NEWEST, "m",
          "markers of the model; on demand"),
    Topic("~/bodies/<rigid body>", OUT, PoseStamped, NEWEST, "m",
          "predicted pose; on demand"),
    Topic("~/poses/<guided body>", OUT, PoseStamped, NEWEST, "m",
          "commanded pose of a guided body, for the device"),
    Topic("~/contacts", OUT, PointCloud2, STREAM, "m, N",
          "x y z fx fy fz float32: each contact, and its force on the pair's first body"),
    Topic("~/visualization", OUT, MarkerArray, NEWEST, "m",
          "the scene, for RViz and Foxglove, at `visualization_rate`; on demand"),
    Topic("~/status", OUT, DiagnosticStatus, LATCHED, "",
          "when it changes: what the loop does and why, status, active limits"),
    Topic("/tf", OUT, "tf2_msgs/TFMessage", TRANSFORMS, "m",
          "from `frame_id` to rigid bodies and effectors, and from `tf_base_frame` to `frame_id`; "
          "on demand, with tf2_msgs"),
    Topic("/diagnostics", OUT, DiagnosticArray, DIAGNOSTICS, "",
          "1 Hz, and at once when something serious changes: `<node>: loop`, `solver`, "
          "`limits`, `markers`, `device`, `target`, `view`, `graph`, `record`, `contact`, "
          "`touch`, `observer`"),
)  # fmt: skip
"""Topics of the twin, by name."""


def _of_twin(name: str, direction: Direction, quality: QoSProfile, meaning: str) -> Topic:
    """The other end of a topic of a twin, for another node."""
    twin = TWIN_TOPICS[f"~/{name}"]
    return Topic(f"<twin>/{name}", direction, twin.kind, quality, twin.unit, meaning)


def channel_topic(channel: Channel) -> Topic:
    """The topic by which the twin publishes a channel that `register_channel` knows.

    Args:
        channel: The channel.
    """
    return Topic(f"~/{channel.name}/<object>", OUT, JointState, NEWEST, channel.unit,
                 f"{', '.join(channel.parts)} in `position`")


def measured_topic(channel: Channel) -> Topic:
    """The topic by which the twin takes measured numbers of such a channel.

    Args:
        channel: The channel.
    """
    name = channel.measured_name
    return Topic(f"~/{name}/<{channel.name}>", IN, JointState, STREAM, channel.unit,
                 f"as `~/{channel.name}/<object>`; ≤ {channel.most:g}",
                 f"{name}.accept")  # fmt: skip


TWIN_SERVICES = (
    Service("~/enable", SetBool,
            "starts from the measured setpoints, or says why not; needed with `use_device`"),
    Service("~/reset", Trigger,
            "back to the rest shape, within the rate limits; with a device only the model "
            "returns, and the twin is disabled"),
    Service("~/grip/<grip>", SetBool, "takes hold of what is in the reach of a grip, or lets go"),
    Service("~/calibrate", Trigger,
            "fits `calibrate_fit` to the poses at rest so far; the result is in `/diagnostics`"),
)  # fmt: skip
"""Services of the twin."""

DEVICE_TOPICS = _by_name(
    _of_twin("cables", IN, LAST_FEW,
             "setpoints to which the robot moves, as the twin publishes them"),
    _of_twin("poses/<guided body>", IN, LAST_FEW, "pose to which a guided body moves"),
    _of_twin("measured_cables", OUT, NEWEST,
             "measured lengths and tensions, cavities as in the twin's `~/cables`"),
    _of_twin("measured_angles", OUT, NEWEST,
             "measured angles and torques of pulleys"),
    _of_twin("measured_pressures/<cavity>", OUT, NEWEST,
             "measured pressure; `variance` [Pa²] as the sensor has it"),
    _of_twin("markers", OUT, NEWEST, "measured markers: x y z float32, id uint32; NaN = hidden"),
    _of_twin("touch_position/<touch>", OUT, NEWEST, "with `device_touch` and `device_touch_sends: "
             "position`: the touched point, NaN without a touch"),
    _of_twin("touch_force/<touch>", OUT, NEWEST, "with `device_touch` and `device_touch_sends: "
             "force`: the force on the robot, zero without a touch"),
    *(TWIN_TOPICS[name] for name in ("~/touch/<touch>", "~/effectors/<effector>", "~/bodies/<rigid body>")),
)  # fmt: skip
"""Topics of the device, by name."""

TARGET_TOPICS = _by_name(
    _of_twin("effectors/<effector>", IN, NEWEST, "start of the path; received until it began"),
    _of_twin("effector_poses/<effector>", IN, NEWEST, "the same for a path with orientations"),
    _of_twin("target/<effector>", OUT, NEWEST, "present point of the path"),
    _of_twin("target_pose/<effector>", OUT, NEWEST,
             "in place of it, along a path with orientations"),
    _of_twin("target_path/<effector>", OUT, NEWEST, "in place of both, with `target_ahead`"),
    _of_twin("target_stiffness/<effector>", OUT, NEWEST,
             "wanted stiffness, NaN along the other axes; with `target_stiffness`"),
    _of_twin("command/cables", OUT, NEWEST,
             "setpoint of `target_actuator`, or those of `target_commands` or `target_beginning`"),
    _of_twin("command/pose/<guided body>", OUT, NEWEST,
             "pose of a guided body, of `target_commands` or `target_beginning`"),
)  # fmt: skip
"""Topics of the target, by name."""

_CHANNELS = _by_name(*map(channel_topic, registered()), *map(measured_topic, measured()))
NODES = {"twin": TWIN_TOPICS | _CHANNELS, "device": DEVICE_TOPICS, "target": TARGET_TOPICS}
"""Topics by name of each node."""
