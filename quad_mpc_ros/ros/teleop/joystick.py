"""A joystick: what its axes and buttons ask for, as ``sensor_msgs/Joy`` tells them."""

from __future__ import annotations

from collections.abc import Sequence

from quad_mpc_ros.ros.teleop.config import JoystickParameters
from quad_mpc_ros.ros.teleop.motion import REQUESTS, STILL, Motion

_ALWAYS = ("hold", "land")  # whether the deadman button is held or not


class Joystick:
    """The newest message of a joystick; times in seconds of one clock."""

    def __init__(self, config: JoystickParameters) -> None:
        self._config = config
        self._buttons_of = {name: getattr(config, f"{name}_button") for name in REQUESTS}
        self._axes: Sequence[float] = ()
        self._buttons: Sequence[int] = ()
        self._received: float | None = None
        self._let_go = False

    def receive(self, axes: Sequence[float], buttons: Sequence[int], *, now: float) -> list[str]:
        """Take a message; return the requests whose buttons are pressed anew.

        What is pressed in the first message, or the first after a loss, is not: nobody saw it
        being pressed, and a driver may tell what was pressed before. So the deadman button counts
        once it was seen let go.
        """
        connected = self.is_connected(now=now)
        before = self._buttons if connected else buttons
        released = not _held(buttons, self._config.deadman_button)
        self._let_go = released or (connected and self._let_go)
        self._axes, self._buttons, self._received = axes, buttons, now
        return [
            name
            for name, number in self._buttons_of.items()
            if _held(buttons, number)
            and not _held(before, number)
            and (name in _ALWAYS or self._deadman)
        ]

    @property
    def was_there(self) -> bool:
        """Whether any message has come."""
        return self._received is not None

    def is_connected(self, *, now: float) -> bool:
        """Return whether a message came in time."""
        return self._received is not None and now - self._received <= self._config.timeout

    @property
    def missing(self) -> str:
        """What the configured numbers name and the joystick does not have, or nothing."""
        config, axes = self._config, len(self._axes)
        asked = {
            f"{name}_axis": getattr(config, f"{name}_axis")
            for name in ("forward", "left", "up", "yaw")
        }
        lacking = [f"{name} {number}" for name, number in asked.items() if number >= axes]
        if config.deadman_button >= len(self._buttons):
            lacking.append(f"deadman_button {config.deadman_button}")
        return ", ".join(lacking)

    def motion(self, *, now: float) -> Motion:
        """Return what the sticks ask for while the deadman button is held."""
        if not self.is_connected(now=now) or not self._deadman:
            return STILL
        config = self._config
        return Motion(
            forward=self._share(config.forward_axis),
            left=self._share(config.left_axis),
            up=self._share(config.up_axis),
            yaw=self._share(config.yaw_axis),
        )

    @property
    def _deadman(self) -> bool:
        number = self._config.deadman_button
        return number < 0 or (self._let_go and _held(self._buttons, number))

    def _share(self, axis: int) -> float:
        """Return the share of an axis in [-1, 1], 0 in the deadzone and rising from its edge."""
        if axis >= len(self._axes):
            return 0.0
        value = float(self._axes[axis])
        if axis in self._config.reversed_axes:
            value = -value
        zone = self._config.deadzone
        if not abs(value) > zone:  # nan too
            return 0.0
        share = min((abs(value) - zone) / (1.0 - zone), 1.0)
        return share if value > 0.0 else -share


def _held(buttons: Sequence[int], number: int) -> bool:
    return 0 <= number < len(buttons) and buttons[number] != 0
