"""Transforms of rigid bodies, effectors and the base, for ``/tf``.

The package tf2_msgs is part of a ROS installation, and not of the wheels of rclpy: there
`tools/build_tf2_msgs.sh` builds it. Where it is missing, nothing is published.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.audience import Audience
from softrobot_twin.ros.messages import coordinates, stamp_of
from softrobot_twin.ros.topics import ALL_LATCHED, TRANSFORMS, TWIN_TOPICS
from softrobot_twin.simulation import Simulation

_UNTURNED = (0.0, 0.0, 0.0, 1.0)
MOST_FRAMES, _KEPT = 1000, 32
"""Frames of others that are known at most, and how many transforms of each are kept."""
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


class _Link:
    """A frame below another one, and where it was there lately."""

    def __init__(self, parent: str):
        self.parent, self._past = parent, deque[tuple[int, Transform]](maxlen=_KEPT)

    @property
    def newest(self) -> int:
        """Time of the last transform [ns]."""
        return self._past[-1][0]

    def add(self, stamp: int, transform: Transform) -> None:
        """Keep a transform; one that is older than the last begins anew."""
        if self._past and stamp < self.newest:
            self._past.clear()
        self._past.append((stamp, transform))

    def at(self, stamp: int) -> tuple[np.ndarray, Rotation]:
        """Place [m] and rotation at a time [ns], between two transforms or at the nearest one.

        Raises:
            ValueError: A rotation is none.
        """
        after = next((one for one in self._past if one[0] >= stamp), self._past[-1])
        before = next((one for one in reversed(self._past) if one[0] <= stamp), after)
        (start, turned), (end, turn) = (_placed(one) for one in (before[1], after[1]))
        share = (stamp - before[0]) / (after[0] - before[0]) if before[0] < stamp < after[0] else 1.0
        way = Rotation.from_rotvec(share * (turned.inv() * turn).as_rotvec())
        return start + share * (end - start), turned * way


def _placed(transform: Transform) -> tuple[np.ndarray, Rotation]:
    """Place [m] and rotation of a transform."""
    place, turn = transform.translation, transform.rotation
    return np.array([place.x, place.y, place.z]), Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])


class BaseFollower:
    """Passes poses of one frame on, as those of a moving base, in the frame that none is above.

    They follow from a chain of transforms, at the last time of which all that move are known.

    Args:
        node: The twin.
        frame: Name of the frame in `/tf`.
        take: Takes position [m], quaternion (x, y, z, w), and the header.

    Attributes:
        links: The frames that are known, by name.

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
        self.links: dict[str, _Link] = {}
        # Frames of the chain, and the times and the frame above it that were passed on last.
        self._chain, self._told = {frame}, (-1, "")
        self._fixed: set[str] = set()
        self.subscriptions = [
            node.create_subscription(TFMessage, "/tf", self.receive, TRANSFORMS),
            node.create_subscription(TFMessage, "/tf_static", partial(self.receive, is_fixed=True), ALL_LATCHED)]

    def receive(self, message, is_fixed: bool = False) -> None:
        """Keeps transforms, and passes a pose on where a later one follows from them.

        Args:
            message: A TFMessage.
            is_fixed: Whether the transforms hold at all times.
        """
        is_of_chain = False
        for one in message.transforms:
            child, parent = one.child_frame_id, one.header.frame_id
            link = self.links.get(child)
            if link is None or link.parent != parent:
                if link is None and len(self.links) >= MOST_FRAMES and child not in self._chain:
                    continue
                link = self.links[child] = _Link(parent)
            (self._fixed.add if is_fixed else self._fixed.discard)(child)
            link.add(NANOSECONDS * one.header.stamp.sec + one.header.stamp.nanosec, one.transform)
            is_of_chain |= child in self._chain
        if is_of_chain:
            self._tell()

    def _tell(self) -> None:
        """Passes the pose of the frame on where it is known for a later time, or in another frame."""
        frame, chain = self._frame, list[str]()
        while frame in self.links and frame not in chain:
            chain.append(frame)
            frame = self.links[frame].parent
        self._chain = {self._frame, frame, *chain}
        if not chain or frame in chain:
            return  # Nothing is known, or only a circle.
        times = [self.links[one].newest for one in chain]
        stamp = min((time for time, one in zip(times, chain) if one not in self._fixed), default=max(times))
        if (stamp, frame) == self._told:
            return
        self._told = stamp, frame
        place, turn = np.zeros(3), Rotation.identity()
        try:
            for one in chain:
                at, turned = self.links[one].at(stamp)
                place, turn = at + turned.apply(place), turned * turn
            quaternion = turn.as_quat()
        except ValueError:
            quaternion = np.zeros(4)  # Which the input refuses, and counts.
        self._take(place, quaternion, Header(stamp=stamp_of(stamp), frame_id=frame))


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

    @property
    def is_heard(self) -> bool:
        """Whether somebody receives them."""
        return self.publisher is not None and self._audience.hears(self.publisher)

    def publish(self, outcome: TickOutcome, make_header: Callable[[], Header]) -> None:
        """Publishes a tick, where it is heard.

        Args:
            outcome: What the tick told.
            make_header: Gives the header of the tick's messages.
        """
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
