# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A minimal relay, written as in rclpy's tutorials: a command for each odometry.

``bench/node_latency.py`` compares the controller with this relay, which does not import the
package.
"""

from __future__ import annotations

import contextlib
import sys

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data


def main() -> None:
    """Relay odom to the topic that is given, with the stamp."""
    rclpy.init()
    node = rclpy.create_node("relay")
    publisher = node.create_publisher(TwistStamped, sys.argv[1], qos_profile_sensor_data)

    def answer(odometry: Odometry) -> None:
        command = TwistStamped()
        command.header.stamp = odometry.header.stamp
        publisher.publish(command)

    node.create_subscription(Odometry, "odom", answer, qos_profile_sensor_data)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
