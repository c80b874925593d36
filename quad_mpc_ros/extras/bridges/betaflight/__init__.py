"""Betaflight: sticks and telemetry over a serial line with MSP."""

from quad_mpc_ros.extras.bridges.betaflight.bridge import BetaflightBridge

__all__ = ["BetaflightBridge"]
