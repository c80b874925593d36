"""The fence and the envelope: limits on where and how the vehicle may fly.

A fence with the action hover is broken as soon as the vehicle could no longer stop inside of it.
A limit that was broken counts as broken until the vehicle has kept all of them, with a margin, for
a second, and the reference is inside the fence again: what brought it out would do so at once.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, kernels, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.fallbacks import ACCELERATION_LIMIT, VELOCITY_GAIN
from quad_mpc_ros.control.safety.ladder import Action, Breach
from quad_mpc_ros.control.stage import Stage

_CALM_NS = 1_000_000_000
# Of a limit of the envelope, and from a wall of the fence [m].
_CALM_SHARE, _CALM_DISTANCE = 0.9, 0.1
_TURN_TIME = 0.4  # s: until the hover controller has turned the vehicle to brake
# Where to hover after leaving the fence: this far inside [m], or in the middle of a narrow one.
_INSET = 0.5


class FlightLimits(Stage):
    """Watches the vehicle, and remembers a breach until it is over."""

    def __init__(self, config: MpcConfig) -> None:
        self._breach: Breach | None = None
        self._calm_since_ns: int | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed limits, and count breaches again from zero."""
        self._fence, self._envelope = config.fence, config.envelope
        self._low, self._high = config.fence.walls
        # Whether there are walls that it is to stop in front of.
        self._fenced = config.fence.has_walls
        self._foresees = config.fence.action == "hover" and self._fenced

    def check(
        self, odometry: OdometrySample, *, p_reference: Array | None, now_ns: int
    ) -> Breach | None:
        """Return the breach in force, given where the reference is now (3,), if there is one."""
        found = self._found(odometry, share=1.0, distance=0.0)
        if found is not None:
            self._calm_since_ns = None
            if self._breach is None or found.action >= self._breach.action:
                self._breach = found
        elif self._breach is not None and self._is_over(odometry, p_reference, now_ns):
            self._breach = None
        return self._breach

    def foreseen(self, odometry: OdometrySample) -> Breach | None:
        """Return the breach that there will be where the vehicle should be soon, if any."""
        return self._found(odometry, share=1.0, distance=0.0)

    def inside(self, p_WB: Array) -> Array:
        """Return the point (3,) nearest to a position and well inside the fence."""
        low, high = np.array(self._low), np.array(self._high)
        inset = np.minimum(_INSET, (high - low) / 2.0)
        return np.clip(p_WB, low + inset, high - inset)

    def _is_over(self, odometry: OdometrySample, p_reference: Array | None, now_ns: int) -> bool:
        calm = self._found(odometry, share=_CALM_SHARE, distance=_CALM_DISTANCE) is None
        if not calm or p_reference is None or self._wall(p_reference, 0.0) is not None:
            self._calm_since_ns = None
            return False
        if self._calm_since_ns is None:
            self._calm_since_ns = now_ns
        return now_ns - self._calm_since_ns >= _CALM_NS

    def _found(self, odometry: OdometrySample, *, share: float, distance: float) -> Breach | None:
        """Return the gravest breach of limits scaled by a share, of walls moved by a distance."""
        gravest: Breach | None = None
        for action, reason in (
            (self._fence.action, self._outside(odometry, distance) if self._fenced else None),
            (self._envelope.action, self._excess(odometry, share)),
        ):
            if reason is not None:
                breach = Breach(Action[action.upper()], reason)
                if gravest is None or breach.action > gravest.action:
                    gravest = breach
        return gravest

    def _outside(self, odometry: OdometrySample, distance: float) -> str | None:
        outside = self._wall(odometry.p_WB, distance)
        if outside is not None or not self._foresees:
            return outside
        stop = self._wall(_stopping_point(odometry), distance)
        return f"{stop}, where it would come to a stop" if stop is not None else None

    def _wall(self, p_WB: Array, distance: float) -> str | None:
        for axis, p, low, high in zip("xyz", p_WB.tolist(), self._low, self._high, strict=True):
            if not low + distance <= p <= high - distance:
                return f"outside the fence: {axis} is {p:.2f} m, limits {low:g} to {high:g}"
        return None

    def _excess(self, odometry: OdometrySample, share: float) -> str | None:
        """Return which limit of the envelope is exceeded."""
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
    """Return where the hover controller would bring the vehicle to a stop (3,)."""
    R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
    v_WB_W = R_WB @ odometry.v_WB_B
    speed = np.abs(v_WB_W)
    braking, slowing = ACCELERATION_LIMIT, VELOCITY_GAIN
    # With all the braking that there is down to the speed braking / slowing, then exponentially.
    quick = speed**2 / (2.0 * braking) + braking / (2.0 * slowing**2)
    distance = np.where(speed > braking / slowing, quick, speed / slowing)
    return np.asarray(odometry.p_WB + _TURN_TIME * v_WB_W + np.sign(v_WB_W) * distance)
