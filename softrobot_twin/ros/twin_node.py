"""Node of the twin: stores received messages, steps the loop at each tick, publishes the
results.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import compress, repeat
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, Twist
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance
from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.command_gate import ActuatorCommand
from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.last_command import LastCommand
from softrobot_twin.control.live_calibration import LiveCalibration
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.mesh_error_watch import MeshErrorWatch
from softrobot_twin.control.reduction_error_watch import ReductionErrorWatch
from softrobot_twin.control.rest_watch import RestWatch, sample_of
from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop, owner_of
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.audience import Audience
from softrobot_twin.ros.claim import TopicClaim
from softrobot_twin.ros.diagnostics import TwinDiagnostics
from softrobot_twin.ros.message_bytes import MessageBytes, stamped, to_bytes
from softrobot_twin.ros.messages import (
    READERS,
    cables_message,
    contacts_message,
    markers_message,
    matrix_message,
    point_message,
    pose_message,
    pressure_message,
    stamp_of,
    vector_message,
    wrench_message,
)
from softrobot_twin.ros.outputs import Output, open_outputs, rows_of
from softrobot_twin.ros.parameters import TWIN, declare, loop_settings, plain
from softrobot_twin.ros.scene_file import find_scene
from softrobot_twin.ros.status import StatusOutput
from softrobot_twin.ros.thread_priority import Priority, ThreadPriority
from softrobot_twin.ros.ticking_node import TickingNode, publishing_nodes
from softrobot_twin.ros.topics import TWIN_TOPICS as TOPICS
from softrobot_twin.ros.topics import (
    Direction,
    Topic,
    channel_topic,
    measured_topic,
    open_publisher,
)
from softrobot_twin.ros.transforms import BaseFollower, TransformOutput
from softrobot_twin.ros.view_feed import ViewFeed
from softrobot_twin.ros.visualization import VisualizationOutput
from softrobot_twin.scene.loading import load_scene
from softrobot_twin.shared_files import ScenePath
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.appearance import Pose
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.tables.channels import BUILT_IN, registered, measured

if TYPE_CHECKING:
    from softrobot_twin.ros.run_recording import RunRecording


def _paths(simulation: Simulation, positions: np.ndarray) -> list[tuple]:
    """Names and path lengths of cables [m], and no tensions, at node positions [m]."""
    paths = simulation.actuators.path_lengths(positions)
    return [(list(paths), list(paths.values()), ())]


def _pressure_of(pressure: np.ndarray, header: Header) -> FluidPressure:
    return pressure_message(pressure.item(), header)


def commands_of(loop: TwinLoop) -> Iterator[Output]:
    """What is published of a command that may leave.

    Args:
        loop: The loop. What is read is a command and the poses of guided bodies by name, of which
            there may be none.
    """
    names, guided = loop.simulation.actuator_names, loop.simulation.guided_names
    pulleys, cavities = loop.pulleys, loop.cavities
    told = loop.simulation.actuators.told_efforts
    yield Output(TOPICS["~/cables"], [""], partial(cables_message, names),
                 lambda sent: [(sent[0].setpoints, told(sent[0].efforts))],
                 (len(names), len(names)))
    yield Output(TOPICS["~/angles"], [""] * bool(pulleys.count), partial(cables_message, pulleys.names),
                 lambda sent: [(pulleys.angles(sent[0].setpoints), pulleys.torques(sent[0].efforts))],
                 (pulleys.count, pulleys.count))
    yield Output(TOPICS["~/pressures/<cavity>"], cavities.names, _pressure_of,
                 lambda sent: rows_of(cavities.absolute(told(sent[0].efforts)).values()), (1,))
    yield Output(TOPICS["~/poses/<guided body>"], guided, pose_message,
                 lambda sent: [sent[1][name] for name in guided if name in sent[1]], (3, 4))


_OF_CHANNELS: dict[str, tuple] = {
    "~/effectors/<effector>": (point_message, "effector_positions"),
    "~/effector_poses/<effector>": (pose_message, "effector_positions", "effector_orientations"),
    "~/stiffness/<effector>": (vector_message, "effector_stiffness"),
    "~/touch/<touch>": (partial(cables_message, "xyz"), "touch_displacements", "touch_forces"),
    "~/external_forces/<force>": (
        lambda torque, force, header: wrench_message(force, header, torque),
        "external_torques", "external_forces"),
    "~/force_deviations/<force>": (
        partial(cables_message, "xyz"), "external_force_places", "external_force_deviations"),
}  # fmt: skip
"""Topics of channels of the package, what makes their messages, and the channels; of each object
that has the last one."""


def _of_channels(simulation: Simulation) -> Iterator[Output]:
    """What is published of channels, also of those that are registered."""
    known = {one.name: one for one in BUILT_IN}
    shown = [(TOPICS[topic], make, [known[name] for name in names])
             for topic, (make, *names) in _OF_CHANNELS.items()]
    shown += [(channel_topic(one), lambda values, header, parts=one.parts: cables_message(
        parts, values, (), header), [one]) for one in registered()]  # fmt: skip
    for topic, make, told in shown:
        yield Output(topic, told[-1].names(simulation), make,
                     lambda tick, told=told: rows_of(*(one.read(tick.result) for one in told)),
                     [one.width for one in told], told[-1].are_asked(simulation))  # fmt: skip


def outputs_of(loop: TwinLoop) -> Iterator[Output]:
    """What is published after each tick beside commands.

    Args:
        loop: The loop.
    """
    simulation, sealed = loop.simulation, loop.cavities.sealed
    yield Output(TOPICS["~/pressures/<cavity>"], loop.cavities.sealed_names, _pressure_of,
                 lambda tick: rows_of(sealed(tick.result.state.positions).values()), (1,))
    has_cables = any(kind.one_sided for kind in simulation.actuators.kinds)
    yield from _of_channels(simulation)
    observed, figures = simulation.observed_names, simulation.figure_names
    yield Output(TOPICS["~/external_contacts"], [""] * bool(observed),
                 lambda values, header: cables_message(observed, values, (), header),
                 lambda tick: [(tick.result.state.memory["observer.is_detected"],)], (len(observed),))
    yield Output(TOPICS["~/figures"], [""] * bool(figures),
                 lambda values, header: cables_message(figures, values, (), header),
                 lambda tick: [([*tick.result.report.figures.values()],)], (len(figures),))
    yield Output(TOPICS["~/predicted_markers"], [""] * bool(len(simulation.marker_ids)),
                 markers_message, lambda tick: [(simulation.marker_ids, tick.predicted_markers)],
                 is_costly=True)
    yield Output(TOPICS["~/bodies/<rigid body>"], simulation.rigid_names, pose_message,
                 lambda tick: rows_of(*simulation.rigid_poses()), (3, 4), is_costly=True)
    yield Output(TOPICS["~/contacts"], [""] * (simulation.scene.contact is not None),
                 lambda contacts, header: contacts_message(
                     contacts.positions, contacts.forces, header),
                 lambda tick: [(found,)] if (found := tick.result.contacts) is not None else [])
    yield Output(TOPICS["~/cable_paths"], [""] * has_cables, cables_message,
                 lambda tick: _paths(simulation, tick.result.state.positions), is_costly=True)


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
            [open_publisher(node, TOPICS[f"~/{topic}/<effector>"], name)
             for name in loop.simulation.effector_names]
            for topic in ("compliance", "jacobian")
        )  # fmt: skip

    @property
    def is_heard(self) -> bool:
        """Whether somebody receives one of them."""
        return self._audience.hears_any((*self._compliances, *self._jacobians))

    def publish(self, outcome: TickOutcome, header: Callable[[], Header]) -> None:
        """Publishes a tick to those who listen, where there are any.

        Args:
            outcome: What the tick told.
            header: Gives the header of the tick's messages.
        """
        loop = self._loop
        if self._compliance is None:
            self._compliance = EffectorCompliance(loop.simulation)
        found = self._compliance.after_step(loop.driven_by_efforts(outcome))
        self._send(self._compliances, found.compliance, self._FORCES, header())
        actuators = loop.simulation.actuators
        quantities = actuators.driven_quantities(found.is_by_effort)
        columns = list(map(column, actuators.names, quantities))
        self._send(self._jacobians, found.jacobian, columns, header())

    def _send(self, publishers, matrices: np.ndarray, columns, header: Header) -> None:
        for publisher, matrix in zip(publishers, matrices, strict=True):
            if self._audience.hears(publisher):
                publisher.publish(matrix_message(matrix, self._WORLD, columns, header))


DIAGNOSTICS_PERIOD = 1.0
_WARN_EVERY = 2.0
_TABLE = {entry.name: entry for entry in TWIN}
_OF_HARDWARE = ("~/cables", "~/angles", "~/pressures/<cavity>", "~/poses/<guided body>")
"""Names of the outputs that hardware follows or that tell of it."""
_OF_USERS = ("~/target", "~/command/")
"""Beginnings of the names of inputs that are wishes; the others are measurements."""


class TwinNode(TickingNode):
    """Builds the simulation, warms it up, and runs its loop in the ticks.

    Args:
        arguments: What `rclpy.node.Node` takes besides a name.

    Attributes:
        loop: The loop.
        recording: Records the run; None without `record`.
        claim: Its claim of the topic of its commands.
        last_command: Keeps the last command over a restart; None with a device.
        calibration: Gathers poses at rest and has them fitted; None in a scene without markers.
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
    calibration: LiveCalibration | None = None
    feed: ViewFeed | None = None
    _mesh_error: MeshErrorWatch | None = None
    _mesh_error_reported = False
    _reduction: ReductionErrorWatch | None = None

    def __init__(self, **arguments):
        super().__init__("twin", **arguments)

    def build(self) -> None:
        """Builds the node; see `TickingNode.build`."""
        values = declare(self, TWIN)
        self.warn_about_unknown_parameters()
        self._values = values
        settings = loop_settings(values)
        self.claim = TopicClaim(self, self.resolve_topic_name(TOPICS["~/cables"].full_name()))
        path = find_scene(values)
        if values["observer"] and load_scene(path).observer is None:
            path = ScenePath(path, (*path.changes, "observer={}"))
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
        if values["reduction_error"] and simulation.has_reduced_bodies and not simulation.model.is_dynamic:
            self._reduction = ReductionErrorWatch(simulation)
        self.loop = TwinLoop(
            simulation, settings, Mode(values["mode"]), bool(values["use_device"]),
            self._velocity_effector(simulation), self.loop_frame, float(values["ambient_pressure"]))
        for note in self.loop.cavities.notes:
            self.get_logger().warning(note)
        if self.loop.dynamic is not None:
            self.get_logger().info(self.loop.dynamic.words())
        if simulation.scene.markers:
            self.calibration = LiveCalibration(
                simulation, RestWatch(simulation, simulation.scene.name),
                [key for key in values["calibrate_fit"] if key], path.changes)
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
        self.diagnostics = TwinDiagnostics(self.loop, self.tick_clock, self.window, self.feed,
                                           self._mesh_error, self, self._reduction)
        self._open_outputs()
        self._open_inputs()
        hardware = (one for topic in _OF_HARDWARE for one in self.publishers_on(topic).values())
        self.watch_topics((*hardware, *self._measurements), self._commands)
        self.claim.listen()
        self._yield_to_rivals()
        if not self.loop.use_device:
            domain, topic = self.context.get_domain_id(), self.cables.topic_name
            self.last_command = LastCommand(simulation, f"{domain} {topic}")
            self._continue_from_last_command()
        self.claim.is_enabled = lambda: self.loop.is_enabled
        self._log_ready(path)

    def create_publisher(self, *arguments, **options) -> Publisher:
        """Opens a publisher, whose messages are recorded with `record`.

        Args:
            *arguments: As of `rclpy.node.Node.create_publisher`.
            **options: As there.
        """
        publisher = super().create_publisher(*arguments, **options)
        return publisher if self.recording is None else self.recording.publisher(publisher)

    def noted(self, kind: type, topic: str) -> Callable[[bytes], object]:
        """What records the messages with `record`; see `TickingNode.noted`.

        Args:
            kind: Class of the messages.
            topic: Name of the topic.
        """
        if self.recording is None:
            return super().noted(kind, topic)
        return self.recording.receiver(kind, topic)

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
        self._round, self._sent = 0, list[tuple[Publisher, bytes]]()
        frame = self.loop_frame
        self._orders, self._outputs = (
            [(output, self._maker(output), publishers)
             for output, publishers in open_outputs(self, outputs)]
            for outputs in (commands_of(self.loop), outputs_of(self.loop)))
        self.cables = self.publishers_on("~/cables")[""]
        self.pressures = self.publishers_on("~/pressures/<cavity>")
        self._compliances = ComplianceOutputs(self, self.loop, self._audience)
        values = self._values
        self.visualization = VisualizationOutput(self, simulation, frame, float(values["visualization_rate"]))
        self._transforms = TransformOutput(self, simulation, values, self._audience)
        self.status = StatusOutput(self, self.loop)
        self._diagnostics_out = open_publisher(self, TOPICS["/diagnostics"])

    def publishers_on(self, topic: str) -> dict[str, Publisher]:
        """Publishers of an output's topic in `TWIN_TOPICS`, by the names of their objects.

        Args:
            topic: Name of the topic in the table.
        """
        return {output.names[index]: publisher
                for output, _, publishers in (*self._orders, *self._outputs)
                if output.topic.name == topic for index, publisher in publishers.items()}  # fmt: skip

    def _maker(self, output: Output) -> Callable[..., object]:
        """Makes messages of an output of a stamp [ns] and values."""
        if output.counts:
            return MessageBytes(output.make, self.loop_frame, *output.counts).message
        return lambda stamp, *values: output.make(*values, self._header(stamp))

    def _header(self, stamp: int) -> Header:
        """The header of messages with a time [ns]."""
        return Header(stamp=stamp_of(stamp), frame_id=self.loop_frame)

    def _open_inputs(self) -> None:
        loop, simulation = self.loop, self.loop.simulation
        # What the loop calls each object of a kind, and its name.
        objects = {
            "<effector>": [((index,), name) for index, name in enumerate(simulation.effector_names)],
            "<touch>": [((index,), name) for index, name in enumerate(simulation.touch_names)],
            "<cavity>": [((name,), name) for name in loop.cavities.names],
            "<guided body>": [((name,), name) for name in simulation.guided_names],
        }
        has_it = {
            "~/target_pose/<effector>": simulation.oriented_effectors,
            "~/target_stiffness/<effector>": simulation.stiff_effectors,
            "~/target_velocity": [bool(simulation.effector_names)],
            "~/target_path/<effector>": repeat(simulation.scene.control is not None),
        }  # fmt: skip
        for channel in measured():
            names = channel.names(simulation)
            objects[f"<{channel.name}>"] = [((index,), name) for index, name in enumerate(names)]
        self._commands, self._measurements = [], []
        for topic in (*TOPICS.values(), *map(measured_topic, measured())):
            name = topic.name
            if topic.direction is Direction.IN and owner_of(loop, topic.call)[0] is not None:
                kept = self._commands if name.startswith(_OF_USERS) else self._measurements
                kind = name.rpartition("/")[2]
                kept += [self._listen(topic, *one) for one in compress(
                    objects.get(kind, [((), "")]), has_it.get(name, repeat(True)))]
        self.create_service(SetBool, "~/enable", self.enable)
        self.create_service(Trigger, "~/reset", self.reset)
        self.create_service(Trigger, "~/calibrate", self.calibrate)
        frame = str(self._values["base_frame"])
        if frame and loop.measured_base is None:
            raise ParameterError("base_frame", frame, "", "needs a scene with moving_base")
        if frame:
            self._base = BaseFollower(self, frame, lambda place, turn, header: loop.measured_base.accept(
                place, turn, self.arrival(header)))  # fmt: skip
        for name in simulation.grip_names:
            self.create_service(SetBool, f"~/grip/{name}", partial(self.grip, name))

    def _listen(self, topic: Topic, key: tuple, name: str) -> Subscription:
        """Receives a topic of the table; see `TickingNode.listen`.

        Args:
            topic: The topic.
            key: What the loop calls its object; empty for a topic without.
            name: Name of the object.
        """
        simulation, (owner, _) = self.loop.simulation, owner_of(self.loop, topic.call)
        names = (*simulation.actuator_names, *simulation.motors, *simulation.pulleys.names)
        take = partial(self._take, topic, key)
        return self.listen(topic, take, owner.refusals, name, names=names)

    def _take(self, topic: Topic, key: tuple, message: Any) -> Refusal | None:
        """Passes a message on to an input of the loop; see `_listen`."""
        owner, method = owner_of(self.loop, topic.call)
        values = READERS[topic.kind](message)
        if isinstance(values, Refusal):
            return owner.refusals.add(values)
        has_header = topic.kind is not Twist
        arrival = self.arrival(message.header) if has_header else self.monotonic()
        return getattr(owner, method)(*key, *values, arrival)

    def contest(self, topic: Topic, name: str, sentence: str) -> None:
        """Takes notice that two publishers send; what the loop does not use stops nothing."""
        super().contest(topic, name, sentence)
        loop, is_of_device = self.loop, topic.name.startswith("~/measured_")
        if (is_of_device and not loop.use_device) or topic.name not in TOPICS:
            return
        if topic.name == "~/markers" and not loop.settings.closed_loop:
            return
        loop.contest(name, sentence, is_of_device, self.monotonic())

    def _yield_to_rivals(self) -> None:
        """Disables the loop while another twin has precedence on these topics."""
        if self.loop.is_enabled and (why := self.claim.why_not()):
            self.loop.give_up(why)

    def _continue_from_last_command(self) -> None:
        """Without a device, moves the model to where the hardware was sent last, by any twin."""
        if self.last_command is None:
            return
        why, stored = "", self.last_command.read()
        if stored is not None:
            poses = {name: [part.tolist() for part in pose] for name, pose in stored.poses.items()}
            why = self.loop.continue_from(stored.setpoints, stored.efforts, poses)
            why = why and f"{self.last_command.path}: {why}"
        if why := why or self.last_command.refusal:
            self.get_logger().warning(
                f"the last command is not used; the robot is taken to be where this twin sent it "
                f"last, or at rest: {why}")
        elif stored is not None:
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
        """Answers ``~/enable``; refused beside another twin that commands.

        Args:
            request: Whether to enable or to disable.
            response: The answer; is filled.
        """
        refusals: list[str] = []
        if request.data and not self.loop.is_enabled:
            clashes, rival = self.look_for_clashes(), self.claim.why_not()
            refusals = [rival] * bool(rival) + [clash.sentence for clash in clashes]
        if refusals:
            return self._answered("enable True", response, False, "; ".join(refusals))
        if not request.data:
            self.loop.disable()
            return self._answered("enable False", response, True, "disabled")
        if not self.loop.is_enabled:
            self._continue_from_last_command()
        return self._answered("enable True", response, *self.loop.enable(self.monotonic()))

    def _answered(self, request: str, response: Any, success: bool, message: str) -> Any:
        """Fills the answer to a request, and logs it."""
        response.success, response.message = success, message
        self.get_logger().info(f"{request}: {message}")
        return response

    def reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answers ``~/reset``.

        Args:
            request: Has no content.
            response: The answer; is filled.
        """
        return self._answered("reset", response, True, self.loop.reset())

    def grip(self, name: str, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Answers ``~/grip/<grip>``.

        Args:
            name: The grip.
            request: Whether it shall hold.
            response: The answer; is filled.
        """
        return self._answered(f"grip {name}", response, *self.loop.grip(name, request.data))

    def calibrate(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answers ``~/calibrate``: begins a fit in another process, and changes nothing here.

        Args:
            request: Has no content.
            response: The answer; is filled.
        """
        found = False, "the scene has no markers: nothing that is measured tells where the robot is"
        if self.calibration is not None:
            found = self.calibration.ask(self.monotonic())
        return self._answered("calibrate", response, *found)

    def work(self, now: float) -> None:
        """Steps the loop and publishes the results, all with the same stamp.

        Args:
            now: Time on the monotonic clock [s].
        """
        outcome = self.loop.tick(now, self.stamp)
        self._publish(outcome, self.stamp)
        if self.calibration is not None:
            command, touches = outcome.command, outcome.result.touches
            self.calibration.offer_sample(now, lambda: sample_of(
                self.loop, now, now, None if command is None else command.setpoints,
                None if touches is None else touches.forces))
        if self.loop.is_repeating and self.window.ticks:
            self.window.add_again(outcome)
        else:
            self.window.add(outcome)
            if self.feed is not None:
                self.feed.offer(outcome, self.stamp, self.diagnostics.discretization_error)
        if self.recording is not None:
            self.recording.pass_on()

    def _publish(self, outcome: TickOutcome, stamp: int) -> None:
        if self._audience.begin_round() != self._round:
            self._ask_audience()
        elif self.loop.is_repeating and not self._others:
            # To make and convert a message takes longer than to publish its bytes.
            for publisher, content in self._sent:
                publisher.publish(stamped(content, stamp))
            return
        self._sent.clear()
        if outcome.command is not None:
            self._publish_command(outcome.command, outcome.guided_poses, stamp)
        for output, make, publishers in self._heard:
            rows = output.read(outcome)
            for index, publisher in publishers if rows else ():
                self._send(publisher, make(stamp, *rows[index]))
        for others in self._others:
            others.publish(outcome, partial(self._header, stamp))

    def _ask_audience(self) -> None:
        """Finds the outputs that are received or, as those of a recorded run, kept: no other is read."""
        self._round, self._heard = self._audience.rounds, []
        self._others = [one for one in (self._compliances, self._transforms) if one.is_heard]
        for output, make, publishers in self._outputs:
            heard = [(index, one) for index, one in publishers.items()
                     if type(one) is not Publisher or self._audience.hears(one)]
            if heard and (not output.is_costly or self._audience.hears_any(one for _, one in heard)):
                self._heard.append((output, make, heard))

    def _publish_command(self, command: ActuatorCommand, poses: Mapping[str, Pose], stamp: int) -> None:
        for output, make, publishers in self._orders:
            for publisher, row in zip(publishers.values(), output.read((command, poses))):
                self._send(publisher, make(stamp, *row))

    def _send(self, publisher: Publisher, message: object) -> None:
        """Publishes a message, serialized or not, which ticks at rest repeat with their stamps."""
        content = to_bytes(message)
        publisher.publish(content)
        self._sent.append((publisher, content))

    def after_failure(self, now: float) -> None:
        """Tells the failure, and publishes the last safe command.

        Args:
            now: Time on the monotonic clock [s].
        """
        command = self.loop.after_failure(self.failure, self.failures_in_a_row)
        self.status.tell_failure(self.failure)
        if self.recording is not None:
            self.recording.pass_on()
        if command is not None:
            self._publish_command(command, {}, self.ros_time())

    @property
    def loop_frame(self) -> str:
        """Frame of all positions."""
        return str(self._values["frame_id"])

    def after_work(self, now: float) -> None:
        """Publishes markers and the status when they are due and diagnostics once a second, logs
        problems of the last tick, and looks for nearer poses.

        Args:
            now: Time on the monotonic clock [s].
        """
        newest = self.window.newest
        if self.has_worked:
            self.visualization.offer(newest, self.stamp, now)
            if not self.loop.is_repeating:
                if self.last_command is not None and newest.command is not None:
                    self.last_command.keep(*newest.command, newest.guided_poses)
                self.status.offer(newest, now)
                self._warn_of(newest, now)
            self.loop.simulation.plan()
        if now < self._diagnostics_due:
            return
        self._diagnostics_due = now + DIAGNOSTICS_PERIOD
        self._watch_mesh_error(now)
        if self.calibration is not None and self.calibration.look(now):
            for line in self.calibration.told.splitlines():
                self.get_logger().info(f"calibrate: {line}")
        if self._reduction is not None:
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
        forces_given = loop.direct is not None and loop.direct.efforts is not None
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
        logger, loop = self.get_logger(), self.loop
        if self.last_command is not None and self.last_command.failure:
            logger.warning(f"the last command is not kept for the next start: "
                           f"{self.last_command.failure}", throttle_duration_sec=60.0)
        if loop.is_enabled and loop.device_is_lost(now):
            logger.warning(f"device lost: {outcome.activity.value}", throttle_duration_sec=_WARN_EVERY)
        if loop.is_enabled and loop.markers_are_lost(outcome.measured_markers):
            logger.warning(f"markers lost: {outcome.activity.value}", throttle_duration_sec=_WARN_EVERY)
        if self.loop.why_given_up:
            logger.error(f"disabled: {self.loop.why_given_up}; call ~/enable to try again",
                         throttle_duration_sec=_WARN_EVERY)
        for outside in outcome.result.report.strains:
            logger.warning(outside.in_words(), throttle_duration_sec=_WARN_EVERY)
        if outcome.violated:
            logger.error(f"command kept back: {', '.join(outcome.violated)}",
                         throttle_duration_sec=_WARN_EVERY)
        elif outcome.result.status.is_failure:
            logger.error(f"step failed: {outcome.result.status.value}", throttle_duration_sec=_WARN_EVERY)

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
        self.get_logger().info(f"ready: {scene}, {simulation.node_count} nodes, {loop.mode.value}, "
                               f"{loop.settings.rate:g} Hz{state}")

    def destroy_node(self) -> None:
        """Closes the view, the recording and the process that estimates the mesh's error, then
        destroys the node.
        """
        for part in (self.claim, self.last_command, self._mesh_error, self._reduction,
                     self.calibration, self.feed, self.recording):  # fmt: skip
            if part is not None:
                part.close()
        super().destroy_node()
