# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Detection of a limit cycle, which occurs if lags or delay are longer than modelled.

Every correction then comes too late, and the thrust axis swings to both sides of the reference's
axis. The hover fallback, whose gains tolerate this delay, ends the oscillation.
"""

from __future__ import annotations

import math
from collections import deque

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.ladder import Action, Breach
from quad_mpc_ros.control.stage import Stage

_SECOND = 1_000_000_000
_WINDOW_NS = 3 * _SECOND
_TILT_AMPLITUDE = 0.2  # rad, about the reference's tilt
_MAX_REVERSALS = 6  # within the window, since the last jump of the reference
_JUMP, _TILT_JUMP = 0.5, 0.3  # m, rad, of the reference from tick to tick
_MAX_DISTANCE = 5.0  # m from the reference; farther away the vehicle tilts to approach it
_MIN_SWING_NS = _SECOND // 10  # no vehicle swings faster; upside down the sides are ambiguous
# Hold time of an oscillation; growth and largest hold time of repeated oscillations.
_HOLD_NS, _HOLD_GROWTH, _MAX_HOLD_NS = 3 * _SECOND, 3, 300 * _SECOND
_MEMORY_NS = 30 * _SECOND  # after so long an oscillation counts as the first one

_Pose = tuple[Array, Array]  # position (3,) and quaternion (4,)


class OscillationMonitor(Stage):
    """Monitors the tilt, and keeps the breach for the hold time."""

    def __init__(self, config: MpcConfig) -> None:
        self._reversals = (_Reversals(), _Reversals())
        self._reference: _Pose | None = None
        self._until_ns: int | None = None
        self._hold_ns = 0
        self._engaged = True
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply a changed action."""
        self._action = Action[config.oscillation.action.upper()]

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the previous reference, which has not jumped."""
        if self._reference is not None:
            p_WB, q_WB_xyzw = self._reference
            self._reference = reset.points(p_WB), reset.attitudes(q_WB_xyzw)

    def engage(self, engaged: bool) -> None:
        """Set whether the vehicle executes commands; a pilot may tilt the vehicle."""
        self._engaged, self._until_ns = engaged, None
        self._forget()

    def check(
        self, odometry: OdometrySample, reference: _Pose | None, *, now_ns: int
    ) -> Breach | None:
        """Return the active breach, if any.

        ``reference`` is the current reference, position (3,) and quaternion (4,).
        """
        if not self._engaged:
            return None
        if self._until_ns is None or now_ns >= self._until_ns:
            if reference is None:
                return None
            # Count swings near the reference since its last jump.
            pose = odometry.p_WB, odometry.q_WB_xyzw
            before, self._reference = self._reference or reference, reference
            lean_x, lean_y, restarts = _leans(pose=pose, reference=reference, before=before)
            if restarts:
                self._forget()
            about_x, about_y = self._reversals
            x = about_x.count(lean_x, now_ns=now_ns)
            y = about_y.count(lean_y, now_ns=now_ns)
            if x < _MAX_REVERSALS and y < _MAX_REVERSALS:
                return None
            self._begin(now_ns)
        return Breach(self._action, "the vehicle oscillates: lags or delay may exceed the model's")

    def _begin(self, now_ns: int) -> None:
        """Start the hold time, longer after a recent oscillation."""
        again = self._until_ns is not None and now_ns - self._until_ns < _MEMORY_NS
        self._hold_ns = min(_HOLD_GROWTH * self._hold_ns, _MAX_HOLD_NS) if again else _HOLD_NS
        self._until_ns = now_ns + self._hold_ns
        self._forget()

    def _forget(self) -> None:
        for reversals in self._reversals:
            reversals.forget()


class _Reversals:
    """Times at which a tilt [rad] changed from beyond the amplitude to beyond the opposite one."""

    def __init__(self) -> None:
        self._times_ns: deque[int] = deque(maxlen=_MAX_REVERSALS)
        self._side, self._since_ns = 0.0, 0

    def forget(self) -> None:
        self._times_ns.clear()
        self._side = 0.0

    def count(self, value: float, *, now_ns: int) -> int:
        """Take a tilt; return the number of recent changes."""
        if value > _TILT_AMPLITUDE or value < -_TILT_AMPLITUDE:
            side = math.copysign(1.0, value)
            if side == -self._side and now_ns - self._since_ns >= _MIN_SWING_NS:
                self._times_ns.append(now_ns)
            if side != self._side:
                self._side, self._since_ns = side, now_ns
        while self._times_ns and not 0 <= now_ns - self._times_ns[0] <= _WINDOW_NS:
            self._times_ns.popleft()
        return len(self._times_ns)


@compiled
def _leans(pose: _Pose, reference: _Pose, before: _Pose) -> tuple[float, float, bool]:
    """Return the tilt error of a pose [rad]; whether its reference jumped or is far away.

    Local paths around obstacles may jump in tilt only.
    """
    (p_WB, q_WB_xyzw), (p_before, q_before_xyzw) = pose, before
    p_reference, q_reference_xyzw = reference
    tilt_x, tilt_y = _lean(q_reference_xyzw, q_before_xyzw)
    jumped = math.hypot(tilt_x, tilt_y) > _TILT_JUMP
    jumped |= kernels.distance(p_reference, p_before) > _JUMP
    x, y = _lean(q_WB_xyzw, q_reference_xyzw)
    return x, y, jumped or kernels.distance(p_WB, p_reference) > _MAX_DISTANCE


@compiled
def _lean(q_WB_xyzw: Array, q_reference_xyzw: Array) -> tuple[float, float]:
    """Return the angle of the thrust axis to the reference's, about world x and y [rad]."""
    up = kernels.column(kernels.rotation(kernels.quaternion_in(q_WB_xyzw)), 2)
    asked = kernels.column(kernels.rotation(kernels.quaternion_in(q_reference_xyzw)), 2)
    about = kernels.cross(asked, up)
    sine = kernels.norm(about)
    angle = math.atan2(sine, kernels.dot(asked, up))
    share = angle / sine if sine > 0.0 else 1.0
    return share * about[0], share * about[1]
