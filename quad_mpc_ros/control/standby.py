"""What a controller that does not command yet has heard, and whether it is enough to begin."""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.safety.validation import odometry_fault, reference_fault

_SECOND = 1_000_000_000


class _Odometry(NamedTuple):
    sample: OdometrySample
    received_ns: int


class _Reference(NamedTuple):
    window: ReferenceWindow
    received_ns: int


class Standby:
    """Keeps the newest odometry and reference; times are those the controller would be told."""

    def __init__(self) -> None:
        self._odometry: _Odometry | None = None
        self._reference: _Reference | None = None

    def receive_odometry(self, odometry: OdometrySample, *, now_ns: int) -> None:
        """Take an odometry."""
        self._odometry = _Odometry(odometry, now_ns)

    def receive_reference(self, window: ReferenceWindow, *, now_ns: int) -> None:
        """Take a reference window."""
        self._reference = _Reference(window, now_ns)

    def obstacle(self, config: MpcConfig, *, now_ns: int) -> str | None:
        """Return why a controller cannot begin with what has come, or None.

        In lockstep nothing grows old, but the reference must be that of the odometry.
        """
        if self._odometry is None:
            return "no odometry yet"
        if self._reference is None:
            return "no reference yet"
        odometry, window = self._odometry.sample, self._reference.window
        frame_id = config.odometry.frame_id
        unusable = odometry_fault(odometry, frame_id=frame_id) or reference_fault(
            window, frame_id=frame_id
        )
        if unusable is not None:
            return unusable
        if config.lockstep:
            if window.stamp_ns == odometry.stamp_ns:
                return None
            return f"no reference yet for the odometry of {odometry.stamp_ns / _SECOND:.3f} s"
        return _too_old(
            "odometry", "odom_timeout", now_ns - self._odometry.received_ns, config.odom_timeout
        ) or _too_old(
            "reference",
            "reference_timeout",
            now_ns - self._reference.received_ns,
            config.reference_timeout,
        )

    def begin(self, controller: Controller) -> Tick | None:
        """Hand what has come to a new controller, and return its first tick."""
        if self._odometry is None or self._reference is None:
            return None
        window, received_ns = self._reference
        controller.receive_reference(window, now_ns=received_ns)
        odometry, received_ns = self._odometry
        return controller.receive_odometry(odometry, now_ns=received_ns)


def _too_old(name: str, parameter: str, age_ns: int, timeout: float) -> str | None:
    if abs(age_ns) <= timeout * _SECOND:  # a clock that was set back makes it come from the future
        return None
    return f"{name} is {age_ns / _SECOND:.2f} s old, {parameter} is {timeout:g} s"
