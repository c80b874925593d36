# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of flights: figures of merit, waypoints, the summary on a terminal."""
