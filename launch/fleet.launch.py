# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly several vehicles at once, each in a namespace: uav1, uav2 and so on.

ros2 launch quad_mpc_ros fleet.launch.py vehicles:=4
ros2 launch quad_mpc_ros fleet.launch.py vehicles:=8 config:=my_vehicle.yaml duration:=60.0
ros2 launch quad_mpc_ros fleet.launch.py one_process:=false
The mpc and the reference of a vehicle are in one process, unless they are kept apart.
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
from quad_mpc_ros.configuration import UserError, files

PACKAGE = "quad_mpc_ros"


def generate_launch_description() -> LaunchDescription:
    """Return the nodes of all vehicles; the launch ends with the first simulator."""
    default_config = Path(get_package_share_directory(PACKAGE), "config", "default.yaml")
    return LaunchDescription(
        [
            DeclareLaunchArgument("vehicles", default_value="2", description="how many vehicles"),
            DeclareLaunchArgument(
                "config",
                default_value=str(default_config),
                description="ROS parameter file for the nodes of all vehicles",
            ),
            DeclareLaunchArgument(
                "duration",
                default_value="0.0",
                description="seconds to fly, 0.0 is until interrupted",
            ),
            DeclareLaunchArgument(
                "record", default_value="false", description="record a bag of each vehicle"
            ),
            DeclareLaunchArgument(
                "one_process",
                default_value="true",
                choices=["true", "false"],
                description="run mpc and reference of a vehicle in one process",
            ),
            OpaqueFunction(function=_vehicles),
        ]
    )


def _vehicles(context) -> list:
    """Return the nodes of as many vehicles as are asked for."""
    files.sections("config", LaunchConfiguration("config").perform(context))
    given = LaunchConfiguration("vehicles").perform(context)
    if not given.isdecimal() or int(given) < 1:
        raise UserError(f"vehicles: given {given!r}, expected a whole number >= 1")
    count = int(given)
    together = LaunchConfiguration("one_process").perform(context) == "true"
    duration = ParameterValue(LaunchConfiguration("duration"), value_type=float)
    actions = []
    for number in range(1, count + 1):
        namespace = f"uav{number}"
        simulator = _node("simulator", namespace, {"duration": duration})
        actions += [
            *(
                [_node("", namespace, executable="stack_node")]
                if together
                else [_node("mpc", namespace), _node("reference", namespace)]
            ),
            _node("recorder", namespace, condition="record"),
            simulator,
            RegisterEventHandler(
                OnProcessExit(
                    target_action=simulator,
                    on_exit=[EmitEvent(event=Shutdown(reason="a simulator has ended"))],
                )
            ),
        ]
    return actions


def _node(
    name: str,
    namespace: str,
    parameters: dict | None = None,
    *,
    executable: str | None = None,
    condition: str | None = None,
) -> Node:
    return Node(
        package=PACKAGE,
        executable=executable or f"{name}_node",
        **({"name": name} if name else {}),
        namespace=namespace,
        parameters=[LaunchConfiguration("config"), parameters or {}],
        output="screen",
        condition=None if condition is None else IfCondition(LaunchConfiguration(condition)),
    )
