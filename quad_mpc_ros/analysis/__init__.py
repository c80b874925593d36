# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Analysis of recorded flights: identification, figures, report.

May import recordings and lower layers; nothing here imports rclpy.
"""
