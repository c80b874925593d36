# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Results of an identification, with their uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

from quad_mpc_ros.control.lie import Array


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """A fitted value with half of its 95 % confidence interval.

    ``seen``: the flight excites the parameter. ``observable``: the interval is narrow enough to be
    useful; excitation alone is not enough. ``at_bound``: the value is at a bound of the search and
    therefore not usable.
    """

    value: float
    half_width: float
    seen: bool
    observable: bool
    at_bound: bool = False


@dataclass(frozen=True, kw_only=True)
class ThrustOverVoltage:
    """Exponent of the thrust over the battery's voltage, relative to ``reference`` [V].

    The thrust scale holds at this voltage. The recorded commands were already compensated with
    the exponent ``compensated``.
    """

    exponent: ParameterEstimate
    reference: float
    compensated: float

    @property
    def falls(self) -> bool:
        """Whether the thrust falls significantly with the voltage."""
        return self.exponent.observable and self.exponent.value > self.exponent.half_width


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedCourse:
    """Measured and fitted over time, shapes (n,), (n, k), (n, k)."""

    time: Array
    measured: Array
    fitted: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """Fitted time constants and delay [s], relative thrust, and drag [1/s].

    Time constants of rates and torques, gains and drag have a value for each body axis. Parameters
    that are not observable were held at their configured values while the others were fitted;
    their estimates are from the previous fit. ``rotor_drag`` [1/s] is the drag that grows with the
    rotor speed.

    ``thrust_scale`` scales the thrust per mass of the configured vehicle, because only the
    quotient is observable.
    ``wind_acceleration_W`` (2,) [m/s^2] is a constant horizontal acceleration, mainly wind.
    ``rates`` are body rates [rad/s], ``specific_force`` is along the thrust axis [m/s^2], averaged
    over a few odometries. ``over_voltage`` is None without a battery voltage. ``misfit`` are the
    residuals of body rates and velocity beyond noise, as shares of their variation. ``flown`` is
    the time under commands [s], ``fitted`` the part of it that was used.
    """

    rate_time_constant: tuple[ParameterEstimate, ...]
    torque_time_constant: tuple[ParameterEstimate, ...]
    rate_gain: tuple[ParameterEstimate, ...]
    thrust_time_constant: ParameterEstimate
    input_delay: ParameterEstimate
    thrust_scale: ParameterEstimate
    drag: tuple[ParameterEstimate, ...]
    translational_lift: ParameterEstimate
    rotor_drag: tuple[ParameterEstimate, ...]
    over_voltage: ThrustOverVoltage | None
    wind_acceleration_W: Array
    rate_residual: float
    velocity_residual: float
    misfit: tuple[float, float]
    rates: FittedCourse
    specific_force: FittedCourse
    flown: float
    fitted: float

    @property
    def latency_half_width(self) -> float | None:
        """Half width of the 95 % interval of the latency of roll and pitch [s].

        The latency is the sum of both time constants and the delay, whose estimates are taken as
        independent. None if one of them is not observable.
        """
        loops = zip(self.rate_time_constant[:2], self.torque_time_constant[:2], strict=True)
        sums = [(*loop, self.input_delay) for loop in loops]
        if not all(part.observable for parts in sums for part in parts):
            return None
        return max(math.hypot(*(part.half_width for part in parts)) for parts in sums)
