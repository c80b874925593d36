# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller of a vehicle in one process: mpc and reference, and a bridge if one is named.

ros2 launch quad_mpc_ros stack.launch.py config:=my_vehicle.yaml
ros2 launch quad_mpc_ros stack.launch.py bridge:=px4 config:=my_vehicle.yaml namespace:=uav1
It is bridge.launch.py, with its arguments, but needs no bridge.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the one process."""
    launch = Path(get_package_share_directory("quad_mpc_ros"), "launch", "bridge.launch.py")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "bridge", default_value="none", description="the flight stack, or none"
            ),
            # Given on: launch does not see that this one has a default.
            IncludeLaunchDescription(
                str(launch), launch_arguments=[("bridge", LaunchConfiguration("bridge"))]
            ),
        ]
    )
