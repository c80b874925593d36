# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bridge to PX4 and ArduPilot with MAVLink, over a serial port, UDP or TCP."""

from quad_mpc_ros.ros.bridges.mavlink.bridge import MavlinkBridge

__all__ = ["MavlinkBridge"]
