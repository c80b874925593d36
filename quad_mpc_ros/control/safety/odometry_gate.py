# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Acceptance of odometry by its stamps.

A valid odometry is rejected if its stamp does not fit its arrival, if stamps go backwards, or if
the source repeats its values. After a clock was set or a source was restarted, odometry is
accepted again once its offset has been constant for the odometry's timeout. The first odometries
may have waited in a queue, so until then a faster odometry is accepted at once.
"""

from __future__ import annotations

import math
import statistics

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.clock_offset import ClockOffset, PersistentOffset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.control.stage import Stage

_SECOND = 1_000_000_000
NOT_ADVANCING = "odometry stamps do not advance"
_BACKWARDS = "odometry stamps go backwards"
_MOVING_SPEED = 1e-3  # m/s, rad/s; at this speed successive odometries must differ
_MIN_PERIODS = 5
SLOW = 1.1
"""Ratio of odometry period to control period above which odometry is too slow."""


class OdometryGate(Stage):
    """Rejects odometry that does not fit the previous odometries."""

    def __init__(self, config: MpcConfig) -> None:
        self._frame_id = config.odometry.frame_id
        self._lockstep = config.lockstep
        self._newest: OdometrySample | None = None
        self.changed_ns = 0
        """Arrival of the last odometry that did not repeat the previous one."""
        self.checks_stamps = True
        """Whether stamps are compared with arrivals."""
        self._offset = ClockOffset()
        self._began_ns = 0
        self._confirmed = False  # the offset, by later odometries
        self._misfits = PersistentOffset()
        self._steps_ns: list[int] = []
        self._measured_ns = 0  # sum of the steps
        self.period: float | None = None
        """Median time between stamps [s]; None while unknown."""
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply a changed timeout."""
        self._timeout_ns = round(config.odom_timeout * _SECOND)

    def refusal(self, odometry: OdometrySample, *, now_ns: int) -> str | None:
        """Return the reason to reject an odometry that arrives now, else None."""
        reason = odometry_fault(odometry, frame_id=self._frame_id)
        if reason is None and self._newest is not None and self.checks_stamps:
            misfit = self._misfit_in_lockstep if self._lockstep else self._misfit
            reason = misfit(odometry, self._newest, now_ns)
        if reason is None:
            self._take(odometry, now_ns)
        return reason

    def _take(self, odometry: OdometrySample, now_ns: int) -> None:
        stamp_ns = odometry.stamp_ns
        age_ns = self._offset.follow(stamp_ns, now_ns=now_ns)
        if self._newest is None or not -self._timeout_ns <= age_ns <= self._timeout_ns:
            self._offset.set(now_ns - stamp_ns, stamp_ns=stamp_ns, now_ns=now_ns)
            self._began_ns = now_ns
        self._confirmed = self._confirmed or now_ns - self._began_ns > self._timeout_ns
        if self._newest is None or not _repeats(odometry, self._newest):
            self.changed_ns = now_ns
        if self._newest is not None and stamp_ns > self._newest.stamp_ns:
            # The median over at least a second and five periods is robust against losses.
            self._steps_ns.append(stamp_ns - self._newest.stamp_ns)
            self._measured_ns += self._steps_ns[-1]
            if self._measured_ns >= _SECOND and len(self._steps_ns) >= _MIN_PERIODS:
                self.period = statistics.median(self._steps_ns) / _SECOND
                self._steps_ns, self._measured_ns = [], 0
        self._newest = odometry
        self._misfits.clear()

    def _misfit_in_lockstep(
        self, odometry: OdometrySample, newest: OdometrySample, _: int
    ) -> str | None:
        """An odometry may be repeated, and a simulation may restart."""
        backwards_ns = newest.stamp_ns - odometry.stamp_ns
        return _BACKWARDS if 0 < backwards_ns <= self._timeout_ns else None

    def _misfit(self, odometry: OdometrySample, newest: OdometrySample, now_ns: int) -> str | None:
        if odometry.stamp_ns == newest.stamp_ns:
            return NOT_ADVANCING
        if now_ns - self.changed_ns > self._timeout_ns and _repeats(odometry, newest):
            return "odometry reports motion but its values do not change"
        ahead_ns = -self._offset.age_ns(odometry.stamp_ns, now_ns=now_ns)
        backwards = odometry.stamp_ns < newest.stamp_ns
        if not backwards and -self._timeout_ns <= ahead_ns <= self._timeout_ns:
            return None
        if not backwards and ahead_ns > 0 and not self._confirmed:
            return None  # the previous ones had waited in a queue
        behind_ns, timeout_ns = now_ns - odometry.stamp_ns, self._timeout_ns
        lasting_ns = self._misfits.duration_ns(behind_ns, now_ns=now_ns, tolerance_ns=timeout_ns)
        if lasting_ns > timeout_ns:
            self._offset.behind_ns = behind_ns
            return None
        if backwards:
            return _BACKWARDS
        side = "ahead of" if ahead_ns > 0 else "behind"
        return f"odometry stamp is {abs(ahead_ns) / _SECOND:.2f} s {side} its arrival"


def _repeats(odometry: OdometrySample, before: OdometrySample) -> bool:
    """Whether an odometry that reports motion equals the previous one, bit by bit."""
    return (
        odometry.p_WB.tobytes() == before.p_WB.tobytes()
        and odometry.q_WB_xyzw.tobytes() == before.q_WB_xyzw.tobytes()
        and odometry.v_WB_B.tobytes() == before.v_WB_B.tobytes()
        and odometry.w_WB_B.tobytes() == before.w_WB_B.tobytes()
        and (
            odometry.speed > _MOVING_SPEED or math.hypot(*odometry.w_WB_B.tolist()) > _MOVING_SPEED
        )
    )
