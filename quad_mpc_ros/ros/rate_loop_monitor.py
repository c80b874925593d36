# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Detects a ringing or slow rate loop from its time constants."""

from __future__ import annotations

import math

from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.ros.preflight.finding import Finding, warning

_LEAST_DAMPING, _LEAST_FREQUENCY = 0.45, 1.2  # Hz
# Faster oscillations decay within a few control periods, and the estimate is near its bound.
_HIGHEST_FREQUENCY = 6.0  # Hz
_CONFIRMED_NS = 5_000_000_000


def rate_loop_finding(axes: str, *, tau: float, torque: float) -> Finding | None:
    """Return why a rate loop rings or is slow, with a remedy; None if it does neither.

    With the gain 1 / ``tau`` and the lag ``torque`` [s] of the torque, the natural frequency is
    1 / sqrt(tau T), the damping ratio sqrt(tau / T) / 2. Without one of them it is of first order.
    """
    if tau <= 0.0 or torque <= 0.0:
        return None
    frequency = 1.0 / (2.0 * math.pi * math.sqrt(tau * torque))
    damping = 0.5 * math.sqrt(tau / torque)
    if damping < _LEAST_DAMPING and frequency < _HIGHEST_FREQUENCY:
        remedy = "lower P or raise D, or expect overshoot after fast turns"
    elif frequency < _LEAST_FREQUENCY:
        remedy = "raise P, or expect large errors in fast turns"
    else:
        return None
    return warning(f"rate loop of {axes}: {frequency:.1f} Hz, damping {damping:.2f}", remedy)


class RateLoopMonitor:
    """Monitors the estimated rate loop of roll and pitch."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def check(self, stats: TickStats) -> str | None:
        """Return a problem that has lasted for five seconds with its remedy, or None."""
        tau, torque = 1e-3 * stats.rate_time_constant_ms, 1e-3 * stats.torque_time_constant_ms
        found = rate_loop_finding("roll and pitch", tau=tau, torque=torque)
        if found is None:
            self._since_ns = None
            return None
        if self._since_ns is None or stats.stamp_ns < self._since_ns:
            self._since_ns = stats.stamp_ns
        return found.text if stats.stamp_ns - self._since_ns >= _CONFIRMED_NS else None
