# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A Crazyflie over radio, USB or UDP with CRTP: rates and thrust out, telemetry in."""

from quad_mpc_ros.extras.bridges.crazyflie.bridge import CrazyflieBridge

__all__ = ["CrazyflieBridge"]
