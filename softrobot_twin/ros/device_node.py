"""Node of a simulated robot: receives setpoints, publishes measured ones, and markers."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.control.actuator_names import ActuatorNames
from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.device import (
    CarriedDevice,
    Device,
    PressurisedDevice,
    TouchedDevice,
    WoundDevice,
)
from softrobot_twin.control.fingertip import Presses
from softrobot_twin.control.inputs import ActuatorInput, PoseInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
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
from softrobot_twin.ros.parameters import DEVICE, Entry, declare
from softrobot_twin.ros.scene_file import find_scene_file
from softrobot_twin.ros.ticking_node import TickingNode
from softrobot_twin.ros.topics import DEVICE_TOPICS as TOPICS
from softrobot_twin.ros.topics import open_publisher, open_publishers
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
        self._sends_force = values["device_touch_sends"] == "force"
        settings = LoopSettings(
            message_timeout=values["message_timeout"], future_tolerance=values["future_tolerance"]
        )
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
        flaws = DeviceFlaws(
            delay=values["device_delay"],
            servo_rate=values["device_servo_rate"],
            marker_noise=values["device_marker_noise"],
            seed=values["device_seed"],
            valve_lag=values["device_valve_lag"],
            flow_limit=values["device_flow_limit"],
            pressure_noise=values["device_pressure_noise"],
            angle_rate=values["device_angle_rate"],
        )
        path = find_scene_file(str(values["device_scene_file"]), "device_scene_file")
        simulation = Simulation.from_scene_file(path)
        for note in simulation.notes:
            self.get_logger().warning(note)
        simulation.warm_up()
        self.get_logger().info(f"scene: {path}, {simulation.node_count} nodes")
        presses = None
        if values["device_touch"]:
            presses = Presses(
                values["device_touch"], values["device_touch_depth"], values["device_touch_period"],
                values["device_touch_direction"],
            )  # fmt: skip
        return SimulatedDevice(simulation, flaws, float(values["ambient_pressure"]), presses)

    def _open(self, twin: str) -> None:
        self.cables = open_publisher(self, TOPICS["<twin>/measured_cables"], "", twin)
        self._markers = open_publisher(self, TOPICS["<twin>/markers"], "", twin)
        wound = self.device.pulleys if isinstance(self.device, WoundDevice) else None
        self._pulleys = wound if wound is not None and wound.count else None
        if self._pulleys is not None:
            self._angles = open_publisher(self, TOPICS["<twin>/measured_angles"], "", twin)
        measured = self.device.cavity_names if isinstance(self.device, PressurisedDevice) else ()
        pressures = TOPICS["<twin>/measured_pressures/<cavity>"]
        self._pressures = {
            self.device.actuator_names.index(name): open_publisher(self, pressures, name, twin)
            for name in measured
        }
        effectors, topic = self.device.effector_names, TOPICS["~/effectors/<effector>"]
        self._effectors = open_publishers(self, topic, effectors)
        self._open_touches(twin)
        carried = self._carried
        bodies = () if carried is None else carried.rigid_names
        self._bodies = open_publishers(self, TOPICS["~/bodies/<rigid body>"], bodies)
        topic, names = TOPICS["<twin>/cables"], self.device.actuator_names
        commands = [self.listen(topic, self.take, self.refusals, "", twin, names)]
        topic = TOPICS["<twin>/poses/<guided body>"]
        for name in () if carried is None else carried.guided_names:
            take = partial(self._take_pose, name)
            commands.append(self.listen(topic, take, self.poses.refusals, name, twin))
        angles = () if self._pulleys is None else (self._angles,)
        self.watch_topics((self.cables, *angles, self._markers, *self._pressures.values(),
                           *(one for _, one in self._touches), *commands))

    def _open_touches(self, twin: str) -> None:
        names = self.device.touch_names if isinstance(self.device, TouchedDevice) else ()
        topic = "touch_force" if self._sends_force else "touch_position"
        self._touches = [
            (open_publisher(self, TOPICS["~/touch/<touch>"], name),
             open_publisher(self, TOPICS[f"<twin>/{topic}/<touch>"], name, twin))
            for name in names
        ]  # fmt: skip

    def _publish_touches(self, header: Header) -> None:
        """Publishes what sensors say of touches, and for the twin one of both: a force of zero, or
        a NaN as place, without a touch."""
        touches = self.device.touches()
        for index, (both, one) in enumerate(self._touches):
            both.publish(cables_message(
                "xyz", touches.displacements[index], touches.forces[index], header))
            if self._sends_force:
                one.publish(wrench_message(touches.forces[index], header))
            else:
                is_touched = touches.is_touched[index]
                place = touches.points[index] if is_touched else np.full(3, np.nan)
                one.publish(point_message(place, header))

    def _take_pose(self, name: str, message: PoseStamped) -> Refusal | None:
        arrival = self.arrival(message.header)
        refusal = self.poses.accept(name, *read_pose(message), arrival)
        if refusal is None:
            came = arrival.time - max(0.0, arrival.age)
            self._carried.apply_pose(name, *self.poses.newest[name], came)
        return refusal

    def take(self, message: JointState) -> Refusal | None:
        """Takes a command of the twin; gives why it is refused."""
        if not message.position:
            return self.refusals.add(Refusal.WRONG_SIZE)
        arrival = self.arrival(message.header)
        refusal = self._commands.accept(message.name, message.position, message.effort, arrival)
        if refusal is None:
            # The message may have waited for the step to end; a real robot would not have waited.
            self.device.apply(self._commands.setpoints, arrival.time - max(0.0, arrival.age))
        return refusal

    def work(self, now: float) -> None:
        """Measures, and publishes all measurements with the same stamp."""
        stamp = stamp_of(self.stamp)
        reading = self.device.read(now)
        header = Header(stamp=stamp, frame_id=self._frame)
        names = self.device.actuator_names
        self.cables.publish(cables_message(names, reading.setpoints, reading.efforts, header))
        if self._pulleys is not None:
            wound = self._pulleys
            self._angles.publish(cables_message(
                wound.names, wound.angles(reading.setpoints), wound.torques(reading.efforts), header
            ))  # fmt: skip
        for index, publisher in self._pressures.items():
            pressure = self._ambient_pressure + reading.efforts[index]
            publisher.publish(pressure_message(pressure, header, self.device.pressure_variance))
        self._markers.publish(
            markers_message(reading.marker_ids, reading.marker_positions, header)
        )
        for publisher, position in zip(self._effectors, reading.effector_positions, strict=True):
            publisher.publish(point_message(position, header))
        if self._touches:
            self._publish_touches(header)
        if self._bodies:
            poses = zip(*self._carried.rigid_poses(), strict=True)
            for publisher, pose in zip(self._bodies, poses, strict=True):
                publisher.publish(pose_message(*pose, header))
