"""Which odometry to believe.

Besides what is wrong with an odometry by itself, its stamp has to fit its arrival: a stamp from
the future or from long ago, one that runs backwards, and an estimator that repeats itself are
refused. A clock that was set, or a source that began anew, is believed as soon as it has been
consistent for the odometry's timeout. The first odometries of all may have waited in a queue:
until they have been consistent for so long, one that comes faster is believed at once.
"""

from __future__ import annotations

import math

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.validation import odometry_fault

_SECOND = 1_000_000_000
_BACKWARDS = "odometry stamp runs backwards"
# Clocks may drift apart by this share, as that of a simulation that falls behind real time; the
# fastest arrival is forgotten at the same pace.
_DRIFT = 0.02
# Moving at this speed [m/s, rad/s] for a timeout shows in every odometry.
_MOVING = 1e-3


class OdometryGate:
    """Refuses odometry that does not fit what came before it.

    ``changed_ns`` is when the last odometry arrived that did not repeat the one before.
    """

    def __init__(self, config: MpcConfig) -> None:
        self._frame_id = config.odometry.frame_id
        self._lockstep = config.lockstep
        self._newest: OdometrySample | None = None
        self._arrived_ns = 0
        self.changed_ns = 0
        self._offset_ns = 0  # of stamps before arrivals, as of the fastest arrival
        self._began_ns = 0
        self._confirmed = False  # of the offset, by what came later
        self._odd_since_ns: int | None = None
        self._odd_offset_ns = 0
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over a changed timeout."""
        self._timeout_ns = round(config.odom_timeout * _SECOND)

    def refusal(
        self, odometry: OdometrySample, *, now_ns: int, believed: bool = False
    ) -> str | None:
        """Return why an odometry that arrives now is not to be used; None when it is taken.

        One that is ``believed`` is only refused for what is wrong with it by itself.
        """
        reason = odometry_fault(odometry, frame_id=self._frame_id)
        if reason is None and self._newest is not None and not believed:
            misfit = self._misfit_in_lockstep if self._lockstep else self._misfit
            reason = misfit(odometry, self._newest, now_ns)
        if reason is None:
            self._take(odometry, now_ns)
        return reason

    def _take(self, odometry: OdometrySample, now_ns: int) -> None:
        offset_ns = odometry.stamp_ns - now_ns
        if self._newest is None or offset_ns - self._offset_ns > self._timeout_ns:
            self._offset_ns, self._began_ns = offset_ns, now_ns
        self._confirmed = self._confirmed or now_ns - self._began_ns > self._timeout_ns
        if self._newest is None or not _repeats(odometry, self._newest):
            self.changed_ns = now_ns
        forgotten_ns = round(_DRIFT * (now_ns - self._arrived_ns))
        self._offset_ns = max(offset_ns, self._offset_ns - forgotten_ns)
        self._newest, self._arrived_ns, self._odd_since_ns = odometry, now_ns, None

    def _misfit_in_lockstep(
        self, odometry: OdometrySample, newest: OdometrySample, _: int
    ) -> str | None:
        """The same odometry may come again, and a simulation may begin anew."""
        backwards_ns = newest.stamp_ns - odometry.stamp_ns
        return _BACKWARDS if 0 < backwards_ns <= self._timeout_ns else None

    def _misfit(self, odometry: OdometrySample, newest: OdometrySample, now_ns: int) -> str | None:
        if odometry.stamp_ns == newest.stamp_ns:
            return "odometry repeats its stamp"
        if now_ns - self.changed_ns > self._timeout_ns and _repeats(odometry, newest):
            return "odometry tells of motion and yet stays the same"
        offset_ns = odometry.stamp_ns - now_ns
        ahead_ns = offset_ns - self._offset_ns
        backwards = odometry.stamp_ns < newest.stamp_ns
        if not backwards and abs(ahead_ns) <= self._timeout_ns:
            return None
        if not backwards and ahead_ns > 0 and not self._confirmed:
            return None  # those before had waited in a queue
        if self._has_persisted(offset_ns, now_ns):
            self._offset_ns = offset_ns
            return None
        if backwards:
            return _BACKWARDS
        side = "ahead of" if ahead_ns > 0 else "behind"
        return f"odometry stamp is {abs(ahead_ns) / _SECOND:.2f} s {side} its arrival"

    def _has_persisted(self, offset_ns: int, now_ns: int) -> bool:
        """Whether stamps have been off by the same for longer than the timeout."""
        alike = abs(offset_ns - self._odd_offset_ns) <= self._timeout_ns
        if self._odd_since_ns is None or not alike:
            self._odd_since_ns, self._odd_offset_ns = now_ns, offset_ns
        return now_ns - self._odd_since_ns > self._timeout_ns


def _repeats(odometry: OdometrySample, before: OdometrySample) -> bool:
    """Whether an odometry that tells of motion is the one before bit by bit."""
    return (
        odometry.p_WB.tobytes() == before.p_WB.tobytes()
        and odometry.q_WB_xyzw.tobytes() == before.q_WB_xyzw.tobytes()
        and odometry.v_WB_B.tobytes() == before.v_WB_B.tobytes()
        and odometry.w_WB_B.tobytes() == before.w_WB_B.tobytes()
        and (odometry.speed > _MOVING or math.hypot(*odometry.w_WB_B.tolist()) > _MOVING)
    )
