# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Your own node with the controller: odometry in, command out. Requires rclpy.

This is a minimal node. ``mpc_node`` adds lifecycle, live parameters, diagnostics and real time.
The second node here publishes the odometry of a vehicle at rest.
"""

import sys

from quad_mpc_ros import Controller, MpcConfig, OdometrySample, ReferenceWindow
from quad_mpc_ros.messages.conversions import fill_command, fill_odometry, odometry_from_message

try:
    import rclpy
    from geometry_msgs.msg import TwistStamped
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
except ImportError as error:
    print(f"this example needs ROS 2, which is not here: {error}")
    sys.exit(0)


class HoverNode(Node):
    """Hovers two metres above the origin."""

    def __init__(self) -> None:
        super().__init__("hover")
        self.controller = Controller(MpcConfig())
        self.out = self.create_publisher(TwistStamped, "command", qos_profile_sensor_data)
        self.create_subscription(Odometry, "odom", self.on_odometry, qos_profile_sensor_data)

    def on_odometry(self, message: Odometry) -> None:
        """Answer an odometry."""
        odometry = odometry_from_message(message)
        reference = ReferenceWindow.hover([0.0, 0.0, 2.0], stamp_ns=odometry.stamp_ns)
        tick = self.controller.step(odometry, reference)
        if tick is not None and tick.command is not None:
            command = TwistStamped()
            fill_command(command, tick.command)
            self.out.publish(command)


class VehicleAtRest(Node):
    """Publishes at 50 Hz the odometry of a vehicle at a height of one metre."""

    def __init__(self) -> None:
        super().__init__("vehicle")
        self.commands: list[TwistStamped] = []
        self.out = self.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self.create_subscription(
            TwistStamped, "command", self.commands.append, qos_profile_sensor_data
        )
        self.create_timer(0.02, self.publish)

    def publish(self) -> None:
        """Publish an odometry."""
        message = Odometry()
        now_ns = self.get_clock().now().nanoseconds
        fill_odometry(message, OdometrySample.at_rest([0.0, 0.0, 1.0], stamp_ns=now_ns))
        self.out.publish(message)


rclpy.init()
executor = rclpy.executors.SingleThreadedExecutor()
vehicle = VehicleAtRest()
for node in (HoverNode(), vehicle):
    executor.add_node(node)
for _ in range(1000):
    executor.spin_once(timeout_sec=0.1)
    if len(vehicle.commands) >= 20:
        break
last = vehicle.commands[-1]
print(f"{len(vehicle.commands)} commands, the last with throttle {last.twist.linear.z:.3f}")
rclpy.shutdown()
