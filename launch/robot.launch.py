"""Starts a robot: its twin, the simulated device and a target; and RViz, if wanted.

    ros2 launch softrobot_twin robot.launch.py robot:=trunk rviz:=true
    ros2 launch softrobot_twin robot.launch.py namespace:=/lab/left frame_id:=left/base_link

A twin of a device starts disabled: ``ros2 service call /twin/enable std_srvs/srv/SetBool '{data:
true}'``, with a namespace ``/lab/left/twin/enable``.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
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
    ("view", "false", "true: show the twin in rerun, for viewers on this machine"),
    ("view_port", "9876", "Port of that view; each robot needs its own"),
    ("device", "true", "false: no simulated device, because the hardware's driver runs elsewhere"),
    ("target", "true", "false: no target, because targets come from elsewhere"),
    ("rviz", "false", "true: start RViz with the markers of the twin"),
)


def is_true(text):
    """Whether a word of an argument means yes."""
    return text.lower() in ("true", "1", "yes", "on")


def start(context):
    """The nodes, for the values of the arguments."""
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    share = Path(get_package_share_directory(PACKAGE))
    file = given["parameters"] or str(share / "config" / f"{given['robot']}.yaml")
    # Left out where nothing is given: a launch file cannot pass an empty text.
    common = {"frame_id": given["frame_id"]} if given["frame_id"] else {}
    prefix = {"tf_prefix": given["tf_prefix"]} if given["tf_prefix"] else {}
    view = {"view": is_true(given["view"]), "view_port": int(given["view_port"])}
    extra = {"twin": {**common, **prefix, **view}, "device": common, "target": common}
    wanted = {"twin": True, "device": is_true(given["device"]),
              "target": is_true(given["target"])}  # fmt: skip
    nodes = [
        Node(
            package=PACKAGE, executable=name, name=name, namespace=given["namespace"] or None,
            output="screen", parameters=[file, extra[name]] if extra[name] else [file],
        )
        for name in ("twin", "device", "target") if wanted[name]
    ]  # fmt: skip
    if is_true(given["rviz"]):
        frame = given["frame_id"] or "base_link"
        nodes.append(Node(
            package="rviz2", executable="rviz2", name="rviz", namespace=given["namespace"] or None,
            arguments=["-d", str(share / "config" / "rviz" / "robot.rviz"), "-f", frame],
            # A relative name is below the namespace.
            remappings=[("/twin/visualization", "twin/visualization")],
        ))  # fmt: skip
    return nodes


def generate_launch_description():
    """What ``ros2 launch`` starts."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, default, description in ARGUMENTS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])
