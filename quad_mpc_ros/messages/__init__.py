# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fields and bytes of messages: definitions, CDR, conversions, Betaflight's frames.

May import control; ROS message packages are not needed here.
"""
