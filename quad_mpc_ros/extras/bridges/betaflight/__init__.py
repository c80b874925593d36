# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Betaflight: sticks and telemetry over a serial line with MSP."""

from quad_mpc_ros.extras.bridges.betaflight.bridge import BetaflightBridge

__all__ = ["BetaflightBridge"]
