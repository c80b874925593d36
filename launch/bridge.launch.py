"""The controller in a flight stack: mpc, reference and the bridge to the stack.

ros2 launch quad_mpc_ros bridge.launch.py bridge:=px4 config:=my_vehicle.yaml
ros2 launch quad_mpc_ros bridge.launch.py bridge:=mavros config:=my_vehicle.yaml namespace:=uav1
Nothing is armed, no mode switched and nothing flown until asked for: ros2 service call
/px4_bridge/engage, /px4_bridge/arm and /reference/takeoff.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from quad_mpc_ros.ros.bridges.registry import bridge_packages

PACKAGE = "quad_mpc_ros"
SUFFIX = "_bridge"  # of executable and node


def generate_launch_description() -> LaunchDescription:
    """Return bridge, mpc, and the reference unless told not to."""
    default_config = Path(get_package_share_directory(PACKAGE), "config", "default.yaml")
    common = {
        "namespace": LaunchConfiguration("namespace"),
        "parameters": [LaunchConfiguration("config")],
        "output": "screen",
    }
    bridge = LaunchConfiguration("bridge")
    mode = ParameterValue(LaunchConfiguration("mode"), value_type=str)
    bridges = bridge_packages()
    choices = [name.removesuffix(SUFFIX) for name in bridges]
    return LaunchDescription(
        [
            DeclareLaunchArgument("bridge", description="the flight stack", choices=choices),
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
            DeclareLaunchArgument(
                "with_reference", default_value="true", description="start the reference node"
            ),
            *(
                Node(
                    package=package,
                    executable=name,
                    name=name,
                    condition=IfCondition(EqualsSubstitution(bridge, name.removesuffix(SUFFIX))),
                    **common,
                )
                for name, package in bridges.items()
            ),
            # ROSflight has a topic /command of its own, of another type.
            Node(
                package=PACKAGE,
                executable="mpc_node",
                name="mpc",
                condition=IfCondition(NotEqualsSubstitution(bridge, "rosflight")),
                **common,
            ),
            Node(
                package=PACKAGE,
                executable="mpc_node",
                name="mpc",
                remappings=[("command", "mpc/command")],
                condition=IfCondition(EqualsSubstitution(bridge, "rosflight")),
                **common,
            ),
            Node(
                package=PACKAGE,
                executable="reference_node",
                name="reference",
                condition=IfCondition(LaunchConfiguration("with_reference")),
                **{**common, "parameters": [*common["parameters"], {"mode": mode}]},
            ),
        ]
    )
