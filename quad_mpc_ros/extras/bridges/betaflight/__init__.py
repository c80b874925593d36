"""Betaflight: sticks over a serial line by MSP; telemetry back."""

from quad_mpc_ros.extras.bridges.betaflight.bridge import BetaflightBridge

__all__ = ["BetaflightBridge"]
