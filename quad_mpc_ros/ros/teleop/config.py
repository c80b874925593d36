"""Parameters of the teleop node."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter

_axis = functools.partial(parameter, minimum=0, maximum=63)
_button = functools.partial(parameter, minimum=-1, maximum=63)


@dataclass(frozen=True, kw_only=True)
class JoystickParameters(Configuration):
    """Which axis and button does what; the defaults are those of ``game_controller_node``."""

    owner = "teleop.joystick"

    forward_axis: int = _axis(3, doc="Axis that moves forward; the right stick, up.")
    left_axis: int = _axis(2, doc="Axis that moves left; the right stick, left.")
    up_axis: int = _axis(1, doc="Axis that climbs; the left stick, up.")
    yaw_axis: int = _axis(0, doc="Axis that turns left; the left stick, left.")
    reversed_axes: tuple[int, ...] = parameter(
        (), doc="Axes that count the other way round.", minimum=0, maximum=63
    )
    deadzone: float = parameter(
        0.1, doc="Share of an axis about its middle that counts as none.", minimum=0.0, below=1.0
    )
    deadman_button: int = _button(
        9, doc="Button to be held while sticks, take-off and start count (LB)."
    )
    takeoff_button: int = _button(3, doc="Button of the take-off (Y); -1 is none.")
    start_button: int = _button(6, doc="Button that starts the trajectory (START); -1 is none.")
    hold_button: int = _button(1, doc="Button that holds (B); -1 is none.")
    land_button: int = _button(0, doc="Button that lands (A); -1 is none.")
    timeout: float = parameter(
        0.5,
        doc="Without a message for so long the joystick counts as lost, and nothing as held.",
        unit="s",
        above=0.0,
        maximum=10.0,
    )


@dataclass(frozen=True, kw_only=True)
class TeleopConfig(Configuration):
    """How keys and sticks fly the vehicle."""

    owner = "teleop"

    input: str = parameter(
        "auto",
        doc="keyboard needs a terminal; joystick waits for one; auto takes both, and ends if "
        "there is neither.",
        choices=("auto", "keyboard", "joystick"),
    )
    mode: str = parameter(
        "velocity",
        doc="velocity: keys and sticks are velocities; position: each key press, or stick beyond "
        "its half, is a step. The key m changes it.",
        choices=("velocity", "position"),
    )
    speed: float = parameter(
        1.0, doc="Velocity of a key or a full stick, level.", unit="m/s", above=0.0, maximum=100.0
    )
    climb_speed: float = parameter(
        0.5, doc="The same up and down.", unit="m/s", above=0.0, maximum=100.0
    )
    yaw_rate: float = parameter(
        0.8, doc="Yaw rate of a key or a full stick.", unit="rad/s", above=0.0, maximum=20.0
    )
    step: float = parameter(
        0.5, doc="position: length of a step.", unit="m", above=0.0, maximum=100.0
    )
    yaw_step: float = parameter(
        math.pi / 8.0, doc="position: turn of a step.", unit="rad", above=0.0, maximum=math.pi
    )
    rate: float = parameter(
        20.0,
        doc="Velocities per second; several within the reference's velocity_timeout.",
        unit="Hz",
        minimum=5.0,
        maximum=200.0,
    )
    key_delay: float = parameter(
        0.7,
        doc="How long a key counts as held that is pressed first: until the terminal begins to "
        "repeat it.",
        unit="s",
        above=0.0,
        maximum=2.0,
    )
    key_timeout: float = parameter(
        0.25,
        doc="How long a key counts as held that the terminal repeats.",
        unit="s",
        above=0.0,
        maximum=2.0,
    )
    joystick: JoystickParameters = dataclasses.field(default_factory=JoystickParameters)
