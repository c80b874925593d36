# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The fence and the envelope: limits on position, tilt, rates and speed.

A fence with the action hover is breached as soon as the vehicle can no longer stop inside. A
breach lasts until the vehicle has satisfied all limits, with a margin, for a second and the
reference is inside the fence again.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.kept_height import since
from quad_mpc_ros.control.lie import Array, kernels, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.fallbacks import ACCELERATION_LIMIT, VELOCITY_GAIN
from quad_mpc_ros.control.safety.ladder import Action, Breach
from quad_mpc_ros.control.stage import Stage

_RECOVERY_NS = 1_000_000_000
# Margins of the recovery: share of a limit of the envelope, distance to the fence [m].
_RECOVERY_SHARE, _RECOVERY_DISTANCE = 0.9, 0.1
_TURN_TIME = 0.4  # s, until the hover controller has turned the vehicle to brake
_FENCE_INSET = 0.5  # m, distance of the hover position to the fence; less in a narrow fence


class FlightLimits(Stage):
    """Monitors the limits, and keeps a breach until the vehicle has recovered."""

    def __init__(self, config: MpcConfig) -> None:
        self._breach: Breach | None = None
        self._kept_since_ns: int | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed limits; breaches are detected again."""
        self._fence, self._envelope = config.fence, config.envelope
        self._low, self._high = config.fence.walls
        self._fenced = config.fence.has_walls
        self._checks_stopping = config.fence.action == "hover" and self._fenced

    def check(
        self, odometry: OdometrySample, *, p_reference: Array | None, now_ns: int
    ) -> Breach | None:
        """Return the active breach, if any; ``p_reference`` (3,) is the current reference."""
        found = self.breach_at(odometry)
        if found is not None:
            self._kept_since_ns = None
            if self._breach is None or found.action >= self._breach.action:
                self._breach = found
        elif self._breach is not None and self._is_over(odometry, p_reference, now_ns):
            self._breach = None
        return self._breach

    def inside(self, p_WB: Array) -> Array:
        """Return the point (3,) nearest to a position inside the fence, with a margin."""
        low, high = np.array(self._low), np.array(self._high)
        inset = np.minimum(_FENCE_INSET, (high - low) / 2.0)
        return np.clip(p_WB, low + inset, high - inset)

    def _is_over(self, odometry: OdometrySample, p_reference: Array | None, now_ns: int) -> bool:
        kept = (
            p_reference is not None
            and self._wall(p_reference, 0.0) is None
            and self.breach_at(odometry, share=_RECOVERY_SHARE, distance=_RECOVERY_DISTANCE)
            is None
        )
        since_ns = self._kept_since_ns = since(self._kept_since_ns, now_ns) if kept else None
        return since_ns is not None and now_ns - since_ns >= _RECOVERY_NS

    def breach_at(
        self, odometry: OdometrySample, *, share: float = 1.0, distance: float = 0.0
    ) -> Breach | None:
        """Return the worst breach of limits times ``share`` and walls moved by ``distance``."""
        worst: Breach | None = None
        outside = self._outside(odometry, distance) if self._fenced else None
        excess = self._excess(odometry, share)
        for action, reason in ((self._fence.action, outside), (self._envelope.action, excess)):
            breach = None if reason is None else Breach(Action[action.upper()], reason)
            if breach is not None and (worst is None or breach.action > worst.action):
                worst = breach
        return worst

    def _outside(self, odometry: OdometrySample, distance: float) -> str | None:
        outside = self._wall(odometry.p_WB, distance)
        if outside is not None or not self._checks_stopping:
            return outside
        stop = self._wall(_stopping_point(odometry), distance)
        return f"{stop}, at the stopping point" if stop is not None else None

    def _wall(self, p_WB: Array, distance: float) -> str | None:
        for axis, p, low, high in zip("xyz", p_WB.tolist(), self._low, self._high, strict=True):
            if not low + distance <= p <= high - distance:
                return f"outside the fence: {axis} is {p:.2f} m, limits {low:g} to {high:g}"
        return None

    def _excess(self, odometry: OdometrySample, share: float) -> str | None:
        """Return the exceeded limit of the envelope, else None."""
        limits = self._envelope
        if limits.tilt_max < math.pi:
            tilt = math.acos(min(max(odometry.up, -1.0), 1.0))
            if tilt > share * limits.tilt_max:
                return f"tilt is {tilt:.2f} rad, limit {limits.tilt_max:g}"
        rate, speed = kernels.length(odometry.w_WB_B), kernels.length(odometry.v_WB_B)
        if rate > share * limits.rate_max:
            return f"body rate is {rate:.1f} rad/s, limit {limits.rate_max:g}"
        if speed > share * limits.speed_max:
            return f"speed is {speed:.1f} m/s, limit {limits.speed_max:g}"
        return None


def _stopping_point(odometry: OdometrySample) -> Array:
    """Return the stopping point (3,) of the hover controller."""
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    v_WB_W = R_WB @ odometry.v_WB_B
    speed = np.abs(v_WB_W)
    braking, slowing = ACCELERATION_LIMIT, VELOCITY_GAIN
    # Full braking down to the speed braking / slowing, then exponential.
    quick = speed**2 / (2.0 * braking) + braking / (2.0 * slowing**2)
    distance = np.where(speed > braking / slowing, quick, speed / slowing)
    return np.asarray(odometry.p_WB + _TURN_TIME * v_WB_W + np.sign(v_WB_W) * distance)
