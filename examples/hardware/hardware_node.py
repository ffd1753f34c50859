"""The device node of a robot with servos or pressure regulators: `DeviceNode` of the package around
`ServoDevice` or `RegulatorDevice`.

    python hardware_node.py --ros-args --params-file PARAMETERS -p servos_file:=servos.yaml
    python hardware_node.py --ros-args --params-file PARAMETERS -p regulators_file:=regulators.yaml

All that it shares with the simulated device is the package's: topics, checks of messages, clocks,
the watch over the ROS graph. New are servos or regulators, and that a measurement that fails is not
published.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping

from regulators import RegulatorDevice, read_regulators
from servo_bus import BusError, HardwareAlert
from servos import ServoDevice, read_servos

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.node_help import help_text
from softrobot_twin.ros.parameters import DEVICE, Entry
from softrobot_twin.ros.process import run_node

_WARN_EVERY = 2.0


class NoHardware(SoftRobotTwinError):
    """The servos or regulators cannot be used."""


class HardwareNode(DeviceNode):
    """Connects servos or regulators to the topics of a twin.

    Attributes:
        bus_errors: Number of measurements that failed.
    """

    own_parameters = (
        Entry("servos_file", "servos.yaml", "File that describes the servos and their pulleys.",
              read_only=True),
        Entry("regulators_file", "", "File that describes pressure regulators, in place of servos.",
              read_only=True),
    )  # fmt: skip
    device: ServoDevice | RegulatorDevice | None = None
    bus_errors = 0

    def make_device(self, values: Mapping[str, object]) -> ServoDevice | RegulatorDevice:
        """Finds the servos or regulators; see `DeviceNode.make_device`."""
        self._measured = float("-inf")
        file, read, kind = str(values["servos_file"]), read_servos, ServoDevice
        if values["regulators_file"]:
            file, read, kind = str(values["regulators_file"]), read_regulators, RegulatorDevice
        self._description = read(file)
        try:
            return kind(self._description)
        except BusError as error:
            raise NoHardware(str(error)) from error

    def work(self, now: float) -> None:
        """Measures and publishes; what cannot be measured is not published, so that the twin
        notices it as a lost device."""
        try:
            super().work(now)
            self._measured = now
        except BusError as error:
            self.bus_errors += 1
            self.get_logger().error(f"bus: {error}", throttle_duration_sec=_WARN_EVERY)
            is_long = now - self._measured > self._description.command_timeout
            if is_long or isinstance(error, HardwareAlert):
                self._recover()

    def _recover(self) -> None:
        try:
            self.device.recover()
        except BusError:
            return
        self.get_logger().warning(self.device.recovered, throttle_duration_sec=_WARN_EVERY)

    def after_work(self, now: float) -> None:
        """Tells why the servos stand still, or the cavities are vented."""
        if self.device.trouble:
            self.get_logger().warning(self.device.trouble, throttle_duration_sec=_WARN_EVERY)

    def destroy_node(self) -> None:
        """Switches the torque off, or vents, then destroys the node."""
        device, self.device = self.device, None
        if device is not None:
            for problem in device.close():
                self.get_logger().error(problem)
        super().destroy_node()


if __name__ == "__main__":
    table = (*DEVICE, *HardwareNode.own_parameters)
    sys.exit(run_node("hardware_node.py", lambda: HardwareNode,
                      about=lambda: help_text("hardware_node.py", [__doc__], table)))  # fmt: skip
