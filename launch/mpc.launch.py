# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller for a drone stack: mpc, and the reference unless ``with_reference`` is false.

ros2 launch quad_mpc_ros mpc.launch.py config:=my_vehicle.yaml odom:=/uav1/odometry/filtered
ros2 launch quad_mpc_ros mpc.launch.py rep147:=true
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from quad_mpc_ros.configuration import files
from quad_mpc_ros.messages.topics import REP147_NAMES

PACKAGE = "quad_mpc_ros"
TOPICS = ("odom", "reference", "command")


def generate_launch_description() -> LaunchDescription:
    """Return mpc and reference with their topics open to remapping."""
    default_config = Path(get_package_share_directory(PACKAGE), "config", "default.yaml")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=str(default_config),
                description="ROS parameter file for both nodes",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="namespace of the vehicle"
            ),
            DeclareLaunchArgument(
                "with_reference", default_value="true", description="start the reference node"
            ),
            DeclareLaunchArgument(
                "rep147",
                default_value="false",
                choices=["true", "false"],
                description="use the topic names of REP-147 for requests",
            ),
            *(
                DeclareLaunchArgument(
                    topic, default_value=topic, description=f"topic used for {topic}"
                )
                for topic in TOPICS
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context) -> list:
    # launch would only warn of a parameter file that is not there.
    files.sections("config", LaunchConfiguration("config").perform(context))
    rep147 = LaunchConfiguration("rep147").perform(context) == "true"
    remappings = [(topic, LaunchConfiguration(topic)) for topic in TOPICS]
    common = {
        "package": PACKAGE,
        "namespace": LaunchConfiguration("namespace"),
        "parameters": [LaunchConfiguration("config")],
        "output": "screen",
    }
    return [
        Node(executable="mpc_node", name="mpc", remappings=remappings, **common),
        Node(
            executable="reference_node",
            name="reference",
            condition=IfCondition(LaunchConfiguration("with_reference")),
            remappings=[*remappings, *(REP147_NAMES.items() if rep147 else ())],
            **common,
        ),
    ]
