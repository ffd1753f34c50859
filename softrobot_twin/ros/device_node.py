"""Node of a simulated robot: receives setpoints, publishes measured ones, and markers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import partial

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.device import (
    CarriedDevice,
    Device,
    PressurisedDevice,
    TouchedDevice,
    WoundDevice,
)
from softrobot_twin.control.inputs import ActuatorInput, ActuatorNames, PoseInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.simulated_device import DeviceFlaws, Presses, SimulatedDevice
from softrobot_twin.ros.messages import (
    cables_message,
    markers_message,
    point_message,
    pose_message,
    pressure_message,
    read_pose,
    stamp_of,
    wrench_message,
)
from softrobot_twin.ros.outputs import Output, open_outputs, rows_of
from softrobot_twin.ros.parameters import DEVICE, Entry, declare
from softrobot_twin.ros.scene_file import find_scene
from softrobot_twin.ros.ticking_node import TickingNode
from softrobot_twin.ros.topics import DEVICE_TOPICS as TOPICS
from softrobot_twin.simulation import Simulation


class DeviceNode(TickingNode):
    """Connects a `softrobot_twin.control.device.Device` to the topics of a twin.

    A driver of real hardware is a subclass whose `make_device` returns another device.

    Args:
        arguments: What `rclpy.node.Node` takes besides a name.

    Attributes:
        device: The device.
        refusals: Commands refused, by reason.
        poses: Commanded poses of guided bodies.
        own_parameters: Parameters of a subclass, besides those of the simulated device.

    Raises:
        SoftRobotTwinError: A parameter, the scene or its mesh cannot be used.
    """

    own_parameters: tuple[Entry, ...] = ()

    def __init__(self, **arguments):
        super().__init__("device", **arguments)

    def build(self) -> None:
        """Builds the node; see `TickingNode.build`."""
        values = declare(self, (*DEVICE, *self.own_parameters))
        self.warn_about_unknown_parameters(self.own_parameters)
        self.device = self.make_device(values)
        self._frame = str(values["frame_id"])
        self._ambient_pressure = float(values["ambient_pressure"])
        self._follows_efforts = values["device_follows"] == "efforts"
        self._sends_force = values["device_touch_sends"] == "force"
        settings = LoopSettings(
            **{name: values[name] for name in ("message_timeout", "future_tolerance")})
        self._commands = ActuatorInput(ActuatorNames(self.device.actuator_names), settings)
        self.refusals = self._commands.refusals
        self._carried = self.device if isinstance(self.device, CarriedDevice) else None
        guided = () if self._carried is None else self._carried.guided_names
        self.poses = PoseInput(guided, self._frame, settings)
        self.start(1.0 / values["device_rate"])
        self._open(str(values["twin"]).rstrip("/"))
        self.get_logger().info(f"ready: {', '.join(self.device.actuator_names)}")

    def make_device(self, values: Mapping[str, object]) -> Device:
        """Makes the device; here a simulated one.

        Args:
            values: Parameter values by name.

        Raises:
            SoftRobotTwinError: A parameter, the scene or its mesh cannot be used.
        """
        flaws = DeviceFlaws(**{one.name: values[f"device_{one.name}"] for one in fields(DeviceFlaws)})
        path = find_scene(values, "device_scene")
        simulation = Simulation.from_scene_file(path)
        for note in simulation.notes:
            self.get_logger().warning(note)
        simulation.warm_up()
        self.get_logger().info(f"scene: {path}, {simulation.node_count} nodes")
        touch = [values[f"device_touch{part}"] for part in ("", "_depth", "_period", "_direction")]
        presses = Presses(*touch) if touch[0] else None
        return SimulatedDevice(simulation, flaws, float(values["ambient_pressure"]), presses,
                               values["device_follows"])

    def _open(self, twin: str) -> None:
        self._outputs = open_outputs(self, self._measurement_outputs(), twin)
        opened = [(output.topic.name, publisher) for output, publishers in self._outputs
                  for publisher in publishers.values()]  # fmt: skip
        self.cables = dict(opened)["<twin>/measured_cables"]
        carried, refusals = self._carried, self.refusals
        topic, names = TOPICS["<twin>/cables"], self.device.actuator_names
        commands = [self.listen(topic, self.take, refusals, "", twin, names)]
        topic = TOPICS["<twin>/poses/<guided body>"]
        for name in () if carried is None else carried.guided_names:
            take = partial(self._take_pose, name)
            commands.append(self.listen(topic, take, self.poses.refusals, name, twin))
        self.watch_topics((*(one for name, one in opened if name.startswith("<twin>")), *commands))

    def _measurement_outputs(self) -> Iterator[Output]:
        """What is published of each measurement."""
        device, names = self.device, self.device.actuator_names
        yield Output(TOPICS["<twin>/measured_cables"], [""], partial(cables_message, names),
                     lambda seen: [(seen.setpoints, seen.efforts)])
        wound = device.pulleys if isinstance(device, WoundDevice) else None
        if wound is not None and wound.count:
            yield Output(
                TOPICS["<twin>/measured_angles"], [""], partial(cables_message, wound.names),
                lambda seen: [(wound.angles(seen.setpoints), wound.torques(seen.efforts))])
        if isinstance(device, PressurisedDevice):
            places = [names.index(name) for name in device.cavity_names]
            yield Output(
                TOPICS["<twin>/measured_pressures/<cavity>"], device.cavity_names,
                lambda *made: pressure_message(*made, device.pressure_variance),
                lambda seen: rows_of(self._ambient_pressure + seen.efforts[places]))
        yield Output(TOPICS["<twin>/markers"], [""], markers_message,
                     lambda seen: [(seen.marker_ids, seen.marker_positions)])
        yield Output(TOPICS["~/effectors/<effector>"], device.effector_names, point_message,
                     lambda seen: rows_of(seen.effector_positions))
        if isinstance(device, TouchedDevice):
            yield from self._touch_outputs(device)
        if self._carried is not None:
            yield Output(TOPICS["~/bodies/<rigid body>"], self._carried.rigid_names, pose_message,
                         lambda seen: rows_of(*self._carried.rigid_poses()))

    def _touch_outputs(self, device: TouchedDevice) -> Iterator[Output]:
        """What sensors say of touches, and for the twin one of both: a force of zero, or a NaN as
        place, without a touch."""
        yield Output(TOPICS["~/touch/<touch>"], device.touch_names, partial(cables_message, "xyz"),
                     lambda _: rows_of(self._touches.displacements, self._touches.forces))
        if self._sends_force:
            yield Output(TOPICS["<twin>/touch_force/<touch>"], device.touch_names, wrench_message,
                         lambda _: rows_of(self._touches.forces))
        else:
            yield Output(TOPICS["<twin>/touch_position/<touch>"], device.touch_names, point_message,
                         lambda _: rows_of(np.where(
                             self._touches.is_touched[:, None], self._touches.points, np.nan)))

    def _take_pose(self, name: str, message: PoseStamped) -> Refusal | None:
        arrival = self.arrival(message.header)
        refusal = self.poses.accept(name, *read_pose(message), arrival)
        if refusal is None:
            came = arrival.time - max(0.0, arrival.age)
            self._carried.apply_pose(name, *self.poses.newest[name], came)
        return refusal

    def take(self, message: JointState) -> Refusal | None:
        """Takes a command of the twin; gives why it is refused.

        Args:
            message: The command.
        """
        if not (message.effort if self._follows_efforts else message.position):
            return self.refusals.add(Refusal.WRONG_SIZE)
        arrival = self.arrival(message.header)
        refusal = self._commands.accept(message.name, message.position, message.effort, arrival)
        if refusal is None:
            # The message may have waited for the step to end; a real robot would not have waited.
            given = self._commands.efforts if self._follows_efforts else self._commands.setpoints
            self.device.apply(given, arrival.time - max(0.0, arrival.age))
        return refusal

    def work(self, now: float) -> None:
        """Measures, and publishes all measurements with the same stamp.

        Args:
            now: Time on the monotonic clock [s].
        """
        stamp = stamp_of(self.stamp)
        reading = self.device.read(now)
        header = Header(stamp=stamp, frame_id=self._frame)
        if isinstance(self.device, TouchedDevice) and self.device.touch_names:
            # Once a tick: all that is told of touches is of the same moment.
            self._touches = self.device.touches()
        for output, publishers in self._outputs:
            rows = output.read(reading)
            for index, publisher in publishers.items():
                publisher.publish(output.make(*rows[index], header))
