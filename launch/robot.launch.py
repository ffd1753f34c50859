"""Starts a robot: its twin, the simulated device and a target; and RViz, if wanted.

    ros2 launch softrobot_twin robot.launch.py robot:=trunk rviz:=true
    ros2 launch softrobot_twin robot.launch.py namespace:=/lab/left frame_id:=left/base_link

A twin of a device starts disabled: ``ros2 service call /twin/enable std_srvs/srv/SetBool '{data:
true}'``, with a namespace ``/lab/left/twin/enable``. All ends when the twin ends.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "softrobot_twin"
# Name, default and description of each argument.
ARGUMENTS = (
    ("robot", "diamond", "Robot whose parameter file in config/ is used"),
    ("parameters", "", "Parameter file in place of that of the robot"),
    ("namespace", "", "Namespace of all nodes, such as /lab/left"),
    ("frame_id", "", "Frame of all positions, in place of that of the parameter file"),
    ("tf_prefix", "", "Before the frames of bodies and effectors, such as left/"),
    ("record", "", "File of the run, such as run.mcap, for replay"),
    ("use_sim_time", "false", "true: the ticks of all nodes follow /clock"),
    ("view", "false", "true: show the twin in rerun, for viewers on this machine"),
    ("view_port", "9876", "Port of that view; each robot needs its own"),
    ("device", "true", "false: no simulated device, because the hardware's driver runs elsewhere"),
    ("target", "true", "false: no target, because targets come from elsewhere"),
    ("rviz", "false", "true: start RViz with the markers of the twin"),
)
YES = ("true", "1", "yes", "on")
NO = ("false", "0", "no", "off")


def is_true(name, text):
    """Whether a word of an argument means yes."""
    if text.lower() not in (*YES, *NO):
        raise RuntimeError(f"{name}:={text}: must be true or false")
    return text.lower() in YES


def parameter_file(share, robot, own):
    """The parameter file; nodes would tell only one after the other that there is none."""
    if own:
        if not Path(own).is_file():
            raise RuntimeError(f"parameters:={own}: there is no such file")
        return own
    robots = sorted(path.stem for path in (share / "config").glob("*.yaml"))
    if robot not in robots:
        raise RuntimeError(f"robot:={robot}: must be one of {', '.join(robots)}")
    return str(share / "config" / f"{robot}.yaml")


def start(context):
    """The nodes, for the values of the arguments."""
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    on = {name: is_true(name, given[name])
          for name in ("use_sim_time", "view", "device", "target", "rviz")}  # fmt: skip
    if not given["view_port"].isdecimal():
        raise RuntimeError(f"view_port:={given['view_port']}: must be a whole number")
    share = Path(get_package_share_directory(PACKAGE))
    file = parameter_file(share, given["robot"], given["parameters"])
    # What is not given is left to the file.
    texts = {name: given[name] for name in ("frame_id", "tf_prefix", "record") if given[name]}
    simulated = {"use_sim_time": True} if on["use_sim_time"] else {}
    common = {name: texts[name] for name in ("frame_id",) if name in texts} | simulated
    own = {"view": on["view"], "view_port": int(given["view_port"]), **texts}
    extra = {"twin": {**common, **own}, "device": common, "target": common}
    wanted = {"twin": True, "device": on["device"], "target": on["target"]}
    nodes = [
        Node(
            package=PACKAGE, executable=name, name=name, namespace=given["namespace"] or None,
            output="screen", parameters=[file, extra[name]] if extra[name] else [file],
            on_exit=Shutdown(reason="the twin ended") if name == "twin" else None,
        )
        for name in ("twin", "device", "target") if wanted[name]
    ]  # fmt: skip
    if on["rviz"]:
        frame = given["frame_id"] or "base_link"
        nodes.append(Node(
            package="rviz2", executable="rviz2", name="rviz", namespace=given["namespace"] or None,
            arguments=["-d", str(share / "config" / "rviz" / "robot.rviz"), "-f", frame],
            # A relative name is below the namespace.
            remappings=[("/twin/visualization", "twin/visualization")],
            parameters=[simulated] if simulated else None,
        ))  # fmt: skip
    return nodes


def generate_launch_description():
    """What ``ros2 launch`` starts."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, default, description in ARGUMENTS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])
