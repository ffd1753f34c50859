"""The parameters of the three nodes. One file serves them all: no name has two meanings."""

from __future__ import annotations

from collections.abc import Mapping

from softrobot_twin.control.loop_settings import Mode
from softrobot_twin.control.loop_settings import SETTING_NAMES, LoopSettings, WhenLost
from softrobot_twin.ros.parameter_table import Entry
from softrobot_twin.ros.thread_priority import Priority

_LOST = tuple(choice.value for choice in WhenLost)
_DEFAULTS = LoopSettings()

COMMON = (
    Entry("frame_id", "base_link", "The one frame of all positions.", read_only=True),
    Entry("message_timeout", _DEFAULTS.message_timeout,
          "Messages stamped longer ago are refused; 0 accepts any age.", "s", 0.0, 60.0),
    Entry("future_tolerance", _DEFAULTS.future_tolerance,
          "Messages stamped further ahead are refused.", "s", 0.0, 60.0),
)

RUNTIME = (
    Entry("rate", _DEFAULTS.rate, "Ticks in a second.", "Hz", 0.1, 2000.0),
    Entry("deadline", _DEFAULTS.deadline,
          "Time that a step may take: the rest of it goes into more linearizations, and a stale "
          "factor keeps the tick where one would be late and that factor still makes progress; 0 "
          "for as many as the scene says.",
          "s", 0.0, 60.0),
    Entry("target_timeout", _DEFAULTS.target_timeout,
          "Without a target or command for so long the twin holds; 0 waits for ever.",
          "s", 0.0, 3600.0),
    Entry("velocity_timeout", _DEFAULTS.velocity_timeout,
          "A velocity counts for so long after it arrived.", "s", 0.01, 10.0),
    Entry("speed_limit", _DEFAULTS.speed_limit,
          "Greatest speed of a target that a velocity drives.", "m/s", 1e-6, 10.0),
    Entry("approach_speed", _DEFAULTS.approach_speed,
          "A far target is approached on a straight line at this speed; 0 goes as fast as the "
          "cables' rates allow, which may bend the way.", "m/s", 0.0, 10.0),
    Entry("workspace_min", list(_DEFAULTS.workspace_min),
          "Lower corner of the box that targets and poses are kept in.", "m"),
    Entry("workspace_max", list(_DEFAULTS.workspace_max), "Upper corner of that box.", "m"),
    Entry("closed_loop", _DEFAULTS.closed_loop,
          "Correct the targets by what the markers measure."),
    Entry("correction_gain", _DEFAULTS.correction_gain,
          "Integral gain of that correction.", "1/s", 0.0, 1000.0),
    Entry("correction_limit", _DEFAULTS.correction_limit,
          "Greatest length of the correction.", "m", 0.0, 1.0),
    Entry("marker_timeout", _DEFAULTS.marker_timeout,
          "Markers count as lost after so long without any.", "s", 0.001, 60.0),
    Entry("on_lost_markers", _DEFAULTS.on_lost_markers.value,
          "Without markers in closed loop: go on with the last correction, or hold.",
          choices=_LOST),
    Entry("device_timeout", _DEFAULTS.device_timeout,
          "The device counts as lost after so long without its lengths.", "s", 0.001, 60.0),
    Entry("on_lost_device", _DEFAULTS.on_lost_device.value,
          "Without the device's lengths: go on with the model alone, or hold.", choices=_LOST),
)

TWIN = COMMON + RUNTIME + (
    Entry("scene_file", "scenes/diamond.yaml",
          "Scene: absolute, or from the working directory, or from the package's config folder.",
          read_only=True),
    Entry("mode", Mode.INVERSE.value, "Driven by targets, or by cable lengths and tensions.",
          choices=tuple(mode.value for mode in Mode), read_only=True),
    Entry("use_device", False, "A device is driven: disabled at the start, and resynchronised "
          "with its measured lengths when enabled.", read_only=True),
    Entry("mesh_error", True, "Estimate what the mesh leaves out, in a process of the lowest "
          "priority.", read_only=True),
    Entry("velocity_effector", "", "Effector that target_velocity drives; empty for the first.",
          read_only=True),
    Entry("priority", Priority.REAL_TIME.value, "What the ticks ask the system for: real-time "
          "priority, a negative nice value, or nothing. What is not allowed is told.",
          choices=tuple(priority.value for priority in Priority), read_only=True),
    Entry("view", False, "Show the twin in rerun.", read_only=True),
    Entry("view_port", 9876, "Port that viewers join on this machine; 0 takes a free one.", "",
          0, 65535, read_only=True),
    Entry("view_every", 1, "Every so many ticks one is shown.", "ticks", 1, 100000,
          read_only=True),
    Entry("view_spawn", False, "Open a viewer.", read_only=True),
    Entry("view_force_scale", 0.1, "Length of the arrow of a contact force.", "m/N", 1e-6, 1000.0,
          read_only=True),
    Entry("record_file", "", "File to record the view into, .rrd; empty for none. It grows "
          "without bound: see record_every.", read_only=True),
    Entry("record_every", 5, "Of the ticks that are shown, every so many one is recorded.",
          "frames", 1, 100000, read_only=True),
)

_TWIN_NAME = Entry("twin", "/twin", "Name of the twin that is served.", read_only=True)

DEVICE = COMMON + (
    _TWIN_NAME,
    Entry("device_scene_file", "scenes/diamond_device.yaml",
          "Scene of the simulated robot, found like scene_file.", read_only=True),
    Entry("device_rate", 50.0, "Measurements in a second.", "Hz", 0.1, 2000.0, read_only=True),
    Entry("device_delay", 0.02, "From a command's arrival to its effect.", "s", 0.0, 10.0,
          read_only=True),
    Entry("device_servo_rate", 0.1, "How fast the servos wind.", "m/s", 1e-6, 10.0,
          read_only=True),
    Entry("device_marker_noise", 0.0002, "Standard deviation of each measured coordinate.", "m",
          0.0, 1.0, read_only=True),
    Entry("device_seed", 1, "Seed of the noise.", "", 0, 2**31 - 1, read_only=True),
)

TARGET = (
    COMMON[0],
    _TWIN_NAME,
    Entry("target_effector", "tip", "Effector that is given targets.", read_only=True),
    Entry("target_path", "circle", "circle, lemniscate, or a CSV file, found like scene_file, "
          "with the columns t,<effector>.x,<effector>.y,<effector>.z.", read_only=True),
    Entry("target_sequence", [""], "Paths that take turns in place of target_path; [''] for none.",
          read_only=True),
    Entry("target_sequence_time", 15.0, "Time of each turn.", "s", 0.001, 86400.0,
          read_only=True),
    Entry("target_center", [0.0, 0.0, 0.0], "Centre of circle and lemniscate.", "m",
          read_only=True),
    Entry("target_radius", 0.01, "Radius of the circle, half the width of the lemniscate.", "m",
          1e-6, 10.0, read_only=True),
    Entry("target_period", 10.0, "Time of one round.", "s", 0.001, 86400.0, read_only=True),
    Entry("target_plane", "xy", "Plane of circle and lemniscate.", choices=("xy", "xz", "yz"),
          read_only=True),
    Entry("target_ramp_time", 2.0, "Time to come softly onto a path.", "s", 0.0, 3600.0,
          read_only=True),
    Entry("target_rate", 50.0, "Targets in a second.", "Hz", 0.1, 2000.0, read_only=True),
)

ALL_TABLES = (TWIN, DEVICE, TARGET)


def loop_settings(values: Mapping[str, object]) -> LoopSettings:
    """The loop's settings among a node's parameters.

    Args:
        values: Parameter values by name.

    Raises:
        ParameterError: A value cannot be used.
    """
    settings = {name: values[name] for name in SETTING_NAMES}
    for name in ("on_lost_markers", "on_lost_device"):
        settings[name] = WhenLost(settings[name])
    return LoopSettings(**settings)
