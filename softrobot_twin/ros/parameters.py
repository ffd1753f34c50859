"""The parameters of the three nodes: one table, each with a description, a unit and a range."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from difflib import get_close_matches
from enum import Enum
from typing import NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from softrobot_twin.control.cavity_pressures import STANDARD_ATMOSPHERE
from softrobot_twin.control.loop_settings import SETTING_NAMES, LoopSettings, Mode, settings_of
from softrobot_twin.control.simulated_device import DeviceFlaws, Presses
from softrobot_twin.control.target_path import ClosedCurve
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.thread_priority import Priority

_OF_RCLPY = ("qos_overrides.", "start_type_description_service")


class Entry(NamedTuple):
    """One parameter.

    Attributes:
        name: Its name.
        default: Default value; its type is the parameter's type.
        description: One sentence.
        unit: Unit of the value, or an empty string.
        low: Least value allowed, or None for no range.
        high: Greatest value allowed.
        choices: Allowed words, or empty.
        read_only: True when it can be set only at the start.
    """

    name: str
    default: object
    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False

    @property
    def is_switch(self) -> bool:
        """Whether it is ``on`` or ``off``, which YAML reads as truth values."""
        return "on" in self.choices

    def in_words(self, value: object) -> object:
        """A value, a truth value of a switch as its word.

        Args:
            value: The value.
        """
        return ("off", "on")[value] if self.is_switch and isinstance(value, bool) else value

    def descriptor(self) -> ParameterDescriptor:
        """Descriptor that ``ros2 param describe`` shows and rclpy checks."""
        description = f"{self.description} [{self.unit}]" if self.unit else self.description
        descriptor = ParameterDescriptor(name=self.name, description=description,
                                         read_only=self.read_only, dynamic_typing=self.is_switch)
        if self.choices:
            descriptor.additional_constraints = "one of " + ", ".join(self.choices)
        if self.low is not None and isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.low, to_value=self.high, step=0.0)]
        elif self.low is not None:
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)]
        return descriptor

    def check(self, value: object) -> None:
        """Checks what a descriptor cannot express.

        Args:
            value: The value.

        Raises:
            ParameterError: The value is not one of the choices, or not finite.
        """
        if self.choices and value not in self.choices:
            raise ParameterError(self.name, value, self.unit, f"must be one of {self.choices}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(self.name, value, self.unit, "must be finite")


def declare(node: Node, table: Iterable[Entry]) -> dict[str, object]:
    """Declares every parameter of a table.

    Args:
        node: The node.
        table: The parameters.

    Returns:
        Their values by name; arrays as tuples.

    Raises:
        ParameterError: A parameter file gives one of them a wrong type or an invalid value.
    """
    values = {}
    for entry in table:
        try:
            parameter = node.declare_parameter(entry.name, entry.default, entry.descriptor())
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            why = (str(error) if isinstance(error, InvalidParameterValueException)
                   else f"must be of the type of {entry.default!r} ({error})")  # fmt: skip
            given = given_values(node).get(entry.name)
            raise ParameterError(entry.name, given, entry.unit, why) from None
        values[entry.name] = entry.in_words(plain(parameter))
        entry.check(values[entry.name])
    return values


def plain(parameter: Parameter) -> object:
    """Value of a parameter, an array as a tuple.

    Args:
        parameter: The parameter.
    """
    value = parameter.value
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__"):
        return value
    return tuple(value)


def given_values(node: Node) -> dict[str, object]:
    """Values from parameter files and the command line, declared by the node or not.

    Args:
        node: The node.
    """
    # rclpy ignores undeclared parameters silently and has no public function to list them.
    overrides: dict[str, Parameter] = getattr(node, "_parameter_overrides", {})
    return {name: plain(parameter) for name, parameter in overrides.items()}


def unknown_parameters(node: Node, tables: Iterable[Iterable[Entry]]) -> list[str]:
    """Lists parameters that were given but that none of the nodes sharing the file declares.

    Args:
        node: The node.
        tables: The parameters of all nodes that share a file.

    Returns:
        One sentence for each, with the most similar known name.
    """
    known = {entry.name for table in tables for entry in table}
    # rclpy itself declares some.
    unknown = [name for name in sorted(given_values(node).keys() - known)
               if name != "use_sim_time" and not name.startswith(_OF_RCLPY)]  # fmt: skip
    return [f"parameter {name} is unknown and ignored{similar(name, known)}" for name in unknown]


def similar(name: str, known: Iterable[str]) -> str:
    """A hint at the known name most similar to an unknown one; empty when none is similar.

    Args:
        name: The unknown name.
        known: The known ones.
    """
    near = get_close_matches(name.replace(".", "_"), sorted(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _settings(kind: type, prefix: str = "", **defaults: object) -> dict[str, Entry]:
    """Parameters of settings by the names of the fields, which may be set while the node runs.

    Args:
        kind: The settings, a dataclass with fields of `setting`.
        prefix: Begin of the names of the parameters.
        **defaults: Defaults in place of those of the fields.
    """
    found = {}
    for one in fields(kind):
        if one.metadata:
            default, choices = defaults.get(one.name, one.default), ()
            if isinstance(default, Enum):
                default, choices = default.value, tuple(choice.value for choice in type(default))
            default = list(default) if isinstance(default, tuple) else default
            meaning, unit, least, most = one.metadata.values()
            found[one.name] = Entry(prefix + one.name, default, meaning, unit, least, most, choices)
    return found


def _fixed(*entries: Entry) -> tuple[Entry, ...]:
    """Parameters that can be set only at the start."""
    return tuple(entry._replace(read_only=True) for entry in entries)


_LOOP = _settings(LoopSettings)
COMMON = (
    *_fixed(Entry("frame_id", "base_link", "Frame of all positions.")),
    _LOOP.pop("message_timeout"), _LOOP.pop("future_tolerance"),
    *_fixed(Entry(
        "ambient_pressure", STANDARD_ATMOSPHERE, "Absolute pressure around the robot.", "Pa", 1.0, 2e8)),
)

RUNTIME = tuple(_LOOP.values())

_SCENE = (
    Entry("scene_file", "scenes/diamond.yaml", "Path of the scene, perhaps relative to the working"
                                               " directory, this file or the package's config "
                                               "folder."),
    Entry("scene_changes", [""], "Other values, such as body.material.young_modulus=1.5e5."),
)

TWIN = COMMON + RUNTIME + _fixed(
    *_SCENE,
    Entry("mode", Mode.INVERSE.value, "Driven by targets, or by setpoints and efforts.",
          choices=tuple(mode.value for mode in Mode)),
    Entry("use_device", False, "Drive a device: the twin starts disabled."),
    Entry("mesh_error", True, "Estimate the error of the mesh, in another process."),
    Entry("reduction_error", True, "Compare reduced bodies with the full model, in another "
          "process."),
    Entry("calibrate_fit", [""], "Keys that ~/calibrate fits; [''] for its choice."),
    Entry("observer", False, "Find unknown forces, also of a scene without observer."),
    Entry("velocity_effector", "",
          "Effector that target_velocity moves; empty for the first."),
    Entry("priority", Priority.REAL_TIME.value, "Of the ticks: real-time, a negative nice value, "
                                                "or none.",
          choices=tuple(priority.value for priority in Priority)),
    Entry("view", False, "Show the twin in rerun."),
    Entry("view_port", 9876, "Port for viewers; 0 selects a free one.", "", 0, 65535),
    Entry("view_every", 1, "One of so many ticks is shown.", "ticks", 1, 100000),
    Entry("view_spawn", False, "Open a viewer."),
    Entry("view_force_scale", 0.1, "Length of an arrow by its force.", "m/N", 1e-6, 1000.0),
    Entry("visualization_rate", 10.0,
          "Messages on ~/visualization; 0 for none.",
          "Hz", 0.0, 1000.0),
    Entry("tf", "auto",
          "Publish /tf while somebody receives it; on: tell when tf2_msgs is missing.",
          choices=("auto", "on", "off")),
    Entry("tf_prefix", "",
          "Before the names of frames, such as left/."),
    Entry("base_frame", "",
          "Frame of /tf that a moving_base follows."),
    Entry("tf_base_frame", "", "Frame in which frame_id is fixed, such as world."),
    Entry("tf_base_pose", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
          "Where frame_id is in it: position, and quaternion x, y, z, w.", "m"),
    Entry("record_file", "", "File of the view, .rrd. It grows without bound: see record_every."),
    Entry("record_every", 5, "One of so many shown ticks is recorded.", "frames", 1,
          100000),
    Entry("record", "", "File of the whole run, .mcap, for `replay`. An existing file is refused."),
)

_TWIN_NAME = Entry("twin", "twin", "Name of the twin.")

DEVICE = COMMON + _fixed(
    _TWIN_NAME,
    Entry("device_scene_file", "scenes/diamond_device.yaml",
          "Path of the simulated robot's scene."),
    Entry("device_scene_changes", [""], "Other values of its entries, as scene_changes."),
    Entry("device_rate", 50.0, "Measurements per second.", "Hz", 0.1, 2000.0),
    Entry("device_follows", "setpoints", "Setpoints, such as lengths, or efforts, such as tensions.",
          choices=("setpoints", "efforts")),
    *_settings(DeviceFlaws, "device_", delay=0.02, valve_lag=0.05, pressure_noise=20.0, marker_noise=0.0002,
               seed=1).values(),
    Entry("device_touch", "", "Touch where a simulated fingertip presses."),
    *_settings(Presses, "device_touch_").values(),
    Entry("device_touch_sends", "position",
          "The place of the touched point, or the force.",
          choices=("position", "force")),
    Entry("device_calibration_poses", 0, "Poses by which a demo calibrates the twin for a last run.", "", 0, 200),
)

TARGET = _fixed(
    COMMON[0], _TWIN_NAME, *_SCENE,
    Entry("target_effector", "tip",
          "Effector that receives targets, or that the demo compares."),
    Entry("target_path", "circle", "circle, lemniscate, or a targets file."),
    Entry("target_sequence", [""],
          "Paths in place of target_path, one after the other."),
    Entry("target_sequence_time", 15.0, "Time for each of these paths.", "s", 0.001, 86400.0),
    Entry("target_center", [0.0, 0.0, 0.0], "Centre of circle and lemniscate.", "m"),
    *_settings(ClosedCurve, "target_").values(),
    Entry("target_plane", "xy", "Plane of circle and lemniscate.", choices=("xy", "xz", "yz")),
    Entry("target_ramp_time", 2.0, "Time of the way onto a path.", "s", 0.0, 3600.0),
    Entry("target_ahead", 0.0, "Time for which the path is sent ahead (`control`); 0 sends a "
                               "point.", "s", 0.0, 10.0),
    Entry("target_rate", 50.0, "Targets per second.", "Hz", 0.1, 2000.0),
    Entry("target_actuator", "", "Actuator or motor that is commanded meanwhile, to and fro."),
    Entry("target_setpoints", [0.0, 0.0], "Its setpoint at first, and after half a period.",
          "m, Pa or m³"),
    Entry("target_setpoint_period", 10.0, "Time of a movement to and fro.", "s", 0.001, 86400.0),
    Entry("target_stiffness", [0.0, 0.0], "Wanted stiffness at first, and after half a period.", "N/m"),
    Entry("target_stiffness_axis", "z", "Axis of that stiffness.", choices=("x", "y", "z")),
    Entry("target_stiffness_period", 20.0, "Time of that stiffness to and fro.", "s", 0.001, 86400.0),
    Entry("target_commands", "", "Commands file, played over and over, for mode direct."),
    Entry("target_beginning", "", "Commands file, played once before the path."),
)

ALL_TABLES = (TWIN, DEVICE, TARGET)


def loop_settings(values: Mapping[str, object]) -> LoopSettings:
    """The loop's settings among a node's parameters.

    Args:
        values: Parameter values by name.

    Raises:
        ParameterError: A value cannot be used.
    """
    return settings_of({name: values[name] for name in SETTING_NAMES})
