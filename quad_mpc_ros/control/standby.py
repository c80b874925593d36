# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The newest inputs of an inactive controller, and whether the controller can be activated."""

from __future__ import annotations

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.odometry_gate import OdometryGate
from quad_mpc_ros.control.safety.window_validation import reference_fault
from quad_mpc_ros.control.tick import Tick

_SECOND = 1_000_000_000


class Standby:
    """Keeps the newest odometry and reference with their times of arrival, by the node's clock."""

    def __init__(self, config: MpcConfig) -> None:
        self._gate = OdometryGate(config)
        self._refusal: str | None = "no odometry yet"  # of the newest odometry
        self._has_odometry = False  # valid or not
        self._odometry: tuple[OdometrySample, int] | None = None
        self._advances = config.lockstep  # in lockstep the simulator waits after each odometry
        self._reference: tuple[ReferenceWindow, int] | None = None

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed timeouts."""
        self._gate.reconfigure(config)

    def receive_odometry(self, odometry: OdometrySample, *, now_ns: int) -> None:
        """Take an odometry."""
        self._has_odometry = True
        self._refusal = self._gate.refusal(odometry, now_ns=now_ns)
        if self._refusal is None:
            self._advances |= self._odometry is not None
            self._odometry = odometry, now_ns

    def receive_reference(self, window: ReferenceWindow, *, now_ns: int) -> None:
        """Take a reference window."""
        self._reference = window, now_ns

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the inputs by an announced odometry jump."""
        if self._odometry is not None:
            odometry, odometry_ns = self._odometry
            if odometry.stamp_ns < reset.stamp_ns:
                self._odometry = reset.odometry(odometry), odometry_ns
        if self._reference is not None:
            window, window_ns = self._reference
            self._reference = reset.window(window), window_ns

    @property
    def missing(self) -> str | None:
        """The first missing input: odometry, reference, second odometry, or None."""
        if not self._has_odometry:
            return "odometry"
        if self._reference is None:
            return "reference"
        return None if self._advances else "second odometry"

    def activation_blocker(self, config: MpcConfig, *, now_ns: int) -> str | None:
        """Return why the controller cannot be activated, or None.

        Two odometries with advancing stamps are required. In lockstep inputs do not expire, but
        the reference must have the odometry's stamp.
        """
        if self._reference is not None and self._refusal is not None:
            return self._refusal
        if self._odometry is None or self._reference is None or not self._advances:
            return f"no {self.missing} yet"
        (odometry, odometry_ns), (window, window_ns) = self._odometry, self._reference
        frame_id = config.odometry.frame_id
        fault = reference_fault(window, frame_id=frame_id)
        if fault is not None:
            return fault
        if config.lockstep:
            if window.stamp_ns == odometry.stamp_ns:
                return None
            return f"no reference yet for the odometry of {odometry.stamp_ns / _SECOND:.3f} s"
        for name, parameter, age_ns, timeout in (
            ("odometry", "odom_timeout", now_ns - odometry_ns, config.odom_timeout),
            ("reference", "reference_timeout", now_ns - window_ns, config.reference_timeout),
        ):
            if abs(age_ns) > timeout * _SECOND:  # in the future if a clock was set back
                return f"{name} is {age_ns / _SECOND:.2f} s old, {parameter} is {timeout:g} s"
        return None

    def begin(self, controller: Controller) -> Tick | None:
        """Pass the inputs to a new controller, and return its first tick."""
        if self._odometry is None or self._reference is None:
            return None
        (odometry, odometry_ns), (window, window_ns) = self._odometry, self._reference
        controller.receive_reference(window, now_ns=window_ns)
        return controller.receive_odometry(odometry, now_ns=odometry_ns)
