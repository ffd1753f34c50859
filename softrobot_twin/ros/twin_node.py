"""Node of the twin: stores received messages, steps the loop at each tick, publishes the
results.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, Twist
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from softrobot_twin.control.arrival import Refusal, RefusalCounts
from softrobot_twin.control.command_gate import ActuatorCommand
from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.inputs import ActuatorInput
from softrobot_twin.control.last_command import LastCommand
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.mesh_error_watch import MeshErrorWatch
from softrobot_twin.control.reduction_error_watch import ReductionErrorWatch
from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.audience import Audience
from softrobot_twin.ros.claim import TopicClaim
from softrobot_twin.ros.diagnostics import TwinDiagnostics
from softrobot_twin.ros.message_bytes import JointStateBytes, to_bytes
from softrobot_twin.ros.messages import (
    contacts_message,
    markers_message,
    matrix_message,
    point_message,
    pose_message,
    pressure_message,
    read_force,
    read_joints,
    read_markers,
    read_measured,
    read_point,
    read_pose,
    read_pressure,
    read_vector,
    stamp_of,
    touch_message,
    vector_message,
)
from softrobot_twin.ros.parameters import TWIN, declare, loop_settings, plain
from softrobot_twin.ros.scene_file import find_scene_file
from softrobot_twin.ros.status import StatusOutput
from softrobot_twin.ros.thread_priority import Priority, ThreadPriority
from softrobot_twin.ros.ticking_node import TickingNode, publishing_nodes
from softrobot_twin.ros.topics import TWIN_TOPICS as TOPICS
from softrobot_twin.ros.topics import Topic, open_publisher, open_publishers
from softrobot_twin.ros.transforms import TransformOutput
from softrobot_twin.ros.view_feed import ViewFeed
from softrobot_twin.ros.visualization import VisualizationOutput
from softrobot_twin.scene.loading import load_scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.apparent_compliance import EffectorCompliance

if TYPE_CHECKING:
    from softrobot_twin.ros.run_recording import RunRecording


class RepeatedMessages:
    """Publishes messages with a header, and again with another stamp while nothing else changes.

    To make and convert a message takes longer than to publish its bytes. What nobody receives is not
    published again, and but for commands not even made.

    Args:
        audience: Who receives what.
    """

    _STAMP, _PLACE = struct.Struct("<iI"), 4
    """A stamp, and its place after the encapsulation of a message."""

    def __init__(self, audience: Audience) -> None:
        self._audience = audience
        self._sent: list[tuple[Publisher, object]] = []
        self._contents: list[tuple[Publisher, bytearray]] = []
        self._left_out: list[Publisher] = []

    def send(self, publisher: Publisher, message: object) -> None:
        """Publishes a message, serialized or not, whose first field is its header."""
        publisher.publish(message)
        self._sent.append((publisher, message))

    def offer(self, publisher: Publisher, make: Callable[..., object], *values: object) -> None:
        """Makes and publishes a message if somebody receives it."""
        if self._is_heard(publisher):
            self.send(publisher, make(*values))
        else:
            self._left_out.append(publisher)

    def _is_heard(self, publisher: Publisher) -> bool:
        """Whether messages are received or, as those of a recorded run, kept."""
        return type(publisher) is not Publisher or self._audience.hears(publisher)

    def forget(self) -> None:
        """The messages that are sent from now on are those to publish again."""
        self._sent, self._contents, self._left_out = [], [], []

    def send_again(self, stamp: int) -> bool:
        """Publishes all messages since `forget` again, with another stamp [ns].

        Returns:
            Whether it did: somebody may have subscribed to what was not made.
        """
        if self._audience.hears_any(self._left_out):
            return False
        if not self._contents:
            self._contents = [
                (publisher, bytearray(to_bytes(message))) for publisher, message in self._sent
            ]
        time = divmod(stamp, NANOSECONDS)
        for publisher, content in self._contents:
            if not self._is_heard(publisher):
                continue
            self._STAMP.pack_into(content, self._PLACE, *time)
            publisher.publish(bytes(content))
        return True


class SolidOutputs:
    """Publishes poses of rigid bodies, commanded poses of guided bodies, and contacts.

    Args:
        node: The twin.
        simulation: Its model.
        audience: Who receives what.

    Attributes:
        commands: Publishers of the commanded poses.
    """

    def __init__(self, node: Node, simulation: Simulation, audience: Audience):
        self._simulation, self._audience = simulation, audience
        bodies, guided = simulation.rigid_names, simulation.guided_names
        self._bodies = open_publishers(node, TOPICS["~/bodies/<rigid body>"], bodies)
        sent = open_publishers(node, TOPICS["~/poses/<guided body>"], guided)
        self._sent = dict(zip(guided, sent, strict=True))
        self.commands = tuple(self._sent.values())
        self._contacts = None
        if simulation.scene.contact is not None:
            self._contacts = open_publisher(node, TOPICS["~/contacts"])

    def publish(self, outcome: TickOutcome, header: Header) -> bool:
        """Publishes a tick; commanded poses are published only together with a cable command, and
        those of bodies only where they are received.

        Returns:
            Whether anything was published.
        """
        # An arm of hubs has many rigid bodies, and each message takes time of the tick.
        hears = self._audience.hears
        is_heard = self._audience.hears_any(self._bodies)
        if is_heard:
            poses = zip(*self._simulation.rigid_poses(), strict=True)
            for publisher, pose in zip(self._bodies, poses, strict=True):
                if hears(publisher):
                    publisher.publish(pose_message(*pose, header))
        if outcome.command is not None:
            for name, pose in outcome.guided_poses.items():
                self._sent[name].publish(pose_message(*pose, header))
        contacts = outcome.result.contacts
        if self._contacts is not None and contacts is not None:
            message = contacts_message(contacts.positions, contacts.forces, header)
            self._contacts.publish(message)
        return is_heard or bool(self._sent) or self._contacts is not None


class CablePathOutput:
    """Publishes the lengths of the paths of cables, which are computed only while somebody receives
    them.

    Args:
        node: The twin.
        simulation: Its model.
        audience: Who receives what.
    """

    def __init__(self, node: Node, simulation: Simulation, audience: Audience):
        self._actuators, self._audience = simulation.actuators, audience
        self._publisher = None
        if any(kind.one_sided for kind in self._actuators.kinds):
            self._publisher = open_publisher(node, TOPICS["~/cable_paths"])

    def publish(self, outcome: TickOutcome, header: Header) -> bool:
        """Publishes a tick if somebody listens; false where nobody does."""
        if self._publisher is None or not self._audience.hears(self._publisher):
            return False
        paths = self._actuators.path_lengths(outcome.result.state.positions)
        self._publisher.publish(
            JointState(header=header, name=list(paths), position=list(paths.values()))
        )
        return True


class ComplianceOutputs:
    """Publishes compliances and Jacobians of the effectors. Nothing is computed, nor memory
    allocated for it, until one of them is received.

    Args:
        node: The twin.
        loop: Its loop.
        audience: Who receives what.
    """

    _WORLD = ("x_m", "y_m", "z_m")
    _FORCES = ("fx_N", "fy_N", "fz_N")

    def __init__(self, node: Node, loop: TwinLoop, audience: Audience):
        self._loop, self._audience = loop, audience
        self._compliance: EffectorCompliance | None = None
        self._compliances, self._jacobians = (
            open_publishers(
                node, TOPICS[f"~/{topic}/<effector>"], loop.simulation.effector_names)
            for topic in ("compliance", "jacobian")
        )  # fmt: skip

    def publish(self, outcome: TickOutcome, header: Header) -> bool:
        """Publishes a tick to those who listen; false where nobody does."""
        if not self._audience.hears_any((*self._compliances, *self._jacobians)):
            return False
        loop = self._loop
        if self._compliance is None:
            self._compliance = EffectorCompliance(loop.simulation)
        found = self._compliance.after_step(loop.driven_by_efforts(outcome))
        self._send(self._compliances, found.compliance, self._FORCES, header)
        actuators = loop.simulation.actuators
        quantities = actuators.driven_quantities(found.is_by_effort)
        columns = [f"{name}_{quantity.word}_{quantity.unit}"
                   for name, quantity in zip(actuators.names, quantities, strict=True)]  # fmt: skip
        self._send(self._jacobians, found.jacobian, columns, header)
        return True

    def _send(self, publishers, matrices: np.ndarray, columns, header: Header) -> None:
        for publisher, matrix in zip(publishers, matrices, strict=True):
            if self._audience.hears(publisher):
                publisher.publish(matrix_message(matrix, self._WORLD, columns, header))


DIAGNOSTICS_PERIOD = 1.0
_WARN_EVERY = 2.0
_TABLE = {entry.name: entry for entry in TWIN}


class TwinNode(TickingNode):
    """Builds the simulation, warms it up, and runs its loop in the ticks.

    Args:
        arguments: What `rclpy.node.Node` takes besides a name.

    Attributes:
        loop: The loop.
        recording: Records the run; None without `record`.
        claim: Its claim of the topic of its commands.
        last_command: Keeps the last command over a restart; None with a device.
        feed: Feeds the view; None without one.
        window: The ticks since the last diagnostics.
        diagnostics: Writes them.
        status: Publishes the status.
        visualization: Publishes markers of rviz.
        cables: Publisher of the commands.
        pressures: Publishers of pressures, by the names of the cavities.

    Raises:
        SoftRobotTwinError: A parameter, the scene, its mesh or the view cannot be used.
    """

    recording: RunRecording | None = None
    claim: TopicClaim | None = None
    last_command: LastCommand | None = None
    feed: ViewFeed | None = None
    _mesh_error: MeshErrorWatch | None = None
    _mesh_error_reported = False
    _reduction: ReductionErrorWatch | None = None
    _has_listeners = True

    def __init__(self, **arguments):
        super().__init__("twin", **arguments)

    def build(self) -> None:
        """Builds the node; see `TickingNode.build`."""
        values = declare(self, TWIN)
        self.warn_about_unknown_parameters()
        self._values = values
        settings = loop_settings(values)
        self.claim = TopicClaim(self, self.resolve_topic_name(TOPICS["~/cables"].full_name()))
        path = find_scene_file(str(values["scene_file"]), "scene_file")
        if values["record"]:
            # Only a recorded run loads the room that writes it.
            from softrobot_twin.ros.run_recording import RunRecording

            self.recording = RunRecording(self, str(values["record"]))
            simulation = Simulation(load_scene(path), self.recording.clock)
        else:
            simulation = Simulation.from_scene_file(path)
        for note in simulation.notes:
            self.get_logger().warning(note)
        if values["mesh_error"]:
            self._mesh_error = MeshErrorWatch(simulation)
        if values["reduction_error"] and simulation.has_reduced_bodies:
            self._reduction = ReductionErrorWatch(simulation)
        self.loop = TwinLoop(
            simulation, settings, Mode(values["mode"]), bool(values["use_device"]),
            self._velocity_effector(simulation), str(values["frame_id"]),
            float(values["ambient_pressure"]),
        )
        for note in self.loop.cavities.notes:
            self.get_logger().warning(note)
        simulation.warm_up()
        if self.recording is not None:
            self.recording.begin(self.loop, values)
        self.feed = ViewFeed(simulation, values) if ViewFeed.is_wanted(values) else None
        self.priority = ThreadPriority(Priority(values["priority"]))
        self.window = DiagnosticsWindow()
        self._diagnostics_due = 0.0
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self.start(settings.period)
        self.diagnostics = TwinDiagnostics(
            self.loop, self.tick_clock, self.window, self.feed, self._mesh_error, self,
            self._reduction,
        )
        self._open_outputs()
        self._open_inputs()
        angles = () if self._angles is None else (self._angles,)
        self.watch_topics((self.cables, *angles, *self.pressures.values(), *self._solids.commands,
                           *self._measurements), self._commands)
        self.claim.listen()
        self._yield_to_rivals()
        if not self.loop.use_device:
            domain, topic = self.context.get_domain_id(), self.cables.topic_name
            self.last_command = LastCommand(simulation, f"{domain} {topic}")
            self._continue_from_last_command()
        self.claim.is_enabled = lambda: self.loop.is_enabled
        self._log_ready(path)

    def create_publisher(self, *arguments, **options) -> Publisher:
        """Opens a publisher, whose messages are recorded with `record`."""
        publisher = super().create_publisher(*arguments, **options)
        return publisher if self.recording is None else self.recording.publisher(publisher)

    def noted(self, kind: type, topic: str, take: Callable) -> Callable:
        """A function that also records the messages with `record`; see `TickingNode.noted`."""
        return take if self.recording is None else self.recording.receiver(kind, topic, take)

    def _velocity_effector(self, simulation: Simulation) -> int:
        name, names = self._values["velocity_effector"], simulation.effector_names
        if not name:
            return 0
        if name not in names:
            raise ParameterError("velocity_effector", name, "", f"must be one of {names}")
        return names.index(name)

    def _open_outputs(self) -> None:
        simulation = self.loop.simulation
        self._audience = Audience()
        self._repeated = RepeatedMessages(self._audience)
        self.cables = open_publisher(self, TOPICS["~/cables"])
        self._command_bytes = JointStateBytes(simulation.actuator_names, self.loop_frame)
        self.pressures = {
            name: open_publisher(self, TOPICS["~/pressures/<cavity>"], name)
            for name in (*self.loop.cavities.names, *self.loop.cavities.sealed_names)
        }
        self._angles = None
        if self.loop.pulleys.count:
            self._angles = open_publisher(self, TOPICS["~/angles"])
            self._angle_bytes = JointStateBytes(self.loop.pulleys.names, self.loop_frame)
        effectors = simulation.effector_names
        self._effectors = open_publishers(self, TOPICS["~/effectors/<effector>"], effectors)
        self._effector_poses, self._stiffness = (
            {index: open_publisher(self, TOPICS[topic], effectors[index])
             for index in np.flatnonzero(asked).tolist()}
            for topic, asked in (
                ("~/effector_poses/<effector>", simulation.oriented_effectors),
                ("~/stiffness/<effector>", simulation.stiff_effectors),
            )
        )  # fmt: skip
        self._markers = None
        if len(simulation.marker_ids):
            self._markers = open_publisher(self, TOPICS["~/predicted_markers"])
        self._touches = open_publishers(self, TOPICS["~/touch/<touch>"], simulation.touch_names)
        self._solids = SolidOutputs(self, simulation, self._audience)
        self._compliances = ComplianceOutputs(self, self.loop, self._audience)
        self._cable_paths = CablePathOutput(self, simulation, self._audience)
        values = self._values
        self.visualization = VisualizationOutput(
            self, simulation, self.loop_frame, float(values["visualization_rate"])
        )
        self._transforms = TransformOutput(
            self, simulation, self.loop_frame, str(values["tf"]), str(values["tf_prefix"]),
            str(values["tf_base_frame"]), values["tf_base_pose"], self._audience,
        )  # fmt: skip
        self.status = StatusOutput(self, self.loop)
        self._diagnostics_out = open_publisher(self, TOPICS["/diagnostics"])

    def _open_inputs(self) -> None:
        loop, simulation = self.loop, self.loop.simulation
        targets, cavities, touches = loop.targets, loop.cavities.names, loop.touches
        effectors = simulation.effector_names if loop.mode is Mode.INVERSE else ()
        by_index = list(enumerate(effectors))
        self._commands = [
            *self._inputs("~/target/<effector>", targets, "accept_point", read_point, by_index),
            *self._inputs(
                "~/target_pose/<effector>", targets, "accept_pose", read_pose,
                [one for one in by_index if simulation.oriented_effectors[one[0]]],
            ),
            *self._inputs(
                "~/target_stiffness/<effector>", loop.stiffness, "accept", read_vector,
                [one for one in by_index if simulation.stiff_effectors[one[0]]],
            ),
        ]  # fmt: skip
        if effectors:
            refusals = targets.velocity_refusals
            self._commands.append(self._listen("~/target_velocity", self._take_velocity, refusals))
        by_name, pulleys = [(name, name) for name in cavities], [()] * bool(loop.pulleys.count)
        of_touches = list(enumerate(touches.names))
        self._commands += [
            *self._inputs("~/command/cables", self._actuator_commands, "accept", read_joints),
            *self._inputs("~/command/pose/<guided body>", loop.poses, "accept", read_pose,
                          [(name, name) for name in simulation.guided_names]),
            *self._inputs("~/command/pressures/<cavity>", loop.pressures, "accept", read_pressure,
                          by_name),
            *self._inputs("~/command/angles", loop.angles, "accept", read_joints, pulleys),
        ]  # fmt: skip
        self._measurements = [
            *self._inputs("~/measured_pressures/<cavity>", loop.measured_pressures, "accept",
                          read_pressure, by_name),
            *self._inputs("~/measured_angles", loop.measured_angles, "accept", read_joints, pulleys),
            *self._inputs("~/touch_force/<touch>", touches, "accept_force", read_force, of_touches),
            *self._inputs("~/touch_position/<touch>", touches, "accept_place", read_point,
                          of_touches),
            *self._inputs("~/markers", loop.markers, "accept", read_markers),
            *self._inputs("~/measured_cables", loop.device, "accept", read_measured),
        ]  # fmt: skip
        self.create_service(SetBool, "~/enable", self.enable)
        self.create_service(Trigger, "~/reset", self.reset)

    def _inputs(
        self, topic: str, owner: Any, method: str, read: Callable,
        objects: Iterable[tuple] = ((),),
    ) -> list[Subscription]:  # fmt: skip
        """Receives a topic of the table, or one for each object of a kind.

        Args:
            topic: Its name.
            owner: The input of the loop that takes the messages, and counts the refused ones.
            method: Name of the method of `owner` that takes them.
            read: Gives the values of a message, or the reason to refuse it.
            objects: What the input calls each object, and its name; empty for a topic without.
        """
        return [
            self._listen(topic, partial(self._take, owner, method, read, one[:1]), owner.refusals,
                         *one[1:])
            for one in objects
        ]  # fmt: skip

    def _take(
        self, owner: Any, method: str, read: Callable, key: tuple, message: Any
    ) -> Refusal | None:
        """Passes a message on to an input of the loop; see `_inputs`."""
        values = read(message)
        if isinstance(values, Refusal):
            return owner.refusals.add(values)
        return getattr(owner, method)(*key, *values, self.arrival(message.header))

    @property
    def _actuator_commands(self) -> ActuatorInput:
        """Commands of actuators; in inverse mode they exclude these from the optimisation."""
        return self.loop.direct if self.loop.mode is Mode.DIRECT else self.loop.selected

    def _listen(
        self, topic: str, take: Callable, refusals: RefusalCounts, name: str = ""
    ) -> Subscription:
        """Receives a topic of the table; see `TickingNode.listen`."""
        simulation = self.loop.simulation
        names = (*simulation.actuator_names, *simulation.motors, *simulation.pulleys.names)
        return self.listen(TOPICS[topic], take, refusals, name, names=names)

    def contest(self, topic: Topic, name: str, sentence: str) -> None:
        """Takes notice that two publishers send; what the loop does not use stops nothing."""
        super().contest(topic, name, sentence)
        loop, is_of_device = self.loop, topic.name.startswith("~/measured_")
        if is_of_device and not loop.use_device:
            return
        if topic.name == "~/markers" and not loop.settings.closed_loop:
            return
        loop.contest(name, sentence, is_of_device, self.monotonic())

    def _take_velocity(self, message: Twist) -> Refusal | None:
        velocity = message.linear
        return self.loop.targets.accept_velocity(
            (velocity.x, velocity.y, velocity.z), self.monotonic()
        )

    def _yield_to_rivals(self) -> None:
        """Disables the loop while another twin has precedence on these topics."""
        if self.loop.is_enabled and (why := self.claim.why_not()):
            self.loop.give_up(why)

    def _continue_from_last_command(self) -> None:
        """Without a device, moves the model to where the hardware was sent last, by any twin."""
        if self.last_command is None or (stored := self.last_command.read()) is None:
            return
        self.loop.continue_from(
            stored.setpoints, stored.efforts,
            {name: [part.tolist() for part in pose] for name, pose in stored.poses.items()},
        )  # fmt: skip
        self.get_logger().info(f"continues from the last command, {self.last_command.path}")

    def watch_graph(self) -> None:
        """Checks the graph, and who else commands the hardware."""
        self._yield_to_rivals()
        super().watch_graph()

    def topics_of_targets(self) -> list[str]:
        """Full names of the topics of points, poses and velocities."""
        return [one.topic_name for one in self._commands
                if one.msg_type in (PointStamped, PoseStamped, Twist)]  # fmt: skip

    def ghosts(self) -> set[tuple[str, str]]:
        """The twins that claim these topics in the graph, where none of them lives but this one."""
        return publishing_nodes(self, self.claim.claimed_on) if self.claim.is_alone else set()

    def enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Answers ``~/enable``; refused beside another twin that commands."""
        clashes, rival = [], ""
        if request.data and not self.loop.is_enabled:
            clashes, rival = self.look_for_clashes(), self.claim.why_not()
        if clashes or rival:
            sentences = [clash.sentence for clash in clashes]
            response.success = False
            response.message = "; ".join([rival, *sentences] if rival else sentences)
        elif request.data:
            if not self.loop.is_enabled:
                self._continue_from_last_command()
            response.success, response.message = self.loop.enable(self.monotonic())
        else:
            self.loop.disable()
            response.success, response.message = True, "disabled"
        self.get_logger().info(f"enable {request.data}: {response.message}")
        return response

    def reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answers ``~/reset``."""
        response.success, response.message = True, self.loop.reset()
        self.get_logger().info(f"reset: {response.message}")
        return response

    def work(self, now: float) -> None:
        """Steps the loop and publishes the results, all with the same stamp."""
        outcome = self.loop.tick(now, self.stamp)
        self._publish(outcome, self.stamp)
        if self.loop.is_repeating and self.window.ticks:
            self.window.add_again(outcome)
        else:
            self.window.add(outcome)
            if self.feed is not None:
                self.feed.offer(outcome, self.stamp, self.diagnostics.discretization_error)
        if self.recording is not None:
            self.recording.pass_on()

    def _publish(self, outcome: TickOutcome, stamp: int) -> None:
        may_repeat = self.loop.is_repeating and not self._has_listeners
        if may_repeat and self._repeated.send_again(stamp):
            return
        self._repeated.forget()
        offer = self._repeated.offer
        header = Header(stamp=stamp_of(stamp), frame_id=self.loop_frame)
        if outcome.command is not None:
            self._publish_command(outcome.command, stamp, header)
            if self.last_command is not None:
                self.last_command.keep(*outcome.command, outcome.guided_poses)
        sealed = self.loop.cavities.sealed(outcome.result.state.positions)
        for name, pressure in sealed.items():
            offer(self.pressures[name], pressure_message, pressure, header)
        positions = outcome.result.effector_positions
        for publisher, position in zip(self._effectors, positions, strict=True):
            offer(publisher, point_message, position, header)
        turns = outcome.result.effector_orientations
        for index, publisher in self._effector_poses.items():
            offer(publisher, pose_message, positions[index], turns[index], header)
        reached = outcome.result.effector_stiffness
        for index, publisher in self._stiffness.items():
            if reached is not None:
                offer(publisher, vector_message, reached[index], header)
        for index, publisher in enumerate(self._touches):
            offer(publisher, touch_message, outcome.result.touches, index, header)
        # A cloud takes a tenth of a millisecond to make.
        wants_markers = self._markers is not None and self._audience.hears(self._markers)
        if wants_markers:
            ids = self.loop.simulation.marker_ids
            self._markers.publish(markers_message(ids, outcome.predicted_markers, header))
        outputs = (self._solids, self._compliances, self._cable_paths, self._transforms)
        self._has_listeners = any([
            wants_markers, *(output.publish(outcome, header) for output in outputs)
        ])  # fmt: skip

    def _publish_command(self, command: ActuatorCommand, stamp: int, header: Header) -> None:
        send, pulleys = self._repeated.send, self.loop.pulleys
        send(self.cables, self._command_bytes.message(stamp, *command))
        if self._angles is not None:
            angles, torques = pulleys.angles(command.setpoints), pulleys.torques(command.efforts)
            send(self._angles, self._angle_bytes.message(stamp, angles, torques))
        for name, pressure in self.loop.cavities.absolute(command.efforts).items():
            send(self.pressures[name], pressure_message(pressure, header))

    def after_failure(self, now: float) -> None:
        """Tells the failure, and publishes the last safe command."""
        command = self.loop.after_failure(self.failure, self.failures_in_a_row)
        self.status.tell_failure(self.failure)
        if self.recording is not None:
            self.recording.pass_on()
        if command is not None:
            stamp = self.ros_time()
            header = Header(stamp=stamp_of(stamp), frame_id=self.loop_frame)
            self._publish_command(command, stamp, header)

    @property
    def loop_frame(self) -> str:
        """Frame of all positions."""
        return str(self._values["frame_id"])

    def after_work(self, now: float) -> None:
        """Publishes markers and the status when they are due and diagnostics once a second, and
        logs problems of the last tick."""
        newest = self.window.newest
        if self.has_worked:
            self.visualization.offer(newest, self.stamp, now)
        if self.has_worked and not self.loop.is_repeating:
            self.status.offer(newest, now)
            self._warn_of(newest, now)
        if now < self._diagnostics_due:
            return
        self._diagnostics_due = now + DIAGNOSTICS_PERIOD
        self._watch_mesh_error(now)
        if self._reduction is not None and not self.loop.simulation.falls_back:
            self._reduction.offer(self.loop.simulation, False, now)
        message = DiagnosticArray(status=self.diagnostics.statuses(now))
        message.header.stamp = stamp_of(self.ros_time())
        self._diagnostics_out.publish(message)
        self.window.clear()

    def request_diagnostics(self) -> None:
        """Makes the next tick publish diagnostics."""
        self._diagnostics_due = -math.inf

    def _watch_mesh_error(self, now: float) -> None:
        """Updates the estimate of the mesh's error, and logs once the error at rest."""
        watch, loop = self._mesh_error, self.loop
        if watch is None:
            return
        forces_given = loop.mode is Mode.DIRECT and loop.direct.efforts is not None
        watch.offer(loop.simulation, forces_given, now)
        if self._mesh_error_reported or not (watch.at_rest or watch.cause):
            return
        self._mesh_error_reported = True
        if watch.at_rest is None:
            self.get_logger().info(f"the error of the mesh is not estimated: {watch.cause}")
        elif watch.at_rest.is_large:
            self.get_logger().warning(watch.at_rest.in_words())
        else:
            self.get_logger().info(watch.at_rest.in_words())

    def _warn_of(self, outcome: TickOutcome, now: float) -> None:
        logger, activity = self.get_logger(), outcome.activity.value
        if self.last_command is not None and self.last_command.failure:
            logger.warning(f"the last command is not kept for the next start: "
                           f"{self.last_command.failure}", throttle_duration_sec=60.0)
        if self.loop.is_enabled and self.loop.device_is_lost(now):
            logger.warning(f"device lost: {activity}", throttle_duration_sec=_WARN_EVERY)
        if self.loop.is_enabled and self.loop.markers_are_lost(outcome.measured_markers):
            logger.warning(f"markers lost: {activity}", throttle_duration_sec=_WARN_EVERY)
        if self.loop.why_given_up:
            logger.error(
                f"disabled: {self.loop.why_given_up}; call ~/enable to try again",
                throttle_duration_sec=_WARN_EVERY,
            )
        for outside in outcome.result.report.strains:
            logger.warning(outside.in_words(), throttle_duration_sec=_WARN_EVERY)
        if outcome.violated:
            broken = ", ".join(outcome.violated)
            logger.error(f"command kept back: {broken}", throttle_duration_sec=_WARN_EVERY)
        elif outcome.result.status.is_failure:
            status = outcome.result.status.value
            logger.error(f"step failed: {status}", throttle_duration_sec=_WARN_EVERY)

    def _changed_settings(self, parameters: list[Parameter]) -> LoopSettings:
        changes = {parameter.name: plain(parameter) for parameter in parameters}
        for name in changes.keys() & _TABLE.keys():
            _TABLE[name].check(changes[name])
        return loop_settings(self._values | changes)

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self.loop.check(self._changed_settings(parameters))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, parameters: list[Parameter]) -> None:
        settings = self._changed_settings(parameters)
        self._values |= {parameter.name: plain(parameter) for parameter in parameters}
        self.loop.apply(settings)
        if settings.period != self.tick_clock.period:
            self.change_period(settings.period)

    def _log_ready(self, scene: object) -> None:
        simulation, loop = self.loop.simulation, self.loop
        if self.feed is not None and self.feed.mirror.address:
            self.get_logger().info(f"view: rerun {self.feed.mirror.address}")
        state = "" if loop.is_enabled else "; disabled until ~/enable is called"
        self.get_logger().info(
            f"ready: {scene}, {simulation.node_count} nodes, {loop.mode.value}, "
            f"{loop.settings.rate:g} Hz{state}"
        )

    def destroy_node(self) -> None:
        """Closes the view, the recording and the process that estimates the mesh's error, then
        destroys the node.
        """
        for part in (self.claim, self.last_command, self._mesh_error, self._reduction, self.feed,
                     self.recording):  # fmt: skip
            if part is not None:
                part.close()
        super().destroy_node()
