# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Replay of recordings: played in real time, or as input of a controller."""
