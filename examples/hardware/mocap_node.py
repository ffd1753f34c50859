"""Markers of a motion capture system for a twin: other units, another frame, other ids.

    python mocap_node.py --ros-args -p mocap_topic:=/mocap/poses -p mocap_type:=PoseArray \\
        -p mocap_unit:=mm -p mocap_frame:=world -p mocap_ids:="[4, 5, 6, 7]" \\
        -p mocap_pose:="[0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]"

It publishes ``<twin>/markers``. `fit_frame` finds the pose of the robot in the tracker's frame from
markers that both know, such as those of the robot at rest.
"""

from __future__ import annotations

import sys

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from softrobot_twin.control.arrival import Refusal, RefusalCounts
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.messages import markers_message, read_markers, stamp_of
from softrobot_twin.ros.node_help import help_text
from softrobot_twin.ros.parameters import Entry, declare
from softrobot_twin.ros.process import run_node
from softrobot_twin.ros.ticking_node import TickingNode
from softrobot_twin.ros.topics import DEVICE_TOPICS, open_publisher

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
KINDS = {"PoseArray": PoseArray, "PoseStamped": PoseStamped, "PointCloud2": PointCloud2}
# Accepts reliable and best-effort publishers.
SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
MOST_MARKERS = 1000
FURTHEST = 1e6
"""A marker further than this from the tracker's origin is hidden, in the tracker's unit."""

PARAMETERS = (
    Entry("twin", "twin", "Name of the twin.", read_only=True),
    Entry("frame_id", "base_link", "Frame of the robot.", read_only=True),
    Entry("mocap_topic", "/mocap", "Topic of the tracker.", read_only=True),
    Entry("mocap_type", "PoseArray", "Type of its messages.", choices=tuple(KINDS),
          read_only=True),
    Entry("mocap_frame", "", "Frame that its messages must have; empty for any.", read_only=True),
    Entry("mocap_unit", "mm", "Unit of its positions.", choices=tuple(UNITS), read_only=True),
    Entry("mocap_ids", [-1], "Id in the scene of each of its markers, in the order of a PoseArray, "
          "one for PoseStamped; of a PointCloud2 pairs: id of the tracker, id of the scene. [-1]: "
          "as the tracker has them, or 0, 1, 2 and so on.", read_only=True),
    Entry("mocap_pose", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "Where frame_id is in the tracker's "
          "frame: position [m], and quaternion x, y, z, w.", read_only=True),
    Entry("mocap_hidden_is_zero", True, "A marker exactly at the tracker's origin is hidden.",
          read_only=True),
    Entry("mocap_stamp", "arrival", "Stamp of the markers: their arrival, or that of the tracker's "
          "message, whose clock must then be this machine's.", choices=("arrival", "message"),
          read_only=True),
)  # fmt: skip


class MocapFrame:
    """Converts positions of a tracker into the robot's frame.

    Args:
        unit: Unit of the tracker's positions.
        pose: Where the robot's frame is in the tracker's: position [m], quaternion x, y, z, w.

    Raises:
        ParameterError: The pose is none.
    """

    def __init__(self, unit: str, pose):
        numbers = np.array(pose, float)
        if numbers.shape != (7,) or not np.isfinite(numbers).all():
            raise ParameterError("mocap_pose", tuple(pose), "m", "must be seven finite numbers")
        size = float(np.linalg.norm(numbers[3:]))
        if not abs(size - 1.0) < 0.01:
            reason = f"its quaternion has the length {size:.3g}, must be 1"
            raise ParameterError("mocap_pose", tuple(pose), "", reason)
        self._scale, self._origin = UNITS[unit], numbers[:3]
        self._rotation = rotation_of(numbers[3:] / size)

    def to_robot(self, positions: np.ndarray) -> np.ndarray:
        """Positions in the robot's frame [m], shape (n, 3), of positions in the tracker's unit."""
        return (self._scale * positions - self._origin) @ self._rotation


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """Matrix of a unit quaternion (x, y, z, w), shape (3, 3)."""
    x, y, z, w = quaternion
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)


def fit_frame(tracked: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, float]:
    """Pose of the robot's frame in the tracker's, by least squares (Kabsch 1976).

    Args:
        tracked: Positions in the tracker's frame [m], shape (n, 3), n at least 3.
        known: The same points in the robot's frame, such as its markers at rest [m], same shape.

    Returns:
        The pose as `mocap_pose` takes it, and the root mean square of what remains [m].

    Raises:
        ValueError: The points are fewer than three, or on one line.
    """
    if len(tracked) < 3:
        raise ValueError(f"{len(tracked)} points; three are needed")
    middle, own = tracked.mean(axis=0), known.mean(axis=0)
    left, sizes, right = np.linalg.svd((known - own).T @ (tracked - middle))
    if sizes[1] < 1e-6 * sizes[0]:
        raise ValueError("the points are on one line")
    # A mirror image is no rotation.
    sign = np.sign(np.linalg.det(left @ right))
    rotation = (right.T * [1.0, 1.0, sign]) @ left.T
    origin = middle - rotation @ own
    rest = tracked - (known @ rotation.T + origin)
    return np.concatenate([origin, quaternion_of(rotation)]), float(
        np.sqrt((rest**2).sum(axis=1).mean())
    )


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion (x, y, z, w) of a rotation matrix: the eigenvector of its largest share."""
    r = rotation
    upper = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], 0.0, 0.0, 0.0],
        [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0.0, 0.0],
        [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0.0],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
    ])  # fmt: skip
    quaternion = np.linalg.eigh(upper)[1][:, -1]
    return quaternion if quaternion[3] >= 0.0 else -quaternion


class MocapNode(TickingNode):
    """Publishes the markers of a tracker for a twin.

    Attributes:
        refusals: Messages that were not used, by reason.

    Raises:
        ParameterError: A parameter cannot be used.
    """

    def __init__(self, **arguments):
        super().__init__("mocap", **arguments)

    def build(self) -> None:
        """Builds the node; see `TickingNode.build`."""
        values = declare(self, PARAMETERS)
        self.warn_about_unknown_parameters(PARAMETERS)
        self._values, self.refusals = values, RefusalCounts()
        self._frame = MocapFrame(str(values["mocap_unit"]), values["mocap_pose"])
        self._ids = self._checked_ids(str(values["mocap_type"]), values["mocap_ids"])
        self._came = 0
        twin = str(values["twin"]).rstrip("/")
        self._markers = open_publisher(self, DEVICE_TOPICS["<twin>/markers"], "", twin)
        self._warn = self.warner()
        kind = KINDS[str(values["mocap_type"])]
        self._tracker = self.create_subscription(
            kind, str(values["mocap_topic"]), self.receive, SENSOR
        )
        self.start(1.0)
        self.watch_topics((self._markers,), (self._tracker,))
        self.get_logger().info(f"ready: {self._tracker.topic_name}")

    @staticmethod
    def _checked_ids(kind: str, ids) -> tuple[int, ...] | dict[int, int] | None:
        """Ids by place or by the tracker's id; None for those of the tracker."""
        if tuple(ids) == (-1,):
            return None
        if min(ids) < 0 or max(ids) >= 2**32:
            raise ParameterError("mocap_ids", tuple(ids), "", "must be 0 to 4294967295")
        if kind == "PointCloud2" and len(ids) % 2:
            raise ParameterError("mocap_ids", tuple(ids), "", "must be pairs for a PointCloud2")
        if kind == "PoseStamped" and len(ids) != 1:
            raise ParameterError("mocap_ids", tuple(ids), "", "must be one for PoseStamped")
        own = ids[1::2] if kind == "PointCloud2" else ids
        if len(set(own)) != len(own):
            raise ParameterError("mocap_ids", tuple(ids), "", "an id is used twice")
        return dict(zip(ids[::2], own, strict=True)) if kind == "PointCloud2" else tuple(ids)

    def receive(self, message) -> None:
        """Publishes the markers of a message, or counts why it is refused."""
        found = self._convert(message)
        if isinstance(found, Refusal):
            self.refusals.add(found)
            self._warn(self._tracker.topic_name, found)
            return
        self._came += 1
        ids, positions = found
        stamp = message.header.stamp
        if self._values["mocap_stamp"] == "arrival":
            stamp = stamp_of(self.get_clock().now().nanoseconds)
        header = Header(stamp=stamp, frame_id=str(self._values["frame_id"]))
        self._markers.publish(markers_message(ids, positions, header))

    def _convert(self, message) -> tuple[np.ndarray, np.ndarray] | Refusal:
        """Ids and positions in the robot's frame [m], NaN where hidden; or why not."""
        frame = str(self._values["mocap_frame"])
        if frame and message.header.frame_id != frame:
            return Refusal.WRONG_FRAME
        raw = self._read(message)
        if isinstance(raw, Refusal):
            return raw
        ids, positions = raw
        positions = np.where(np.isfinite(positions).all(axis=1)[:, None], positions, np.nan)
        if self._values["mocap_hidden_is_zero"]:
            positions[(positions == 0.0).all(axis=1)] = np.nan
        # What is further away cannot be a marker.
        positions[(np.abs(positions) > FURTHEST).any(axis=1)] = np.nan
        return ids, self._frame.to_robot(positions)

    def _read(self, message) -> tuple[np.ndarray, np.ndarray] | Refusal:
        """Ids in the scene and positions as the tracker has them."""
        if isinstance(message, PointCloud2):
            return self._of_cloud(message)
        poses = [message.pose] if isinstance(message, PoseStamped) else message.poses
        if len(poses) > MOST_MARKERS or (self._ids is not None and len(poses) != len(self._ids)):
            return Refusal.WRONG_SIZE
        places = [(pose.position.x, pose.position.y, pose.position.z) for pose in poses]
        ids = range(len(poses)) if self._ids is None else self._ids
        return np.array(ids, np.uint32), np.array(places, float).reshape(-1, 3)

    def _of_cloud(self, message: PointCloud2) -> tuple[np.ndarray, np.ndarray] | Refusal:
        found = read_markers(message)
        if isinstance(found, Refusal) or self._ids is None:
            return found
        ids, positions = found
        known = np.array([one in self._ids for one in ids.tolist()], bool)
        own = [self._ids[one] for one in ids[known].tolist()]
        return np.array(own, np.uint32), positions[known]

    def work(self, now: float) -> None:
        """Tells once a while when nothing comes."""
        if not self._came:
            self.get_logger().warning(f"no markers on {self._tracker.topic_name}",
                                      throttle_duration_sec=5.0)  # fmt: skip
        self._came = 0


if __name__ == "__main__":
    sys.exit(run_node("mocap_node.py", lambda: MocapNode,
                      about=lambda: help_text("mocap_node.py", [__doc__], PARAMETERS)))  # fmt: skip
