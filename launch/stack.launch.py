"""The controller of a vehicle in one process: mpc and reference, and the bridge to a flight stack.

ros2 launch quad_mpc_ros stack.launch.py config:=my_vehicle.yaml
ros2 launch quad_mpc_ros stack.launch.py bridge:=px4 config:=my_vehicle.yaml namespace:=uav1
As bridge.launch.py, with a process for each node, it flies nothing until asked for.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import Node

from launch import LaunchDescription
from quad_mpc_ros.ros.bridges.registry import bridge_packages

PACKAGE = "quad_mpc_ros"
SUFFIX = "_bridge"  # of the node


def generate_launch_description() -> LaunchDescription:
    """Return the one process."""
    default_config = Path(get_package_share_directory(PACKAGE), "config", "default.yaml")
    bridge = LaunchConfiguration("bridge")
    common = {
        "package": PACKAGE,
        "executable": "stack_node",
        "namespace": LaunchConfiguration("namespace"),
        "parameters": [LaunchConfiguration("config")],
        "arguments": ["--bridge", bridge],
        # The nodes have their own names, and this parameter is of one of them.
        "ros_arguments": ["-p", ["reference:mode:=", LaunchConfiguration("mode")]],
        "output": "screen",
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "bridge",
                default_value="none",
                description="the flight stack",
                choices=["none", *(name.removesuffix(SUFFIX) for name in bridge_packages())],
            ),
            DeclareLaunchArgument(
                "config",
                default_value=str(default_config),
                description="ROS parameter file for all nodes",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="namespace of the vehicle"
            ),
            DeclareLaunchArgument(
                "mode",
                default_value="on_request",
                choices=["on_request", "at_once"],
                description="of the reference: what is flown once engaged",
            ),
            # ROSflight has a topic /command of its own, of another type.
            Node(condition=IfCondition(NotEqualsSubstitution(bridge, "rosflight")), **common),
            Node(
                remappings=[("mpc:command", "mpc/command")],
                condition=IfCondition(EqualsSubstitution(bridge, "rosflight")),
                **common,
            ),
        ]
    )
