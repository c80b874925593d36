# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``betaflight``."""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.extras.plants.betaflight.firmware import (
    AT_REST,
    PULSE_MAX,
    PULSE_MID,
    PULSE_MIN,
    Console,
    Firmware,
    Sensed,
    eeprom,
)
from quad_mpc_ros.messages import msp
from quad_mpc_ros.simulation.optional_plants import BetaflightParameters
from quad_mpc_ros.simulation.rotors.parameters import RotorParameters
from quad_mpc_ros.simulation.rotors.plant import DrivenPlant

_SENSOR_PERIOD_NS = 1_000_000
_RC_PERIOD_NS = 50_000_000  # after which a command is repeated, to keep the receiver connected
_REST_TIME_NS, _ARMING_TIME_NS, _SETTLING_TIME_NS = 1_500_000_000, 3_000_000_000, 500_000_000

_IDLE_LEVEL = 0.055  # level of the motors at minimum throttle
_MIN_PULSE = 1010  # pulse width of minimum throttle [us]
_AXES = ("roll", "pitch", "yaw")
_CHANNEL_COUNT = 8
_ROLL, _PITCH, _THROTTLE, _YAW, _ARM = range(5)

# Signs of x and y: rear right, front right, rear left, front left.
_MOTORS = ((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0))
_SPINS = (-1.0, 1.0, 1.0, -1.0)


_SETTINGS = (
    "aux 0 0 0 1700 2100 0 0",  # the fifth channel arms
    "set small_angle = 180",
    # The simulation starts in flight, but the firmware would interpret hard turns in the first
    # half second as a failed take-off, and disarm.
    "set runaway_takeoff_prevention = OFF",
    "set pwr_on_arm_grace = 0",
    f"set min_check = {_MIN_PULSE}",
    "set serial_update_rate_hz = 1000",
    f"set motor_idle = {round(1e4 * _IDLE_LEVEL)}",
    "set rates_type = ACTUAL",
)


class _Session:
    """A running firmware and its receiver."""

    def __init__(self, settings: tuple[str, ...]) -> None:
        """Start the firmware; raises :class:`UserError` if not installed."""
        self.firmware = Firmware(eeprom(settings))
        self.firmware.connect()
        self._silent_ns = 0

    def calibrate(self) -> None:
        """Calibrate the firmware at rest."""
        for _ in range(_REST_TIME_NS // _SENSOR_PERIOD_NS):
            self.step(_channels())

    def arm(self) -> None:
        """Arm the firmware; raises :class:`UserError` if arming fails."""
        for _ in range(_ARMING_TIME_NS // _SENSOR_PERIOD_NS):
            if min(self.step(_channels(arm=True))) > PULSE_MIN:
                return
        status = Console(self.firmware).say("status").splitlines()
        flags = [line for line in status if line.startswith("Arming disable flags:")]
        raise UserError(f"simulator.betaflight.settings: arming failed. {' '.join(flags)}")

    def send_with_next_step(self) -> None:
        """Send the channels with the next step, before they are due."""
        self._silent_ns = _RC_PERIOD_NS

    def step(self, channels: tuple[int, ...], sensed: Sensed = AT_REST) -> tuple[float, ...]:
        """Advance the firmware by a period; return its pulses [us]."""
        if self._silent_ns >= _RC_PERIOD_NS:
            self.firmware.received()  # discard the reply to the last command
            self.firmware.send(msp.raw_rc(channels))
            self._silent_ns = 0
        self._silent_ns += _SENSOR_PERIOD_NS
        return self.firmware.step(_SENSOR_PERIOD_NS, sensed=sensed)

    def close(self) -> None:
        """End the firmware."""
        self.firmware.close()


class BetaflightPlant(DrivenPlant):
    """The rotors and the body of the plant ``rotors`` under Betaflight's rate loop and mixer.

    A motor level is a share of the rotor's maximum speed. The throttle commands the thrust of the
    configured curve, up to the rounding of pulses to whole microseconds.
    """

    def __init__(self, config: BetaflightParameters) -> None:
        """Start the firmware; raises :class:`UserError` if not installed."""
        self._firmware_config = config
        self._motor_of_rotor, self._is_reversed = motors_of(config.rotors)
        # The firmware counts rates in tens of degrees per second.
        self._tens = math.ceil(math.degrees(config.betaflight.rate_max) / 10.0)
        super().__init__(config, period_ns=_SENSOR_PERIOD_NS)

    def _start(self) -> None:
        """Set the configured initial state, with an armed and settled firmware."""
        super()._start()
        own = self._firmware_config.betaflight
        self._session = _Session((*self._settings(), *own.settings))
        self._firmware = self._session.firmware
        self._session.calibrate()
        self._arm()
        sensed = self._sensed()
        for _ in range(_SETTLING_TIME_NS // _SENSOR_PERIOD_NS):
            self._step(self._asked(), sensed)
        self._run_loop()
        self._speeds[:] = self._wanted

    def _follow(self, command: Input) -> None:
        super()._follow(command)
        self._session.send_with_next_step()

    def _arm(self) -> None:
        self._session.arm()

    def _step(self, channels: tuple[int, ...], sensed: Sensed) -> tuple[float, ...]:
        """Advance the firmware by a period; return its pulses [us]."""
        return self._session.step(channels, sensed)

    def _settings(self) -> list[str]:
        rates = [
            line
            for axis in _AXES
            for line in (
                f"set {axis}_rc_rate = {self._tens}",
                f"set {axis}_srate = {self._tens}",
                f"set {axis}_expo = 0",
            )
        ]
        return [
            *_SETTINGS,
            f"set yaw_motors_reversed = {'ON' if self._is_reversed else 'OFF'}",
            *rates,
        ]

    def _run_loop(self) -> None:
        pulses = self._step(self._asked(), self._sensed())
        span = self._config.rotors.speed_max / (PULSE_MAX - PULSE_MIN)
        for rotor, motor in enumerate(self._motor_of_rotor):
            self._wanted[rotor] = span * max(pulses[motor] - PULSE_MIN, 0.0)

    def _sensed(self) -> Sensed:
        return Sensed(
            w_WB_B=self._body["w_WB_B"].copy(),
            specific_force_B=self._specific_force_B(),
            q_WB_xyzw=self._body["q_WB_xyzw"].copy(),
        )

    def _asked(self) -> tuple[int, ...]:
        """Return the channels for the active command."""
        wx, wy, wz = self._inputs["w_WB_B"].tolist()
        full = math.radians(10.0 * self._tens)
        return _channels(
            roll=wx / full,
            pitch=wy / full,
            yaw=-wz / full,  # the stick to the right turns clockwise
            throttle=self._share(float(self._inputs["throttle"])),
            arm=True,
        )

    def _share(self, throttle: float) -> float:
        """Return the throttle stick in [0, 1] for the thrust of the configured curve."""
        config = self._config
        thrust = max(config.thrust(throttle) / config.motor_count, 0.0)
        speed = math.sqrt(thrust / config.rotors.thrust_coefficient)
        return (speed / config.rotors.speed_max - _IDLE_LEVEL) / (1.0 - _IDLE_LEVEL)


def motors_of(rotors: RotorParameters) -> tuple[list[int], bool]:
    """Return the firmware's motor of each rotor, and whether all spins are reversed.

    Raises :class:`ConfigurationError` for vehicles other than a quadrotor in X.
    """
    corners = [
        (float(np.sign(x)), float(np.sign(y))) for x, y in zip(rotors.x, rotors.y, strict=True)
    ]
    if sorted(corners) != sorted(_MOTORS):
        raise ConfigurationError(
            "simulator.rotors.x",
            rotors.x,
            "one rotor in each corner: the firmware flies a quadrotor in X",
        )
    motors = [_MOTORS.index(corner) for corner in corners]
    senses = {spin * _SPINS[motor] for spin, motor in zip(rotors.spin, motors, strict=True)}
    if len(senses) != 1:
        raise ConfigurationError(
            "simulator.rotors.spin", rotors.spin, "the same spin across each diagonal"
        )
    return motors, senses == {-1.0}


def _channels(
    *,
    roll: float = 0.0,
    pitch: float = 0.0,
    yaw: float = 0.0,
    throttle: float = -1.0,
    arm: bool = False,
) -> tuple[int, ...]:
    """Return the receiver's channels [us]: sticks in [-1, 1], throttle in [0, 1], idle below 0."""
    pulses = [PULSE_MIN] * _CHANNEL_COUNT
    for channel, stick in ((_ROLL, roll), (_PITCH, pitch), (_YAW, yaw)):
        pulses[channel] = _pulse(PULSE_MID + (PULSE_MAX - PULSE_MID) * stick)
    pulses[_THROTTLE] = _pulse(_MIN_PULSE + (PULSE_MAX - _MIN_PULSE) * throttle)
    pulses[_ARM] = PULSE_MAX if arm else PULSE_MIN
    return tuple(pulses)


def _pulse(width: float) -> int:
    return min(max(round(width), PULSE_MIN), PULSE_MAX)
