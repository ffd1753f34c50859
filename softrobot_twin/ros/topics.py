"""The topics and services of the three nodes: each is declared once, with its type, its quality of
service, its unit and its meaning.

The nodes open topics by these tables only; ``docs/topics.md`` and ``--help`` are made from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import Enum
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

from softrobot_twin.simulation.channels import Channel

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

    @property
    def quality_in_words(self) -> str:
        """Its quality of service, such as ``reliable, newest 1``."""
        return quality_in_words(self.quality)

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
    if topic.direction is not OUT:
        raise ValueError(f"{topic.name} is declared as a topic that the node receives")
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
    if topic.direction is not IN:
        raise ValueError(f"{topic.name} is declared as a topic that the node publishes")
    return node.create_subscription(
        topic.kind, topic.full_name(name, twin), receive, topic.quality, raw=True
    )


def _by_name(*topics: Topic) -> dict[str, Topic]:
    return {topic.name: topic for topic in topics}


TWIN_TOPICS = _by_name(
    Topic("~/target/<effector>", IN, PointStamped, NEWEST, "m",
          "the newest is used, limited to the workspace; messages that are not finite, stale, out "
          "of order or in another frame are refused and counted", "targets.accept_point"),
    Topic("~/target_pose/<effector>", IN, PoseStamped, NEWEST, "m",
          "of effectors with `orientation`: position, and turn from the rest shape; as "
          "`~/target/<effector>`, and quaternions that are not of unit length within 1 % are "
          "refused. A point or a velocity that follows moves the position, and the orientation "
          "stays wanted; with `directions: []` the position is checked, and not used",
          "targets.accept_pose"),
    Topic("~/target_path/<effector>", IN, Path, NEWEST, "m",
          "of scenes with `control`: where the target will be at the stamp of each pose, straight in "
          "between; turns are not used. It replaces what is left of an earlier path, and a point, pose "
          "or velocity replaces it. Refused as `~/target/<effector>`, and where stamps do not increase",
          "targets.accept_path"),
    Topic("~/target_stiffness/<effector>", IN, Vector3Stamped, NEWEST, "N/m",
          "along x, y and z of the world, NaN where it is free; of effectors with `stiffness`, in "
          "place of its `target` until `~/reset` or `~/enable`; stale, out of order, infinite, in "
          "another frame, or not above 0 is refused and counted. One alone, without a target "
          "position, is followed too", "stiffness.accept"),
    Topic("~/target_velocity", IN, Twist, NEWEST, "m/s, rad/s",
          "integrated, limited in speed, stopped after `velocity_timeout`, limited to the "
          "workspace; its angular part turns an effector with `orientation`, whose length for a "
          "radian says how fast", "targets.accept_velocity"),
    Topic("~/touch_force/<touch>", IN, WrenchStamped, STREAM, "N",
          "force on the robot; torques are not used. Zero or NaN ends the touch. Refused: "
          "infinite, above `force_limit`, stale, out of order, in another frame",
          "touches.accept_force"),
    Topic("~/touch_position/<touch>", IN, PointStamped, STREAM, "m",
          "place of the touched point: it is held there. NaN ends the touch. Refused: infinite, "
          "far from the robot, stale, out of order, in another frame", "touches.accept_place"),
    Topic("~/markers", IN, PointCloud2, STREAM, "m",
          "x y z float32, id uint32; NaN = hidden; implausible markers are left out and reported",
          "markers.accept"),
    Topic("~/measured_cables", IN, JointState, STREAM, "m, N",
          "what the hardware measures, cavities as in `~/cables`; setpoints that no actuator of "
          "the scene can have are refused; cavities with `control: pressure` and cables with "
          "pulleys may be omitted", "device.accept"),
    Topic("~/measured_angles", IN, JointState, STREAM, "rad, N m",
          "angle in `position`, torque in `effort` (optional); of pulleys, by the names of their "
          "cables or motors, any of them; in place of lengths in `~/measured_cables` or in "
          "addition, the newest counts. Checked like these", "measured_angles.accept"),
    Topic("~/measured_pressures/<cavity>", IN, FluidPressure, STREAM, "Pa, absolute",
          "measured pressure, of a cavity with `control: pressure` in place of a value in "
          "`~/measured_cables` or in addition; `frame_id` names the sensor and is not checked, "
          "`variance` is not used", "measured_pressures.accept"),
    Topic("~/command/cables", IN, JointState, NEWEST, "m, N",
          "m in `position`, or N in `effort`, of motors of hinges rad or N m; `mode: direct`. "
          "Names are cables, slides or motors, and each cable is named once; a motor's position is "
          "the length of its first cable [m], and its other cables are shortened by the same "
          "length; its effort is the tension of each cable. Of a cavity `position` is the gauge "
          "pressure [Pa] or, with `control: volume`, the volume [m³], and `effort` the gauge "
          "pressure [Pa]; a cavity with `control: pressure` may be omitted and stays as it is. In "
          "`mode: inverse` the message commands some actuators by length, pressure or volume, and "
          "the others are optimised; an empty message commands none", "commands.accept"),
    Topic("~/command/angles", IN, JointState, NEWEST, "rad",
          "in `position`; of any pulleys, by the names of their cables or motors. The other "
          "actuators stay as they are: in `mode: direct` at their setpoints, in `mode: inverse` "
          "optimised or commanded as before; there the cables stay commanded until a message on "
          "`~/command/cables` names them or is empty. Torques are refused. Only in scenes with "
          "pulleys", "angles.accept"),
    Topic("~/command/pressures/<cavity>", IN, FluidPressure, NEWEST, "Pa, absolute",
          "above 0; commands this cavity, and the other actuators stay as they are: in `mode: "
          "direct` at their setpoints, in `mode: inverse` optimised or commanded as before. There "
          "the cavity stays commanded until a message on `~/command/cables` names it or is empty. "
          "Checked like targets, but the frame may be empty. Refused for `control: volume`, whose "
          "volume is commanded on `~/command/cables`", "pressures.accept"),
    Topic("~/command/pose/<guided body>", IN, PoseStamped, NEWEST, "m",
          "frame, finiteness, rotation and age are checked, the scene limits speed and turn rate, "
          "the newest is used, limited to the workspace", "poses.accept"),
    Topic("~/cables", OUT, JointState, NEWEST, "m, N",
          "`position` = length [m], `effort` = tension [N]; of a slide its position and the force "
          "that holds it; of a motor of a hinge its angle [rad] and torque [N m]; of a cavity its "
          "gauge pressure [Pa] in both, or with `control: volume` its volume [m³] and gauge "
          "pressure [Pa]"),
    Topic("~/cable_paths", OUT, JointState, NEWEST, "m",
          "`position` = length of each cable's path through the body [m], which is shorter than its "
          "length in `~/cables`, that of its winch, where the cable is slack; only in scenes with "
          "cables, and while somebody receives it"),
    Topic("~/cables/claim", OUT, String, CLAIM, "",
          "five times a second: that this twin lives, and whether it is enabled; below the name to "
          "which `~/cables` is remapped. Twins on the same topic hear each other by it: the later "
          "one is silent and says whose topics these are, and one that crashed blocks nothing"),
    Topic("~/angles", OUT, JointState, NEWEST, "rad, N m",
          "`position` = angle [rad], `effort` = torque that holds the cables [N m], about the axis "
          "in the positive sense; of each pulley, by the name of its cable or motor, with the same "
          "stamp as `~/cables`; only in scenes with pulleys"),
    Topic("~/pressures/<cavity>", OUT, FluidPressure, NEWEST, "Pa, absolute",
          "gauge plus `ambient_pressure`; commanded or, with `control: volume`, predicted "
          "pressure, with the same stamp as `~/cables`; of a sealed cavity its predicted pressure; "
          "`variance` 0 (unknown)"),
    Topic("~/effectors/<effector>", OUT, PointStamped, NEWEST, "m", "predicted position"),
    Topic("~/effector_poses/<effector>", OUT, PoseStamped, NEWEST, "m",
          "of effectors with `orientation`: predicted position, and turn from the rest shape"),
    Topic("~/stiffness/<effector>", OUT, Vector3Stamped, NEWEST, "N/m",
          "of effectors with `stiffness`, in ticks that follow one: the stiffness shown, NaN along "
          "axes where none is wanted; of the new shape, to first order"),
    Topic("~/touch/<touch>", OUT, JointState, NEWEST, "m, N",
          "names x, y, z: `position` = displacement of the point since the touch began [m], "
          "`effort` = force on the robot [N]; zero without a touch"),
    Topic("~/figures", OUT, JointState, NEWEST, "as the names say",
          "what optional effects report, `position` = their values; only in scenes with effects "
          "that report something"),
    Topic("~/compliance/<effector>", OUT, Float64MultiArray, NEWEST, "m/N",
          "3×3: motion of the effector by a force on it (columns x, y, z) while the actuators hold "
          "what they hold; computed only while somebody receives it"),
    Topic("~/jacobian/<effector>", OUT, Float64MultiArray, NEWEST, "m per unit of the actuator",
          "3 × actuators, in the order of `~/cables`: motion [m] of the effector by each actuator, "
          "the others held. The label of the second dimension names each column with its unit, "
          "such as `north_shortening_m` (m/m), `air_pressure_Pa` (m/Pa); by a shortening, not by "
          "the length, which has the other sign. Computed only while somebody receives it"),
    Topic("~/external_forces/<force>", OUT, WrenchStamped, NEWEST, "N, N m",
          "force on the robot that the scene's `observer` found, zero without one; a torque only on "
          "a rigid body. Deviations are on the topic below and in `/diagnostics`"),
    Topic("~/force_deviations/<force>", OUT, JointState, NEWEST, "N, m",
          "names x, y, z: `position` = place of that force [m], `effort` = its standard deviation "
          "[N]"),
    Topic("~/external_contacts", OUT, JointState, NEWEST, "1",
          "names of the scene's observed forces: `position` = 1 where the force is larger than noise "
          "makes it, else 0"),
    Topic("~/predicted_markers", OUT, PointCloud2, NEWEST, "m",
          "markers of the model, as in `~/markers`; only while somebody receives it"),
    Topic("~/bodies/<rigid body>", OUT, PoseStamped, NEWEST, "m",
          "predicted pose; only while somebody receives it"),
    Topic("~/poses/<guided body>", OUT, PoseStamped, NEWEST, "m",
          "commanded pose of a guided body, for the device"),
    Topic("~/contacts", OUT, PointCloud2, STREAM, "m, N",
          "x y z fx fy fz float32: each contact, and its force on the first body of its pair; a "
          "pair's resultant and sum of magnitudes are in `/diagnostics`"),
    Topic("~/visualization", OUT, MarkerArray, NEWEST, "m",
          "for RViz and Foxglove, `visualization_rate` times a second and only while somebody "
          "receives it: the deformed surfaces, cables coloured by tension, motor axes, springs, "
          "tubes and fibres, cavities coloured by pressure, rigid bodies, obstacles, effectors, "
          "targets and touches, each kind in a namespace of its own; they vanish when the twin "
          "ends"),
    Topic("~/status", OUT, DiagnosticStatus, LATCHED, "",
          "when it changes: what the loop does (`disabled`, `resynchronising`, `returning`, "
          "`holding`, `following`, `commanded`) and why, the status of the step, the active "
          "limits; `level` as in `/diagnostics`"),
    Topic("/tf", OUT, "tf2_msgs/TFMessage", TRANSFORMS, "m",
          "from `frame_id` to each rigid body and effector (`tf_prefix` and its name; turned from "
          "rest where it has `orientation`), and from `tf_base_frame` to `frame_id` where that is "
          "given; with the stamp of `~/cables`; only while somebody receives it, and where "
          "tf2_msgs is installed"),
    Topic("/diagnostics", OUT, DiagnosticArray, DIAGNOSTICS, "",
          "1 Hz, and at once when the clock was set or another node or publisher of the same name "
          "appears: `<node>: loop`, `solver`, `limits`, `markers`, `device`, `target`, `view`, "
          "`graph`, `record` with that parameter, and `contact`, `touch` and `observer` where a scene has "
          "them; `<node>` is the full name without its first slash"),
)  # fmt: skip
"""Topics of the twin, by name."""


def _of_twin(name: str, direction: Direction, quality: QoSProfile, meaning: str) -> Topic:
    """The other end of a topic of a twin, for another node."""
    twin = TWIN_TOPICS[f"~/{name}"]
    return Topic(f"<twin>/{name}", direction, twin.kind, quality, twin.unit, meaning)


def channel_topic(channel: Channel) -> Topic:
    """The topic by which the twin publishes a channel that was added from outside.

    Args:
        channel: The channel.
    """
    return Topic(f"~/{channel.name}/<object>", OUT, JointState, NEWEST, channel.unit,
                 f"names {', '.join(channel.parts)}, `position` = their values")


def measured_topic(channel: Channel) -> Topic:
    """The topic by which the twin takes measured numbers of such a channel.

    Args:
        channel: The channel.
    """
    name = channel.measured_name
    return Topic(f"~/{name}/<{channel.name}>", IN, JointState, STREAM, channel.unit,
                 f"as `~/{channel.name}/<object>`; larger than {channel.most:g} is refused",
                 f"{name}.accept")  # fmt: skip


TWIN_SERVICES = (
    Service("~/enable", SetBool,
            "starts disabled with `use_device`; starts from the measured setpoints, or answers why "
            "it cannot; refused while two nodes have the same name or publish on the same topic"),
    Service("~/reset", Trigger,
            "back to the rest shape, within the rate limits; with a device only the model returns, "
            "and the twin is disabled"),
    Service("~/calibrate", Trigger,
            "fits numbers of the scene, `calibrate_fit`, to the poses at which the robot rested since the "
            "start, in a process of its own. The answer comes at once: how many poses there are and which "
            "file gets the proposal, or why there is no fit. The result is told in `calibration` of "
            "`/diagnostics` and in the log. The twin stays as it is until it is started with the proposal"),
)  # fmt: skip
"""Services of the twin."""

DEVICE_TOPICS = _by_name(
    _of_twin("cables", IN, LAST_FEW,
             "setpoints to which the robot moves, as the twin publishes them"),
    _of_twin("poses/<guided body>", IN, LAST_FEW, "pose to which a guided body moves"),
    _of_twin("measured_cables", OUT, NEWEST,
             "measured lengths and tensions, cavities as in the twin's `~/cables`"),
    _of_twin("measured_angles", OUT, NEWEST,
             "measured angles and torques of pulleys; only in scenes with pulleys"),
    _of_twin("measured_pressures/<cavity>", OUT, NEWEST,
             "measured pressure; `variance` [Pa²] as the sensor has it"),
    _of_twin("markers", OUT, NEWEST, "measured markers: x y z float32, id uint32; NaN = hidden"),
    _of_twin("touch_position/<touch>", OUT, NEWEST, "with `device_touch` and `device_touch_sends: "
             "position`: the touched point, NaN without a touch"),
    _of_twin("touch_force/<touch>", OUT, NEWEST, "with `device_touch` and `device_touch_sends: "
             "force`: the force on the robot, zero without a touch"),
    Topic("~/touch/<touch>", OUT, JointState, NEWEST, "m, N",
          "what the fingertip measures, as the twin's `~/touch/<touch>`; with `device_touch`"),
    Topic("~/effectors/<effector>", OUT, PointStamped, NEWEST, "m",
          "true position, for evaluation only"),
    Topic("~/bodies/<rigid body>", OUT, PoseStamped, NEWEST, "m",
          "true pose, for evaluation only"),
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
             "setpoint of `target_actuator`; with `target_commands` or `target_beginning` those of all "
             "actuators"),
    _of_twin("command/pose/<guided body>", OUT, NEWEST,
             "pose of a guided body; with `target_commands` or `target_beginning` that has columns of "
             "it"),
)  # fmt: skip
"""Topics of the target, by name."""

NODES = {"twin": TWIN_TOPICS, "device": DEVICE_TOPICS, "target": TARGET_TOPICS}
"""Topics by name of each node."""
