"""The newest inputs of a controller that does not command yet, and whether it may begin."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.control.safety.window_validation import reference_fault
from quad_mpc_ros.control.tick import Tick

_SECOND = 1_000_000_000


M = TypeVar("M", OdometrySample, ReferenceWindow)


class _Received(NamedTuple, Generic[M]):
    message: M
    now_ns: int


class Standby:
    """Keeps the newest odometry and reference; times are those the controller would be given."""

    def __init__(self) -> None:
        self._odometry: _Received[OdometrySample] | None = None
        self._reference: _Received[ReferenceWindow] | None = None

    def receive_odometry(self, odometry: OdometrySample, *, now_ns: int) -> None:
        """Take an odometry."""
        self._odometry = _Received(odometry, now_ns)

    def receive_reference(self, window: ReferenceWindow, *, now_ns: int) -> None:
        """Take a reference window."""
        self._reference = _Received(window, now_ns)

    @property
    def missing(self) -> str | None:
        """Which has never come: odometry, reference, or None."""
        if self._odometry is None:
            return "odometry"
        return "reference" if self._reference is None else None

    def obstacle(self, config: MpcConfig, *, now_ns: int) -> str | None:
        """Return why a controller cannot begin with what has come, or None.

        In lockstep nothing grows old, but the reference must be that of the odometry.
        """
        if self._odometry is None or self._reference is None:
            return f"no {self.missing} yet"
        (odometry, odometry_ns), (window, window_ns) = self._odometry, self._reference
        frame_id = config.odometry.frame_id
        fault = odometry_fault(odometry, frame_id=frame_id)
        fault = fault or reference_fault(window, frame_id=frame_id)
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
            if abs(age_ns) > timeout * _SECOND:  # the future, too: a clock that was set back
                return f"{name} is {age_ns / _SECOND:.2f} s old, {parameter} is {timeout:g} s"
        return None

    def begin(self, controller: Controller) -> Tick | None:
        """Hand what has come to a new controller, and return its first tick."""
        if self._odometry is None or self._reference is None:
            return None
        controller.receive_reference(self._reference.message, now_ns=self._reference.now_ns)
        return controller.receive_odometry(self._odometry.message, now_ns=self._odometry.now_ns)
