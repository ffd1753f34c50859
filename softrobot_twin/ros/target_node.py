"""Node that publishes targets along a path, and setpoints of an actuator meanwhile."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.control.target_path import (
    ClosedCurve,
    RampedIn,
    ToAndFro,
    has_orientations,
    make_sequence,
)
from softrobot_twin.ros.messages import point_message, pose_message, read_pose, stamp_of
from softrobot_twin.ros.parameters import TARGET, declare
from softrobot_twin.ros.scene_file import find_scene_file
from softrobot_twin.ros.ticking_node import TickingNode

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
_WAIT_WARNING = 5.0


class TargetNode(TickingNode):
    """Publishes targets of one effector along a path, starting smoothly at its present position,
    and commands an actuator, such as that of a hand, to and fro.

    Along a path with orientations it publishes poses, and starts at the effector's present one.

    Args:
        arguments: What `rclpy.node.Node` takes besides a name.

    Raises:
        SoftRobotTwinError: A parameter or a path file cannot be used.
    """

    def __init__(self, **arguments):
        super().__init__("target", **arguments)

    def build(self) -> None:
        """Builds the node; see `TickingNode.build`."""
        values = declare(self, TARGET)
        self.warn_about_unknown_parameters()
        effector = str(values["target_effector"])
        self._ramp_time = values["target_ramp_time"]
        around = ClosedCurve(
            values["target_center"], values["target_radius"], values["target_period"],
            values["target_plane"],
        )
        names = [name for name in values["target_sequence"] if name] or [values["target_path"]]
        found = [
            str(find_scene_file(name, "target_path")) if name.endswith(".csv") else name
            for name in names
        ]
        self._path = make_sequence(
            found, effector, around, values["target_sequence_time"], self._ramp_time
        )
        self._frame = str(values["frame_id"])
        self._ramped: RampedIn | None = None
        self._turn = np.array([0.0, 0.0, 0.0, 1.0])
        self._began = 0.0
        twin = str(values["twin"]).rstrip("/")
        self.start(1.0 / values["target_rate"])
        self._turns = has_orientations(self._path)
        kind = PoseStamped if self._turns else PointStamped
        topic = "target_pose" if self._turns else "target"
        self._targets = self.create_publisher(kind, f"{twin}/{topic}/{effector}", NEWEST)
        self._actuator, self._commands = str(values["target_actuator"]), None
        published = [self._targets]
        if self._actuator:
            self._setpoints = ToAndFro(
                tuple(values["target_setpoints"]), values["target_setpoint_period"]
            )
            self._commands = self.create_publisher(JointState, f"{twin}/command/cables", NEWEST)
            published.append(self._commands)
        self.watch_topics((), tuple(published))
        self._topic = f"{twin}/{'effector_poses' if self._turns else 'effectors'}/{effector}"
        take = self._take_start_pose if self._turns else self._take_start
        self._listener = self.create_subscription(kind, self._topic, take, NEWEST)
        self.get_logger().info(f"ready: {effector} along {', '.join(names)}")

    def _take_start(self, message: PointStamped) -> None:
        """Takes the start point from the effector's first position; ignores later messages."""
        start = np.array([message.point.x, message.point.y, message.point.z])
        if self._ramped is not None or not np.isfinite(start).all():
            return
        self._ramped = RampedIn(start, self._path, self._ramp_time)
        self._began = self.monotonic()

    def _take_start_pose(self, message: PoseStamped) -> None:
        """Takes the start from the effector's first pose; ignores later messages."""
        position, quaternion = (np.array(part) for part in read_pose(message))
        finite = np.isfinite(position).all() and np.isfinite(quaternion).all()
        if self._ramped is not None or not finite or not np.abs(quaternion).max() > 0.0:
            return
        # Scaled first: the square of a very large component would overflow.
        turn = quaternion / np.abs(quaternion).max()
        self._ramped = RampedIn(position, self._path, self._ramp_time, turn)
        self._turn = turn / np.linalg.norm(turn)
        self._began = self.monotonic()

    def work(self, now: float) -> None:
        """Publishes the present target."""
        if self._ramped is None:
            self.get_logger().info(
                f"waiting for {self._topic}", throttle_duration_sec=_WAIT_WARNING
            )
            return
        if self._listener is not None:
            self.destroy_subscription(self._listener)
            self._listener = None
        stamp = stamp_of(self.get_clock().now().nanoseconds)
        header, since = Header(stamp=stamp, frame_id=self._frame), now - self._began
        if self._commands is not None:
            self._commands.publish(JointState(
                header=header, name=[self._actuator], position=[self._setpoints.value(since)]
            ))  # fmt: skip
        position = self._ramped.position(since)
        if not self._turns:
            self._targets.publish(point_message(position, header))
            return
        turn = self._ramped.orientation(since)
        # A path of the sequence without orientations keeps the last one.
        self._turn = self._turn if turn is None else turn
        self._targets.publish(pose_message(position, self._turn, header))
