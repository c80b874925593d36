# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes and bridges: all code that imports rclpy, also lifecycle, parameters and spinning.

``ros`` may import recordings, simulation and the layers below. Only commands may import ``ros``.
"""
