"""Node that publishes targets along a path, and setpoints of an actuator meanwhile; or plays a
table of commands, for robots that are driven directly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.publisher import Publisher
from std_msgs.msg import Header

from softrobot_twin.control.arrival import RefusalCounts
from softrobot_twin.control.target_path import (
    ClosedCurve,
    RampedIn,
    ToAndFro,
    has_orientations,
    make_sequence,
)
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.messages import (
    READERS,
    cables_message,
    path_message,
    point_message,
    pose_message,
    stamp_of,
    vector_message,
)
from softrobot_twin.ros.parameters import TARGET, declare
from softrobot_twin.ros.scene_file import find_scene, find_scene_file
from softrobot_twin.ros.ticking_node import TickingNode
from softrobot_twin.ros.topics import TARGET_TOPICS as TOPICS
from softrobot_twin.ros.topics import open_publisher
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.command import EFFORTS, HOLD
from softrobot_twin.tables.input_tables import CommandTable, between_rows, read_commands

_WAIT_WARNING = 5.0
_UNTURNED = np.array([0.0, 0.0, 0.0, 1.0])


class TargetNode(TickingNode):
    """Publishes targets of one effector along a path, starting smoothly at its present position,
    and commands an actuator, such as that of a hand, to and fro.

    Along a path with orientations it publishes poses, and starts at the effector's present one.

    With a table of commands it publishes these and no targets: setpoints or efforts of all
    actuators and poses of guided bodies, from the table's first row on, over again after the last.
    A table may also be played once before the path, such as to close a hand on what it then leads.

    Args:
        arguments: What `rclpy.node.Node` takes besides a name.

    Attributes:
        path: The path; only without a table of commands.
        began: When it, or the table before it, was begun, on the clock of the ticks [s]; infinite
            before.
        targets: Publisher of the targets; None with a table of commands.

    Raises:
        SoftRobotTwinError: A parameter or a path file cannot be used.
    """

    def __init__(self, **arguments):
        super().__init__("target", **arguments)

    def build(self) -> None:
        """Builds the node; see `TickingNode.build`."""
        values = declare(self, TARGET)
        self.warn_about_unknown_parameters()
        self._frame = str(values["frame_id"])
        self._effector = str(values["target_effector"])
        self._twin = str(values["twin"]).rstrip("/")
        self.targets = self._commands = self._ramped = self._table = self._stiffnesses = None
        self._turns = False
        self.began, self._beginning = math.inf, 0.0
        self._poses: dict[str, Publisher] = {}
        is_played = bool(values["target_commands"])
        what = self._open_table(values) if is_played else self._open_path(values)
        self.start(1.0 / values["target_rate"])
        published = (self.targets, self._commands, self._stiffnesses, *self._poses.values())
        self.watch_topics((), tuple(one for one in published if one is not None))
        group = "effector_poses" if self._turns else "effectors"
        topic = TOPICS[f"<twin>/{group}/<effector>"]
        self._topic = self.resolve_topic_name(topic.full_name(self._effector, self._twin))
        self._read_start = READERS[topic.kind]
        self._listener = self.listen(topic, self.take_start, RefusalCounts(), self._effector, self._twin)
        self.get_logger().info(f"ready: {what}")

    def _open_path(self, values: Mapping[str, object]) -> str:
        """Makes the path of the targets; returns what the node is ready for."""
        effector, self._ramp_time = self._effector, values["target_ramp_time"]
        around = ClosedCurve(
            *(values[f"target_{part}"] for part in ("center", "radius", "period", "plane")))
        names = [name for name in values["target_sequence"] if name] or [values["target_path"]]
        found = [str(find_scene_file(name, "target_path")) if name.endswith(".csv") else name
                 for name in names]  # fmt: skip
        self.path = make_sequence(found, effector, around, values["target_sequence_time"], self._ramp_time)
        self._turn = _UNTURNED
        self._turns = has_orientations(self.path)
        topic = "<twin>/target_pose/<effector>" if self._turns else "<twin>/target/<effector>"
        rate, self._ahead = values["target_rate"], np.empty(0)
        if values["target_ahead"]:
            self._ahead = np.arange(round(values["target_ahead"] * rate) + 1) / rate
            topic = "<twin>/target_path/<effector>"
        self.targets = open_publisher(self, TOPICS[topic], effector, self._twin)
        self._actuator = str(values["target_actuator"])
        if self._actuator:
            ends, period = tuple(values["target_setpoints"]), values["target_setpoint_period"]
            self._setpoints = ToAndFro(ends, period)
            self._open_commands()
        if any(values["target_stiffness"]):
            self._open_stiffness(values)
        what = f"{effector} along {', '.join(names)}"
        if values["target_beginning"]:
            what = f"{self._open_table(values, 'target_beginning')}, then {what}"
            self._beginning = float(np.ptp(self._table.times))
        return what

    def _open_commands(self) -> None:
        if self._commands is None:
            self._commands = open_publisher(self, TOPICS["<twin>/command/cables"], "", self._twin)

    def _open_stiffness(self, values: Mapping[str, object]) -> None:
        """Makes the profile of the wanted stiffness."""
        ends, names = tuple(values["target_stiffness"]), ("target_stiffness", "target_stiffness_period")
        self._stiffness = ToAndFro(ends, values["target_stiffness_period"], names)
        if min(ends) <= 0.0:
            raise ParameterError("target_stiffness", ends, "N/m", "must be above zero, or zeros")
        self._stiffness_axis = str(values["target_stiffness_axis"])
        topic = TOPICS["<twin>/target_stiffness/<effector>"]
        self._stiffnesses = open_publisher(self, topic, self._effector, self._twin)

    def _publish_stiffness(self, since: float, header: Header) -> None:
        """Publishes the wanted stiffness at a time since the path began [s]."""
        if self._stiffnesses is None:
            return
        value = self._stiffness.value(since)
        along = [value if axis == self._stiffness_axis else math.nan for axis in "xyz"]
        self._stiffnesses.publish(vector_message(along, header))

    def _open_table(self, values: Mapping[str, object], key: str = "target_commands") -> str:
        """Reads the table of commands that a parameter names; returns what the node is ready for."""
        scene = find_scene(values)
        file = find_scene_file(str(values[key]), key)
        # The table may give shortenings, so lengths at rest are needed.
        simulation = Simulation.from_scene_file(scene)
        self._table = read_commands(file, simulation)
        self._names = list(simulation.actuator_names)
        if self._table.kind != HOLD:
            self._open_commands()
        for name in self._table.poses:
            topic = TOPICS["<twin>/command/pose/<guided body>"]
            self._poses[name] = open_publisher(self, topic, name, self._twin)
        return f"the commands of {file}"

    def take_start(self, message: PointStamped | PoseStamped) -> None:
        """Takes the start from the effector's first position or pose, or from that after the table
        that is played before the path; ignores later messages.

        Args:
            message: Where the effector is.
        """
        start = [np.array(part) for part in self._read_start(message)]
        now = self.monotonic()
        is_begun = now - self.began >= self._beginning
        if is_begun or not all(np.isfinite(part).all() for part in start):
            return
        if self._turns:
            # Scaled first: the square of a very large component would overflow.
            largest = np.abs(start[1]).max()
            if not largest > 0.0:
                return
            start[1] /= largest
            self._turn = start[1] / np.linalg.norm(start[1])
        if self._table is None or self._beginning:
            position, *turn = start
            self._ramped = RampedIn(position, self.path, self._ramp_time, *turn)
        self.began = min(self.began, now)

    def work(self, now: float) -> None:
        """Publishes the present target, or the present commands.

        Args:
            now: Time on the monotonic clock [s].
        """
        if not self.began < math.inf:
            self.get_logger().info(f"waiting for {self._topic}", throttle_duration_sec=_WAIT_WARNING)
            return
        since = now - self.began - self._beginning
        header = Header(stamp=stamp_of(self.stamp), frame_id=self._frame)
        if since < 0.0:
            self._play(self._table, now - self.began, header)
            return
        if self._listener is not None:
            self.destroy_subscription(self._listener)
            self._listener = None
        if self._table is not None and not self._beginning:
            self._play(self._table, since, header)
            return
        if self._commands is not None:
            # Without a name all actuators are free to follow the targets, also those of the table.
            own = ([self._actuator], [self._setpoints.value(since)]) if self._actuator else ([], [])
            self._commands.publish(cables_message(*own, (), header))
        self._publish_stiffness(since, header)
        if len(self._ahead):
            places = [self._ramped.position(since + time) for time in self._ahead]
            self.targets.publish(path_message(self._ahead, np.array(places), header))
            return
        position = self._ramped.position(since)
        if not self._turns:
            self.targets.publish(point_message(position, header))
            return
        turn = self._ramped.orientation(since)
        # A path of the sequence without orientations keeps the last one.
        self._turn = self._turn if turn is None else turn
        self.targets.publish(pose_message(position, self._turn, header))

    def _play(self, table: CommandTable, since: float, header: Header) -> None:
        """Publishes the commands of a table at a time since it began [s]."""
        first, last = table.times[[0, -1]]
        time = float(first + since % (last - first))
        if self._commands is not None:
            values = between_rows(time, table.times, table.values)
            # Actuators without a column are not named: they hold.
            names = [name for name, value in zip(self._names, values) if not np.isnan(value)]
            values = values[~np.isnan(values)]
            both = ((), values) if table.kind == EFFORTS else (values, ())
            self._commands.publish(cables_message(names, *both, header))
        for name, publisher in self._poses.items():
            position, quaternion = table.poses[name].at(time)
            quaternion = _UNTURNED if quaternion is None else quaternion
            publisher.publish(pose_message(position, quaternion, header))
