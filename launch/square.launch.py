# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the square: simulator, reference, mpc and recorder.

ros2 launch quad_mpc_ros square.launch.py
ros2 launch quad_mpc_ros square.launch.py config:=my_vehicle.yaml namespace:=uav1 record:=false
ros2 launch quad_mpc_ros square.launch.py lockstep:=true duration:=10.0
ros2 launch quad_mpc_ros square.launch.py visualise:=true
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from quad_mpc_ros.configuration import files

PACKAGE = "quad_mpc_ros"


def generate_launch_description() -> LaunchDescription:
    """Return the nodes; the launch ends with the simulator."""
    default_config = Path(get_package_share_directory(PACKAGE), "config", "default.yaml")
    lockstep = ParameterValue(LaunchConfiguration("lockstep"), value_type=bool)
    duration = ParameterValue(LaunchConfiguration("duration"), value_type=float)

    simulator = _node("simulator", {"lockstep": lockstep, "duration": duration})
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=str(default_config),
                description="ROS parameter file for all nodes",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="namespace of the vehicle"
            ),
            DeclareLaunchArgument(
                "lockstep",
                default_value="false",
                description="simulated time that waits for every command",
            ),
            DeclareLaunchArgument(
                "duration",
                default_value="0.0",
                description="seconds to fly, 0.0 is until interrupted",
            ),
            DeclareLaunchArgument("record", default_value="true", description="record a bag"),
            DeclareLaunchArgument(
                "visualise", default_value="false", description="publish markers for viewers"
            ),
            OpaqueFunction(function=_refuse_wrong_file),
            _node("visualisation", {"use_sim_time": lockstep}, condition="visualise"),
            _node("recorder", {"use_sim_time": lockstep}, condition="record"),
            _node("mpc", {"lockstep": lockstep, "use_sim_time": lockstep}),
            _node("reference", {"lockstep": lockstep, "use_sim_time": lockstep}),
            simulator,
            RegisterEventHandler(
                OnProcessExit(
                    target_action=simulator,
                    on_exit=[EmitEvent(event=Shutdown(reason="the simulator has ended"))],
                )
            ),
        ]
    )


def _refuse_wrong_file(context) -> list:
    """Refuse a parameter file that is not there, which launch would only warn of."""
    files.sections("config", LaunchConfiguration("config").perform(context))
    return []


def _node(name: str, parameters: dict, condition: str | None = None) -> Node:
    return Node(
        package=PACKAGE,
        executable=f"{name}_node",
        name=name,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("config"), parameters],
        output="screen",
        condition=None if condition is None else IfCondition(LaunchConfiguration(condition)),
    )
