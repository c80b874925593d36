# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The newest valid odometry and reference, and their ages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.ground_state import idles
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import with_body_twist
from quad_mpc_ros.control.safety.ladder import timeouts_of
from quad_mpc_ros.control.safety.odometry_gate import SLOW, OdometryGate
from quad_mpc_ros.control.safety.odometry_jumps import OdometryJumps
from quad_mpc_ros.control.safety.validation import BODY, coverage_fault, imu_fault
from quad_mpc_ros.control.safety.window_validation import reference_fault
from quad_mpc_ros.control.stage import Failure, Stage, StageLog

# Largest lead of an IMU stamp over the newest odometry, which may have stopped.
_MAX_IMU_LEAD_NS = 1_000_000_000


class InputMonitor(Stage):
    """Keeps the last valid inputs, and logs why others are rejected.

    ``odometry`` has the twist in the body frame, and jumps replaced (``jumps``). ``odometry_ns``
    and ``reference_ns`` are the times of arrival.
    """

    def __init__(self, config: MpcConfig, log: StageLog | None = None) -> None:
        self._log = log or StageLog()
        self._parameters, self._gravity = config.odometry, config.gravity
        self.gate = OdometryGate(config)
        self.jumps = OdometryJumps(self._log)
        self._horizon_ns = round(config.horizon_steps * config.horizon_step * 1e9)
        self.reported: OdometrySample | None = None
        """The newest odometry with jumps, twist in the body frame."""
        self.odometry: OdometrySample | None = None
        self.odometry_ns: int | None = None
        self.reference: ReferenceWindow | None = None
        self.reference_ns: int | None = None
        self.idle_wanted = False
        """Whether the reference requests idle motors; in the air this means hover."""
        self._lockstep = config.lockstep
        self._reported_slow = False
        self.imu_stamp_ns: int | None = None
        """Stamp of the newest accelerometer sample."""
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed timeouts."""
        self._control_period = 1.0 / config.control_rate
        self._odometry_timeout_ns = timeouts_of(config).odometry
        self._reference_timeout_ns = round(config.reference_timeout * 1e9)

    def accept_odometry(self, odometry: OdometrySample, *, now_ns: int) -> OdometrySample | None:
        """Take an odometry; return it with the twist in the body frame, None if rejected."""
        refusal = self.gate.refusal(odometry, now_ns=now_ns)
        if refusal is not None:
            self._log.reject(refusal)
            return None
        if self._parameters.twist_frame == "world":
            odometry = with_body_twist(odometry)
        self.reported = odometry
        self.odometry, self.odometry_ns = self.jumps.checked(odometry), self.gate.changed_ns
        if self.jumps.fault:
            self._log.reject(self.jumps.fault)
        return self.odometry

    def accept_imu(self, sample: ImuSample) -> bool:
        """Take an accelerometer sample; return whether it is valid."""
        fault = self._imu_fault(sample)
        if fault:
            self._log.reject(fault)
        if fault is None:
            self.imu_stamp_ns = sample.stamp_ns
        return fault is None

    def accept_reference(self, window: ReferenceWindow, *, now_ns: int) -> bool:
        """Take a reference window that arrives now; return whether it is valid."""
        fault = reference_fault(window, frame_id=self._parameters.frame_id)
        if fault is not None:
            self._log.reject(fault)
            return False
        self.idle_wanted = idles(window, self._gravity)
        if self.idle_wanted:
            window = replace(window, a_WB_W=np.zeros_like(window.a_WB_W))
        self.reference, self.reference_ns = window, now_ns
        return True

    def _imu_fault(self, sample: ImuSample) -> str | None:
        """Return why a sample is unusable, "" for a sample repeated in lockstep, else None."""
        odometry, newest_ns, stamp_ns = self.odometry, self.imu_stamp_ns, sample.stamp_ns
        fault = imu_fault(sample, body=BODY if odometry is None else odometry.child_frame_id)
        if fault is not None:
            return fault
        # Beyond the timeout, a clock was set.
        if newest_ns is not None and 0 <= newest_ns - stamp_ns <= self._odometry_timeout_ns:
            return "" if self._lockstep else "imu stamps do not advance"
        if odometry is not None and not self._lockstep:
            ahead_ns = stamp_ns - odometry.stamp_ns
            if ahead_ns < -self._odometry_timeout_ns or ahead_ns > _MAX_IMU_LEAD_NS:
                side = "ahead of" if ahead_ns > 0 else "behind"
                return f"imu stamp is {1e-9 * abs(ahead_ns):.2f} s {side} the odometry's stamp"
        return None

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform odometry and reference by an announced odometry jump."""
        if self.odometry is not None and self.odometry.stamp_ns < reset.stamp_ns:
            self.odometry = reset.odometry(self.odometry)
        if self.reference is not None:
            self.reference = reset.window(self.reference)

    def is_odometry_lost(self, *, now_ns: int) -> bool:
        """Whether odometry, received before, has been missing for longer than its timeout."""
        arrived_ns = self.odometry_ns
        return arrived_ns is not None and abs(now_ns - arrived_ns) > self._odometry_timeout_ns

    def seconds_until_odometry_lost(self, *, now_ns: int) -> float:
        """Return the time until odometry would be lost [s]."""
        age_ns = 0 if self.odometry_ns is None else now_ns - self.odometry_ns
        return max(self._odometry_timeout_ns + 1 - age_ns, 0) * 1e-9 if age_ns >= 0 else 0.0

    def reference_at(self, stamp_ns: int, *, now_ns: int) -> ReferenceWindow | Failure:
        """Return the reference at a stamp, or the reason why no reference exists.

        A reference older than its timeout is still used while its window covers the horizon.
        """
        window, timeout_ns = self.reference, self._reference_timeout_ns
        if window is None or self.reference_ns is None:
            return Failure("validate", "no reference yet")
        age_ns, ends_ns = now_ns - self.reference_ns, window.stamp_ns + int(window.offset_ns[-1])
        # From the future if a clock was set back.
        if abs(age_ns) > timeout_ns and ends_ns - stamp_ns < self._horizon_ns:
            return Failure("validate", f"reference is {1e-9 * age_ns:.2f} s old")
        fault = coverage_fault(window, stamp_ns, tolerance_ns=timeout_ns)
        return window if fault is None else Failure("validate", fault)

    def report(self) -> None:
        """Warn, once, if the rate of the odometry limits the control rate."""
        period, was_slow = self.gate.period, self._reported_slow
        self._reported_slow = period is not None and period > SLOW * self._control_period
        if period is None or not self._reported_slow or was_slow:
            return
        timeout = 1e-9 * self._odometry_timeout_ns
        failsafe = f"; odom_timeout is {timeout:g} s: the failsafe is active in between"
        self._log.warn(
            f"odometry arrives {1.0 / period:.1f} times a second, control_rate is "
            f"{1.0 / self._control_period:g}: commands are limited to the rate of "
            f"odometry{failsafe if SLOW * period > timeout else ''}; raise the odometry rate"
        )
