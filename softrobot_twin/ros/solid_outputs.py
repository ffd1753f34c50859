"""What the twin publishes of rigid bodies and contacts; nothing where a scene has none."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.ros.messages import contacts_message, pose_message
from softrobot_twin.simulation import Simulation

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class SolidOutputs:
    """Publishes where rigid bodies are, where guided ones are sent, and what touches.

    Args:
        node: The twin.
        simulation: Its model.

    Attributes:
        commands: Publishers of where guided bodies are sent.
    """

    def __init__(self, node: Node, simulation: Simulation):
        self._simulation = simulation
        self._bodies = [
            node.create_publisher(PoseStamped, f"~/bodies/{name}", NEWEST)
            for name in simulation.rigid_names
        ]
        self._sent = {
            name: node.create_publisher(PoseStamped, f"~/poses/{name}", NEWEST)
            for name in simulation.guided_names
        }
        self.commands = tuple(self._sent.values())
        self._contacts = None
        if simulation.scene.contact is not None:
            self._contacts = node.create_publisher(PointCloud2, "~/contacts", STREAM)

    def publish(self, outcome: TickOutcome, header: Header) -> None:
        """Publishes a tick; where guided bodies are sent only when cables are commanded too."""
        if self._bodies:
            poses = zip(*self._simulation.rigid_poses(), strict=True)
            for publisher, pose in zip(self._bodies, poses, strict=True):
                publisher.publish(pose_message(*pose, header))
        if outcome.command is not None:
            for name, pose in outcome.guided_poses.items():
                self._sent[name].publish(pose_message(*pose, header))
        contacts = outcome.result.contacts
        if self._contacts is not None and contacts is not None:
            message = contacts_message(contacts.positions, contacts.forces, header)
            self._contacts.publish(message)
