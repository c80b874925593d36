# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller in a flight stack: mpc, reference and the bridge to the stack, in one process.

ros2 launch quad_mpc_ros bridge.launch.py bridge:=px4 config:=my_vehicle.yaml
ros2 launch quad_mpc_ros bridge.launch.py bridge:=mavros config:=my_vehicle.yaml namespace:=uav1
ros2 launch quad_mpc_ros bridge.launch.py bridge:=px4 one_process:=false
Nothing is armed, no mode switched and nothing flown until asked for: ros2 service call
/px4_bridge/engage, /px4_bridge/arm and /reference/takeoff.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from quad_mpc_ros.configuration import files
from quad_mpc_ros.messages.topics import REP147_NAMES
from quad_mpc_ros.ros.bridges.registry import bridge_packages

PACKAGE = "quad_mpc_ros"
SUFFIX = "_bridge"  # of executable and node
SWITCH = ["true", "false"]


def generate_launch_description() -> LaunchDescription:
    """Return bridge, mpc, and the reference unless it is left out."""
    default_config = Path(get_package_share_directory(PACKAGE), "config", "default.yaml")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "bridge",
                description="the flight stack, none for mpc and reference alone",
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
            DeclareLaunchArgument(
                "with_reference",
                default_value="true",
                choices=SWITCH,
                description="start the reference node",
            ),
            DeclareLaunchArgument(
                "one_process",
                default_value="true",
                choices=SWITCH,
                description="run the nodes in one process, which takes less memory",
            ),
            DeclareLaunchArgument(
                "rep147",
                default_value="false",
                choices=SWITCH,
                description="use the topic names of REP-147 for requests",
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context) -> list:
    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    # One that is not there launch would only warn of, and fly the default vehicle.
    files.sections("config", given("config"))
    bridge, mode, with_reference = given("bridge"), given("mode"), given("with_reference")
    common = {
        "namespace": given("namespace"),
        "parameters": [given("config")],
        "output": "screen",
    }
    # ROSflight has a topic /command of its own, of another type.
    moved = {"command": "mpc/command"} if bridge == "rosflight" else {}
    requests = REP147_NAMES if given("rep147") == "true" else {}
    if given("one_process") == "true":
        return [
            Node(
                package=PACKAGE,
                executable="stack_node",
                arguments=["--bridge", bridge, "--reference", with_reference],
                # Of one of them, in whatever namespace; ROS reads reference:mode in none.
                ros_arguments=["-p", f"mode:={mode}"] if with_reference == "true" else [],
                remappings=[
                    *((f"mpc:{name}", to) for name, to in moved.items()),
                    *((f"reference:{name}", to) for name, to in requests.items()),
                ],
                **common,
            )
        ]
    nodes = [
        Node(
            package=PACKAGE,
            executable="mpc_node",
            name="mpc",
            remappings=list(moved.items()),
            **common,
        )
    ]
    if with_reference == "true":
        parameters = [*common["parameters"], {"mode": ParameterValue(mode, value_type=str)}]
        nodes.append(
            Node(
                package=PACKAGE,
                executable="reference_node",
                name="reference",
                remappings=list(requests.items()),
                **{**common, "parameters": parameters},
            )
        )
    if bridge != "none":
        name = f"{bridge}{SUFFIX}"
        package = bridge_packages()[name]
        nodes.append(Node(package=package, executable=name, name=name, **common))
    return nodes
