# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories, their feasibility, and the windows cut from them.

The director selects the active trajectory. May import control (model, safety) and configuration.
"""
