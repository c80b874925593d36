# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulation: plants, sensors, wind, and the closed loop in one process.

May import control and references; the plants' physics is independent of the MPC's model.
"""
