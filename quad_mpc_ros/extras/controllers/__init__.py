# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Controllers from textbooks and autopilots, to compare with the MPC.

All command throttle and body rates from the same odometry, reference, mass and thrust curve.
"""
