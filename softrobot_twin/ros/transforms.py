"""Transforms of rigid bodies, effectors and the base, for ``/tf``.

The package tf2_msgs is part of a ROS installation, and not of the wheels of rclpy: there
`tools/build_tf2_msgs.sh` builds it. Where it is missing, nothing is published.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from rclpy.node import Node
from std_msgs.msg import Header

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.audience import Audience
from softrobot_twin.ros.messages import coordinates
from softrobot_twin.ros.topics import TWIN_TOPICS
from softrobot_twin.simulation import Simulation

_UNTURNED = (0.0, 0.0, 0.0, 1.0)
OF_EFFECTOR = "_effector"
"""Added to the name of an effector that has the name of a rigid body."""


def child_frames(
    frame_id: str, prefix: str, bodies: Sequence[str], effectors: Sequence[str]
) -> tuple[str, ...]:
    """Names of the frames of rigid bodies, then of effectors.

    Args:
        frame_id: The frame in which they are.
        prefix: Put before each name, such as ``left/``.
        bodies: Names of the rigid bodies.
        effectors: Names of the effectors.

    Raises:
        ParameterError: A frame would be its own parent, or two frames have the same name.
    """
    own = [name + OF_EFFECTOR if name in bodies else name for name in effectors]
    frames = tuple(f"{prefix}{name}" for name in (*bodies, *own))
    if frame_id in frames:
        raise ParameterError("frame_id", frame_id, "", "is the name of a body's or an effector's "
                             "frame too: give a tf_prefix, or tf: off")  # fmt: skip
    if len(set(frames)) != len(frames):
        double = next(frame for frame in frames if frames.count(frame) > 1)
        raise ParameterError("tf_prefix", prefix, "", f"two frames would be called {double}")
    return frames


def make_transforms(
    header: Header, frames: Sequence[str], positions: np.ndarray, quaternions: np.ndarray
) -> list[TransformStamped]:
    """Transforms from one frame to others; one that is not finite is left out.

    Args:
        header: The frame and the time.
        frames: Names of the other frames.
        positions: Their origins [m], shape (frame_count, 3).
        quaternions: Their rotations (x, y, z, w), shape (frame_count, 4); NaN for none.
    """
    transforms = []
    for frame, position, turn in zip(frames, positions.tolist(), quaternions.tolist(), strict=True):
        if not np.isfinite(position).all():
            continue
        turn = turn if np.isfinite(turn).all() else _UNTURNED
        transforms.append(TransformStamped(header=header, child_frame_id=frame, transform=Transform(
            translation=coordinates(Vector3, position), rotation=coordinates(Quaternion, turn))))
    return transforms


class BaseFollower:
    """Passes transforms of one frame on, as poses of a moving base.

    Args:
        node: The twin.
        frame: Name of the frame in `/tf`.
        take: Takes position [m], quaternion (x, y, z, w), and the header.

    Raises:
        ParameterError: tf2_msgs is missing.
    """

    def __init__(self, node: Node, frame: str, take: Callable[[np.ndarray, np.ndarray, Header], object]):
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise ParameterError("base_frame", frame, "", "needs tf2_msgs, which is not installed: "
                                 "send ~/base_pose") from None  # fmt: skip
        self._frame, self._take = frame, take
        self.subscription = node.create_subscription(TFMessage, "/tf", self.receive, 100)

    def receive(self, message) -> None:
        """Takes the transforms of the frame out of a message.

        Args:
            message: A TFMessage.
        """
        for one in message.transforms:
            if one.child_frame_id == self._frame:
                place, turn = one.transform.translation, one.transform.rotation
                self._take(np.array([place.x, place.y, place.z]),
                           np.array([turn.x, turn.y, turn.z, turn.w]), one.header)  # fmt: skip


class TransformOutput:
    """Publishes transforms on ``/tf``, only while somebody receives them.

    Args:
        node: The twin.
        simulation: Its model.
        parameters: Values of ``frame_id``, ``tf``, ``tf_prefix``, ``tf_base_frame`` and
            ``tf_base_pose``.
        audience: Who receives what.

    Raises:
        ParameterError: The names of the frames clash, or the pose is none.
    """

    def __init__(self, node: Node, simulation: Simulation, parameters: Mapping[str, Any], audience: Audience):
        self._simulation, self._audience, self.publisher = simulation, audience, None
        frame_id, wanted, base_frame = (
            str(parameters[name]) for name in ("frame_id", "tf", "tf_base_frame"))
        if wanted == "off":
            return
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            if wanted == "on":
                node.get_logger().warning("tf: tf2_msgs is not installed: /tf is not published")
            return
        self._frames = child_frames(frame_id, str(parameters["tf_prefix"]), simulation.rigid_names,
                                    simulation.effector_names)  # fmt: skip
        self._base_frame, self._base = base_frame, _checked_pose(parameters["tf_base_pose"])
        if base_frame and base_frame in (frame_id, *self._frames):
            raise ParameterError("tf_base_frame", base_frame, "", "is the frame itself, or one "
                                 "below it")  # fmt: skip
        if not self._frames and not base_frame:
            return
        self._kind, topic = TFMessage, TWIN_TOPICS["/tf"]
        self.publisher = node.create_publisher(TFMessage, topic.name, topic.quality)

    def publish(self, outcome: TickOutcome, make_header: Callable[[], Header]) -> bool:
        """Publishes a tick to those who listen; false where nobody does.

        Args:
            outcome: What the tick told.
            make_header: Gives the header of the tick's messages.
        """
        if self.publisher is None or not self._audience.hears(self.publisher):
            return False
        header = make_header()
        positions, turns = self._simulation.rigid_poses()
        ends = outcome.result.effector_positions
        end_turns = outcome.result.effector_orientations
        end_turns = np.full((len(ends), 4), np.nan) if end_turns is None else end_turns
        transforms = make_transforms(
            header, self._frames, np.vstack([positions, ends]), np.vstack([turns, end_turns])
        )
        if self._base_frame:
            above = Header(stamp=header.stamp, frame_id=self._base_frame)
            transforms += make_transforms(
                above, [header.frame_id], self._base[None, :3], self._base[None, 3:]
            )
        self.publisher.publish(self._kind(transforms=transforms))
        return True


def _checked_pose(pose: Sequence[float]) -> np.ndarray:
    """A pose of seven numbers with a unit quaternion.

    Raises:
        ParameterError: It has another length, is not finite, or its quaternion is zero.
    """
    numbers = np.array(pose, float)
    size = np.linalg.norm(numbers[3:])
    if len(numbers) != 7 or not np.isfinite(numbers).all() or not abs(size - 1.0) < 0.01:
        raise ParameterError("tf_base_pose", tuple(pose), "m", "must be a position and a "
                             "quaternion (x, y, z, w) of unit length: seven numbers")  # fmt: skip
    numbers[3:] /= size
    return numbers
