# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The interface of plants, and a base class with time, command delay, steady wind and gusts."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from typing import Protocol, runtime_checkable

import numpy as np

from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3, Vector4
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, RotorCommand
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.simulation.parameters import PlantParameters, Stream, white_noise

NEVER_NS = 2**63 - 1
_GUST_PERIOD_NS = 10_000_000
_LOWEST_AIRSPEED = 1.0
SIMULATION_START_NS = 1_000_000_000
"""Start of simulated time; not zero, which ROS treats as "no time yet"."""

_MAX_BODY_RATE = 1e3  # rad/s, far beyond any vehicle


class Wind:
    """Steady wind and Dryden gusts, world axes, m/s.

    Each axis of the gusts is white noise through the longitudinal Dryden filter of MIL-F-8785C
    and MIL-HDBK-1797,

        H(s) = sigma sqrt(2 L / (pi V)) / (1 + s L / V),

    with the intensity sigma, the scale length L and the airspeed V. The filter is discretised
    exactly, with 100 values per second that are held in between: g' = a g + sigma sqrt(1 - a^2) n
    with a = exp(-V dt / L) and n from N(0, 1), which keeps the variance at sigma^2. The standards
    use a second-order filter across the flight path. A hovering vehicle has no flight path, so all
    axes have the same filter. V is the airspeed in the steady wind, but at least 1 m/s, because
    otherwise the gusts would be constant at hover.
    """

    def __init__(self, config: PlantParameters) -> None:
        self._steady_W = np.array(config.wind)
        self._intensity, self._length = config.gust_intensity, config.gust_length
        self._noise = white_noise(config.random(Stream.GUSTS), 3)
        self._gust_W = np.zeros(3)
        self.next_ns = NEVER_NS
        """Time of the next change of the gusts."""
        if self._intensity > 0.0:
            self._gust_W = self._intensity * next(self._noise)
            self.next_ns = _GUST_PERIOD_NS
        self.velocity_W: Array = self._steady_W + self._gust_W
        """Velocity of the air (3,) [m/s]."""

    def advance_to(self, time_ns: int, *, v_WB_W: Array) -> None:
        """Update the gusts up to a time, for a vehicle with a velocity (3,) [m/s]."""
        while self.next_ns <= time_ns:
            through_air = v_WB_W - self._steady_W
            self._change(math.sqrt(through_air.dot(through_air)))
            self.next_ns += _GUST_PERIOD_NS

    def _change(self, airspeed: float) -> None:
        passed = max(airspeed, _LOWEST_AIRSPEED) * _GUST_PERIOD_NS * 1e-9
        kept = math.exp(-passed / self._length)
        fresh = self._intensity * math.sqrt(1.0 - kept * kept)
        self._gust_W = kept * self._gust_W + fresh * next(self._noise)
        self.velocity_W = self._steady_W + self._gust_W


class Plant(Protocol):
    """A simulated vehicle; times are in nanoseconds from its start.

    A plant with the attribute ``follows_rotors = True`` follows a :class:`.RotorCommand`.
    """

    def apply(self, command: CommandSample) -> None:
        """Take a command that arrives now."""

    def advance_to(self, time_ns: int) -> None:
        """Advance to a time; a past time changes nothing."""

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry with the given stamp."""


class PlantInputs(Record):
    """Constant inputs of a vehicle."""

    throttle: float  # 0 to 1
    w_WB_B: Vector3  # commanded body rates [rad/s]
    wind_W: Vector3  # velocity of the air [m/s]


class Measured(Record):
    """The true motion of the body's origin, as an odometry reports it."""

    p_WB: Vector3  # m
    q_WB_xyzw: Vector4
    v_WB_B: Vector3  # m/s
    w_WB_B: Vector3  # rad/s


@runtime_checkable
class Powered(Protocol):
    """A plant with a battery voltage."""

    @property
    def battery_voltage(self) -> float | None:
        """Voltage of the battery [V]; None for a constant voltage."""


def odometry_of(
    measured: RecordArray[Measured], config: PlantParameters, *, stamp_ns: int
) -> OdometrySample:
    """Return a measurement as an odometry with a stamp."""
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=measured["p_WB"],
        q_WB_xyzw=measured["q_WB_xyzw"],
        v_WB_B=measured["v_WB_B"],
        w_WB_B=measured["w_WB_B"],
        frame_id=config.frame_id,
        child_frame_id=config.child_frame_id,
    )


class DelayedPlant(ABC):
    """A plant whose commands act after a delay, in wind and gusts.

    Derived classes implement :meth:`_integrate` and :meth:`_follow`. Steps end when a command
    starts to act and when the gusts change.
    """

    def __init__(self, config: PlantParameters) -> None:
        self._vehicle = config.vehicle()
        self._delay_ns = round(config.command_delay * 1e9)
        self._waiting: deque[tuple[int, Input, Array | None]] = deque()
        self._rotor_throttles: Array | None = None
        self._wind = Wind(config)
        self.time_ns = 0
        """Time of the state, from the start of the plant."""

    @property
    @abstractmethod
    def v_WB_W(self) -> Array:
        """True velocity (3,) [m/s]."""

    @abstractmethod
    def _follow(self, command: Input) -> None:
        """Set the active command."""

    @abstractmethod
    def _integrate(self, duration_ns: int) -> None:
        """Integrate the state over a time with constant command and wind."""

    @property
    def wind_W(self) -> Array:
        """Velocity of the air (3,) [m/s]."""
        return self._wind.velocity_W

    def apply(self, command: CommandSample) -> None:
        """Take a command that arrives now. The throttle saturates; commands with non-finite values
        or implausible rates are ignored."""
        rates = command.w_WB_B.tolist()
        if not (math.isfinite(command.throttle) and all(abs(w) <= _MAX_BODY_RATE for w in rates)):
            return
        throttle = min(max(command.throttle, 0.0), 1.0)
        u = Input(throttle=throttle, w_WB_B=command.w_WB_B.copy())
        rotors = command.rotor_throttles if isinstance(command, RotorCommand) else None
        self._waiting.append((self.time_ns + self._delay_ns, u, rotors))
        self._follow_commands()

    def advance_to(self, time_ns: int) -> None:
        """Integrate to a time; a past time changes nothing."""
        while self.time_ns < time_ns:
            command_ns = self._waiting[0][0] if self._waiting else NEVER_NS
            until_ns = min(time_ns, command_ns, self._wind.next_ns)
            self._integrate(until_ns - self.time_ns)
            self.time_ns = until_ns
            self._follow_commands()
            if self._wind.next_ns <= until_ns:
                self._wind.advance_to(until_ns, v_WB_W=self.v_WB_W)

    def _follow_commands(self) -> None:
        newest = None
        while self._waiting and self._waiting[0][0] <= self.time_ns:
            _, newest, self._rotor_throttles = self._waiting.popleft()
        if newest is not None:
            self._follow(newest)
