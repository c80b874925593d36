"""The controller in a flight stack: mpc, reference and the bridge to the stack.

ros2 launch quad_mpc_ros bridge.launch.py bridge:=px4 config:=my_vehicle.yaml
ros2 launch quad_mpc_ros bridge.launch.py bridge:=mavros config:=my_vehicle.yaml namespace:=uav1
Nothing is armed and no mode switched: ros2 service call /px4_bridge/engage and /px4_bridge/arm.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

PACKAGE = "quad_mpc_ros"
BRIDGES = ["px4", "mavros", "rosflight", "aerostack2", "crazyswarm2", "rates"]


def generate_launch_description() -> LaunchDescription:
    """Return bridge, mpc, and the reference unless told not to."""
    default_config = Path(get_package_share_directory(PACKAGE), "config", "default.yaml")
    common = {
        "package": PACKAGE,
        "namespace": LaunchConfiguration("namespace"),
        "parameters": [LaunchConfiguration("config")],
        "output": "screen",
    }
    bridge = [LaunchConfiguration("bridge"), "_bridge"]
    return LaunchDescription(
        [
            DeclareLaunchArgument("bridge", description="the flight stack", choices=BRIDGES),
            DeclareLaunchArgument(
                "config",
                default_value=str(default_config),
                description="ROS parameter file for all nodes",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="namespace of the vehicle"
            ),
            DeclareLaunchArgument(
                "with_reference", default_value="true", description="start the reference node"
            ),
            Node(executable=bridge, name=bridge, **common),
            Node(executable="mpc_node", name="mpc", **common),
            Node(
                executable="reference_node",
                name="reference",
                condition=IfCondition(LaunchConfiguration("with_reference")),
                **common,
            ),
        ]
    )
