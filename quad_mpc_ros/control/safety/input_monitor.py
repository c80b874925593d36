"""The newest odometry and reference that are fit to be used, and how old they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.ground_state import idles
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import with_body_twist
from quad_mpc_ros.control.safety.ladder import timeouts_of
from quad_mpc_ros.control.safety.odometry_gate import OdometryGate
from quad_mpc_ros.control.safety.position_jumps import PositionJumps
from quad_mpc_ros.control.safety.twist_frame import TwistFrameCheck
from quad_mpc_ros.control.safety.validation import BODY, coverage_fault, imu_fault
from quad_mpc_ros.control.safety.window_validation import reference_fault

# Of a measurement of the accelerometer before the newest odometry, which may have stopped.
_FARTHEST_AHEAD_NS = 1_000_000_000


class InputMonitor:
    """Takes what is fit to be used; of what is not it says why, and keeps the last good one.

    ``odometry`` has its twist in the body frame, in whichever it came, and where its position has
    jumped the one that its velocity leads to; ``jumps`` says so. ``odometry_ns`` and
    ``reference_ns`` are the times of arrival.
    """

    def __init__(self, config: MpcConfig) -> None:
        self._parameters, self._gravity = config.odometry, config.gravity
        self.gate = OdometryGate(config)
        self.jumps = PositionJumps()
        self._horizon_ns = round(config.horizon_steps * config.horizon_step * 1e9)
        self._twist_check = TwistFrameCheck(twist_frame=config.odometry.twist_frame)
        self.odometry: OdometrySample | None = None
        self.odometry_ns: int | None = None
        self.reference: ReferenceWindow | None = None
        self.reference_ns: int | None = None
        self.idle_wanted = False
        """Whether the reference asks for idle motors; in the air it is one that rests."""
        self._lockstep = config.lockstep
        self.imu_stamp_ns: int | None = None
        """Stamp of the newest measurement of the accelerometer."""
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed timeouts."""
        self.gate.reconfigure(config)
        self._odometry_timeout_ns = timeouts_of(config).odometry
        self._reference_timeout_ns = timeouts_of(config).reference

    def take_odometry(self, odometry: OdometrySample, *, now_ns: int) -> str | None:
        """Take an odometry that arrives now, or return why it cannot be used."""
        refusal = self.gate.refusal(odometry, now_ns=now_ns)
        if refusal is not None:
            return refusal
        self._twist_check.note(odometry)
        if self._parameters.twist_frame == "world":
            odometry = with_body_twist(odometry)
        self.odometry, self.odometry_ns = self.jumps.checked(odometry), self.gate.changed_ns
        return None

    def take_imu(self, sample: ImuSample) -> str | None:
        """Take what an accelerometer measured, or return why it cannot be used.

        Nothing but its stamp is kept. In lockstep it may come again, which is no fault.
        """
        odometry, newest_ns, stamp_ns = self.odometry, self.imu_stamp_ns, sample.stamp_ns
        fault = imu_fault(sample, body=BODY if odometry is None else odometry.child_frame_id)
        if fault is not None:
            return fault
        # A clock that was set is another matter.
        if newest_ns is not None and 0 <= newest_ns - stamp_ns <= self._odometry_timeout_ns:
            return "" if self._lockstep else "imu stamp does not run forwards"
        if odometry is not None and not self._lockstep:
            ahead_ns = stamp_ns - odometry.stamp_ns
            if ahead_ns < -self._odometry_timeout_ns or ahead_ns > _FARTHEST_AHEAD_NS:
                side = "ahead of" if ahead_ns > 0 else "behind"
                return f"imu stamp is {1e-9 * abs(ahead_ns):.2f} s {side} that of the odometry"
        self.imu_stamp_ns = stamp_ns
        return None

    def take_reference(self, window: ReferenceWindow, *, now_ns: int) -> str | None:
        """Take a reference window that arrives now, or return why it cannot be used."""
        fault = reference_fault(window, frame_id=self._parameters.frame_id)
        if fault is None:
            self.idle_wanted = idles(window, self._gravity)
            if self.idle_wanted:
                window = replace(window, a_WB_W=np.zeros_like(window.a_WB_W))
            self.reference, self.reference_ns = window, now_ns
        return fault

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Let the reference move with the estimate until another comes, and where it is."""
        self.jumps.reset_estimate(reset)
        if self.reference is not None:
            self.reference = reset.window(self.reference)

    def reference_at(self, stamp_ns: int, *, now_ns: int) -> tuple[ReferenceWindow | None, str]:
        """Return the reference to follow at a stamp, or None and why there is none.

        One that came long ago is followed as long as it reaches over the horizon.
        """
        timeout_ns = self._reference_timeout_ns
        if self.reference is None:
            return None, "no usable reference"
        old = now_ns - (self.reference_ns or 0) > timeout_ns
        if old and not self._reaches(self.reference, stamp_ns):
            return None, "no usable reference"
        fault = coverage_fault(self.reference, stamp_ns, tolerance_ns=timeout_ns)
        return (self.reference, "") if fault is None else (None, fault)

    def reference_seen_ns(self, now_ns: int) -> int | None:
        """Return when the reference came; now, as long as it reaches over the horizon."""
        window, odometry = self.reference, self.odometry
        if (
            window is not None
            and odometry is not None
            and self._reaches(window, odometry.stamp_ns)
        ):
            return now_ns
        return self.reference_ns

    def _reaches(self, window: ReferenceWindow, stamp_ns: int) -> bool:
        return window.stamp_ns + int(window.offset_ns[-1]) - stamp_ns >= self._horizon_ns

    def ages_ns(self, now_ns: int) -> tuple[int, int]:
        """Return the age of the odometry by its stamp and of the reference since its arrival.

        Without an odometry that is zero, without a reference the time since the clock began.
        """
        odometry_ns = self.odometry.stamp_ns if self.odometry is not None else now_ns
        return now_ns - odometry_ns, now_ns - (self.reference_ns or 0)

    def twist_warning(self) -> str | None:
        """Return a warning when the odometry's twist seems to be in the other frame, once."""
        suspected = self._twist_check.verdict()
        if suspected is None:
            return None
        return (
            f"the odometry's twist does not match its positions; it seems to be in the "
            f"{suspected} frame: set odometry.twist_frame to {suspected}"
        )
