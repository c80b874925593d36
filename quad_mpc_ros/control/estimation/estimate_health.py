# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Health of the estimate, and the decision to reset it."""

from __future__ import annotations

from quad_mpc_ros.control.estimation.kept_height import since
from quad_mpc_ros.control.lie import formulas

_SECOND = 1_000_000_000
_AT_BOUNDS_NS = 3 * _SECOND
# Resets are at least so far apart, as each makes the estimate jump.
_RESET_INTERVAL_NS = 30 * _SECOND
_REFUSED_TIME = 1.0  # s, time constant of the share of refused odometries
_MAX_REFUSED_SHARE = 0.5
_REPORT_TIME_NS = 10 * _SECOND


class EstimateHealth:
    """Tracks how long the estimate has been at its bounds or has rejected odometries."""

    def __init__(self) -> None:
        self.resets = 0
        """Number of resets of the estimate."""
        self._refused = 0.0
        self._bounds_since_ns: int | None = None
        self._reset_ns: int | None = None

    def fails(self, now_ns: int, *, duration: float, refused: bool, at_bounds: bool) -> bool:
        """Take an odometry that could update the estimate; return whether to reset the estimate.

        ``duration`` [s] is since the previous odometry. Each reset is counted.
        """
        share = formulas.lowpass_share(duration, _REFUSED_TIME)
        self._refused += share * ((1.0 if refused else 0.0) - self._refused)
        since_ns = since(self._bounds_since_ns, now_ns) if at_bounds else None
        self._bounds_since_ns = since_ns
        stuck = since_ns is not None and now_ns - since_ns > _AT_BOUNDS_NS
        recent = self._reset_ns is not None and 0 <= now_ns - self._reset_ns < _RESET_INTERVAL_NS
        if recent or not (stuck or self._refused > _MAX_REFUSED_SHARE):
            return False
        self.resets += 1
        self._reset_ns, self._bounds_since_ns, self._refused = now_ns, None, 0.0
        return True

    def was_reset(self, now_ns: int) -> bool:
        """Whether a reset is recent enough to be reported."""
        return self._reset_ns is not None and 0 <= now_ns - self._reset_ns < _REPORT_TIME_NS
