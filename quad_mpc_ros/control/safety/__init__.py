# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Validation of inputs, failsafe levels, and limits of commands."""
