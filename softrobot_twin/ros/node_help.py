"""Texts of ``twin --help``, ``device --help`` and ``target --help``."""

from __future__ import annotations

from textwrap import fill

from softrobot_twin.ros.parameters import DEVICE, TARGET, TWIN, Entry

_TABLES: dict[str, tuple[Entry, ...]] = {"twin": TWIN, "device": DEVICE, "target": TARGET}
_ABOUT = {
    "twin": """\
Runs the simulation of a soft robot in real time: targets in, cable lengths and
pressures out. Pressures are absolute in FluidPressure, gauge in JointState;
motors of hinges have angles and torques there, in rad and N m.

  in    ~/target/<effector>   geometry_msgs/PointStamped   m
        ~/target_pose/<effector>  geometry_msgs/PoseStamped  m; effectors with orientation
        ~/target_stiffness/<effector>  geometry_msgs/Vector3Stamped  N/m; effectors with stiffness
        ~/target_velocity     geometry_msgs/Twist          m/s
        ~/command/cables      sensor_msgs/JointState       m or N; cavities Pa (gauge) or m³
        ~/command/angles      sensor_msgs/JointState       rad, of pulleys
        ~/command/pressures/<cavity>   sensor_msgs/FluidPressure  Pa (absolute)
        ~/command/pose/<body> geometry_msgs/PoseStamped    m
        ~/measured_cables     sensor_msgs/JointState       m, N; cavities Pa (gauge) or m³
        ~/measured_angles     sensor_msgs/JointState       rad, of pulleys
        ~/measured_pressures/<cavity>  sensor_msgs/FluidPressure  Pa (absolute)
        ~/touch_force/<touch>     geometry_msgs/WrenchStamped  N, on the robot; 0 ends a touch
        ~/touch_position/<touch>  geometry_msgs/PointStamped   m, touched point; NaN ends it
        ~/markers             sensor_msgs/PointCloud2      m
  out   ~/cables              sensor_msgs/JointState       m, N; cavities Pa (gauge) or m³
        ~/angles              sensor_msgs/JointState       rad, N m; of pulleys
        ~/pressures/<cavity>  sensor_msgs/FluidPressure    Pa (absolute)
        ~/effectors/<effector>, ~/effector_poses/<effector>, ~/predicted_markers,
        ~/bodies/<body>, ~/poses/<body>, ~/contacts, /diagnostics
        ~/touch/<touch>       sensor_msgs/JointState       m and N: displacement, force
        ~/stiffness/<effector>   geometry_msgs/Vector3Stamped  N/m; effectors with stiffness
        ~/compliance/<effector>  std_msgs/Float64MultiArray  m/N, after actuation
        ~/jacobian/<effector>    std_msgs/Float64MultiArray  by actuator, see its labels
  services  ~/enable (std_srvs/SetBool), ~/reset (std_srvs/Trigger)""",
    "device": """\
A simulated robot: receives a twin's cable lengths and pressures, publishes measured ones and
markers. Pressures are absolute in FluidPressure, gauge in JointState.

  in    <twin>/cables            sensor_msgs/JointState     m; cavities Pa (gauge) or m³
        <twin>/poses/<body>      geometry_msgs/PoseStamped  m
  out   <twin>/measured_cables   sensor_msgs/JointState     m, N; cavities Pa (gauge) or m³
        <twin>/measured_pressures/<cavity>  sensor_msgs/FluidPressure  Pa (absolute)
        <twin>/markers           sensor_msgs/PointCloud2    m
        ~/effectors/<effector>, ~/bodies/<body>
        ~/touch/<touch>          sensor_msgs/JointState     m and N; with device_touch
        <twin>/touch_position/<touch>  geometry_msgs/PointStamped  m; or touch_force, N""",
    "target": """\
Publishes targets along a path for an effector of a twin.

  in    <twin>/effectors/<effector>  geometry_msgs/PointStamped  m, start point
  out   <twin>/target/<effector>     geometry_msgs/PointStamped  m
        <twin>/target_stiffness/<effector>  geometry_msgs/Vector3Stamped  N/m; target_stiffness""",
}


def help_of(name: str) -> str:
    """Usage, topics and parameters of a node.

    Args:
        name: ``twin``, ``device`` or ``target``.
    """
    usage = (f"usage: {name} [-h] [--ros-args [--params-file FILE] [-p NAME:=VALUE ...]"
             " [-r FROM:=TO ...]]")
    lines = [usage, "", _ABOUT[name], "",
             "Parameters (-p NAME:=VALUE; * can be set while it runs):"]
    for entry in _TABLES[name]:
        unit = f" {entry.unit}" if entry.unit else ""
        star = "" if entry.read_only else " *"
        choices = f" One of {', '.join(entry.choices)}." if entry.choices else ""
        lines.append(f"  {entry.name}{star} (default {_shown(entry.default)}{unit})")
        lines.append(fill(entry.description + choices, 96, initial_indent=" " * 6,
                          subsequent_indent=" " * 6))
    lines += ["", "A double needs its point: rate:=30.0. use_sim_time:=true ticks on /clock.",
              "Exit codes: 0 after SIGINT or SIGTERM, 2 when the node cannot start."]
    return "\n".join(lines)


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, str) else str(value)
