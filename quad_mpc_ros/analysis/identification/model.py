# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Response model of the identification, its residuals and their derivatives.

Commands act after the delay d; the throttle follows them with a first-order lag, the body rates
with a loop of second order,

    dw/dt = alpha,  T dalpha/dt = (gamma w_c(t - d) - w) / tau_w - alpha,
    ds/dt = (s_c(t - d) - s) / tau_s,
    dv/dt = g + (k T(s)/m + k_h (u_x^2 + u_y^2)) R e3 - R D R' v + a,   u = R' v,
    D = diag(mu + nu sqrt(k T(s)/(m g))),

which is the prediction model of the controller without its bound on the acceleration. tau_w, T,
gamma, mu and nu have a value for each axis. With a recorded battery voltage V, k is its value at
V_r times (V / V_r)^n; commands may already compensate for a part of n. Both lags are integrated
exactly between command times, which may be anywhere between odometries. The velocity is compared
over windows, each with a separate start: errors do not accumulate, and nothing is differentiated.
"""

from __future__ import annotations

import functools
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.analysis.identification.lag import LaggedCommands
from quad_mpc_ros.analysis.identification.measurements import Measurements
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, so3


class Linear(Record):
    """The parameters in which the velocity is linear."""

    scale: float  # thrust relative to the configured vehicle
    drag: Vector3  # 1/s
    lift: float  # 1/m
    rotor_drag: Vector3  # 1/s
    acceleration: Annotated[Array, (2,)]  # horizontal, in the world [m/s^2]


class Parameters(Record):
    """All parameters; the fit uses them as a vector (p,)."""

    rate_tau: Vector3  # time constants of the body rates [s]
    torque_tau: Vector3  # of their torques [s]
    rate_gain: Vector3
    thrust_tau: float  # time constant of the throttle [s]
    delay: float  # s
    linear: Linear
    rate_bias: Vector3  # of the measured body rates [rad/s]
    exponent: float  # of the voltage; left out without a recorded voltage


def _places(dtype: np.dtype[Any], start: int = 0) -> dict[str, slice]:
    """Return the slice of each field in a record that is viewed as a vector."""
    found = {}
    for name, (field, offset, *_) in (dtype.fields or {}).items():
        begin = start + offset // np.dtype(np.float64).itemsize
        found[name] = slice(begin, begin + field.itemsize // np.dtype(np.float64).itemsize)
        found |= _places(field, begin)
    return found


PLACES = _places(Parameters.dtype)
"""Slices of the parameters in their vector."""
RATE_TAU, RATE_GAIN, RATE_BIAS = (PLACES[f"rate_{name}"] for name in ("tau", "gain", "bias"))
TORQUE_TAU = PLACES["torque_tau"]
DRAG, ROTOR_DRAG, ACCELERATION = (PLACES[name] for name in ("drag", "rotor_drag", "acceleration"))
THRUST_TAU, DELAY, SCALE, LIFT, EXPONENT = (
    PLACES[name].start for name in ("thrust_tau", "delay", "scale", "lift", "exponent")
)
LINEAR_IN_VELOCITY = PLACES["linear"]
MOST_PARAMETERS = PLACES["exponent"].stop
_THRUST = _places(Linear.dtype)["scale"].start
_ROTORS = _places(Linear.dtype)["rotor_drag"]

WINDOW = 0.5  # s
_MIN_IN_WINDOW = 5
_MAX_GAP_PERIODS = 3.0  # periods
_STEP_SIZE = 1e-4  # s
# Each stretch has the direction of thrust in its middle [s].
_MAX_SUBSTEP = 0.01
_MAX_SUBSTEPS = 50  # in a gap, whose ends are in different windows


class ResponseModel:
    """Residuals of body rates (u, 3) and velocity (n, 3), with their derivatives.

    u of n odometries are usable; velocity residuals are zero outside of windows. ``blocks`` is the
    window of each odometry, ``parameters`` the number of parameters, p.
    """

    def __init__(self, data: Measurements) -> None:
        self._data = data
        self.parameters = MOST_PARAMETERS if data.knows_voltage else EXPONENT
        self.usable = np.flatnonzero(data.usable)
        self.blocks, self.in_window = _windows(data)
        self._interval = np.diff(data.time)
        self._turn = so3.log(np.swapaxes(data.R_WB[:-1], -1, -2) @ data.R_WB[1:])
        self._air = _air_columns(data)
        mean_voltage = 0.5 * (data.voltage[:-1] + data.voltage[1:])
        self._log_voltage = np.log(mean_voltage / data.reference_voltage)
        self._grid = _divided(data.time)
        # The last responses are cached, because a delay only shifts them.
        self._lag = functools.lru_cache(maxsize=8)(self._response)

    def rates(self, theta: Array) -> Array:
        """Return the modelled body rates (u, 3) [rad/s] of loops without a gain."""
        return self._rate_lag(theta).at(self._data.time[self.usable] - theta[DELAY])

    def _thrust_impulse(self, theta: Array) -> tuple[Array, Array]:
        """Return the velocity changes (n-1, 3) [m/s] from the modelled thrust between odometries.

        The second result is the mean rotor speed (n-1,), relative to hover.
        """
        data, vehicle, delay = self._data, self._data.vehicle, theta[DELAY]
        edges = data.command_time + delay
        inside = edges[(edges > data.time[0]) & (edges < data.time[-1])]
        breaks = np.sort(np.concatenate((self._grid, inside)))
        start, duration = breaks[:-1], np.diff(breaks)
        middle = start + 0.5 * duration
        interval = np.clip(
            np.searchsorted(data.time, middle, side="right") - 1, 0, len(self._interval) - 1
        )
        lag = self._lag("thrust", (theta[THRUST_TAU],), (0.0,))
        mean, mean_square = lag.means(start - delay, duration)
        a, b, c = vehicle.thrust_curve
        thrust = vehicle.motor_count * (a * mean_square + b * mean + c)[:, 0]
        axis = self._thrust_axis(theta, start, duration, interval)
        push = (duration * thrust / vehicle.mass)[:, None] * axis
        speed = np.sqrt(np.maximum(thrust, 0.0) / (vehicle.mass * vehicle.gravity))
        *impulse, turned = (
            np.bincount(interval, weights, minlength=len(self._interval))
            for weights in (*push.T, duration * speed)
        )
        return np.column_stack(impulse), turned / self._interval

    def _thrust_axis(
        self, theta: Array, start: Array, duration: Array, interval: NDArray[np.intp]
    ) -> Array:
        """Return the thrust direction in the world in the middle of intervals (k, 3).

        From each measured attitude the direction is rotated by the modelled rates, because
        commands change the rates within an interval. The difference to the next measured attitude
        is distributed evenly.
        """
        half = 0.5 * duration
        lag, angle = self._rate_lag(theta), half[:, None] * theta[RATE_GAIN]
        first = angle * lag.means(start - theta[DELAY], half)[0]
        second = angle * lag.means(start + half - theta[DELAY], half)[0]
        turned = np.concatenate((np.zeros((1, 3)), np.cumsum(first + second, axis=0)))
        begins = np.searchsorted(interval, np.arange(len(self._interval) + 1))
        whole = turned[begins[1:]] - turned[begins[:-1]]
        share = (start + half - self._data.time[interval]) / self._interval[interval]
        turn = turned[:-1] + first - turned[begins[interval]]
        turn += share[:, None] * (self._turn - whole)[interval]
        return np.asarray((self._data.R_WB[interval] @ so3.exp(turn))[..., 2])

    def increments(self, theta: Array) -> Array:
        """Return the derivatives (n-1, 3, 10) of velocity changes with respect to Linear."""
        columns = Linear.zeros(len(self._interval), 3)
        columns["scale"], speed = self._thrust_impulse(theta)
        if self._data.knows_voltage:
            share = np.exp((theta[EXPONENT] - self._data.compensated) * self._log_voltage)
            columns["scale"] *= share[:, None]
            speed *= np.sqrt(share)
        columns["drag"], columns["lift"] = self._air
        columns["rotor_drag"] = np.sqrt(theta[SCALE]) * speed[:, None, None] * columns["drag"]
        for axis, along in enumerate(np.moveaxis(columns["acceleration"], -1, 0)):
            along[:, axis] = self._interval
        return np.asarray(columns).view(np.float64).reshape(*columns.shape, -1)

    def velocity_columns(self, theta: Array) -> tuple[Array, Array]:
        """Return the velocity (n, 3) without gravity and its derivatives (n, 3, 10).

        Both results are relative to the means of their windows. The derivatives are sums of the
        derivatives of :meth:`increments`.
        """
        return self._relative_to_windows(self.increments(theta))

    def _relative_to_windows(self, columns: Array) -> tuple[Array, Array]:
        fall = np.zeros((len(self._interval), 3))
        fall[:, 2] = self._data.vehicle.gravity * self._interval
        left = self._data.v_WB_W + _summed(fall)
        return self.relative(left), self.relative(_summed(columns))

    def relative(self, values: Array) -> Array:
        """Return values (n, ...) minus the mean of their window, and zero outside of windows."""
        flat = values.reshape(len(values), -1)
        count = np.bincount(self.blocks, self.in_window, minlength=self.blocks[-1] + 1)
        mean = (
            np.column_stack(
                [
                    np.bincount(self.blocks, self.in_window * column, minlength=len(count))
                    for column in flat.T
                ]
            )
            / np.maximum(count, 1.0)[:, None]
        )
        inside = (flat - mean[self.blocks]) * self.in_window[:, None]
        return np.asarray(inside.reshape(values.shape))

    def residuals(self, theta: Array) -> tuple[Array, Array]:
        """Return measured minus modelled body rates (u, 3) and velocities (n, 3)."""
        modelled = self.rates(theta)
        rates = self._data.w_WB_B[self.usable] - theta[RATE_GAIN] * modelled - theta[RATE_BIAS]
        left, columns = self.velocity_columns(theta)
        return rates, left - columns @ theta[LINEAR_IN_VELOCITY]

    def jacobians(self, theta: Array, *, difference: float = _STEP_SIZE) -> tuple[Array, Array]:
        """Return the derivatives of both residuals, (u, 3, p) and (n, 3, p).

        Derivatives with respect to times are central differences over ``difference`` [s] to both
        sides. The small effect of lags and gains of the rates on the velocity, through the
        direction of thrust between two measured attitudes, is neglected.
        """
        rates = np.zeros((len(self.usable), 3, self.parameters))
        velocity = np.zeros((len(self._data.time), 3, self.parameters))
        increments = self.increments(theta)
        _, columns = self._relative_to_windows(increments)
        velocity[:, :, LINEAR_IN_VELOCITY] = -columns
        by_speed = columns[:, :, _ROTORS] @ theta[ROTOR_DRAG]
        velocity[:, :, SCALE] -= 0.5 / theta[SCALE] * by_speed
        if self._data.knows_voltage:
            by_power = theta[SCALE] * increments[:, :, _THRUST]
            by_power += 0.5 * increments[:, :, _ROTORS] @ theta[ROTOR_DRAG]
            by_power *= self._log_voltage[:, None]
            velocity[:, :, EXPONENT] = -self.relative(_summed(by_power))
        modelled = self.rates(theta)
        for axis in range(3):
            rates[:, axis, RATE_BIAS.start + axis] = -1.0
            rates[:, axis, RATE_GAIN.start + axis] = -modelled[:, axis]
        for constants in (RATE_TAU, TORQUE_TAU):
            above, below, span = _beside(theta, constants, difference)
            slower = self.rates(above)
            faster = self.rates(below)
            by_tau = theta[RATE_GAIN] * (slower - faster) / span
            for axis in range(3):
                rates[:, axis, constants.start + axis] = -by_tau[:, axis]
        # The difference is larger than rounding, because residuals have kinks at commands.
        for parameter in (THRUST_TAU, DELAY):
            above, below, span = _beside(theta, parameter, difference)
            high, low = self.residuals(above), self.residuals(below)
            rates[:, :, parameter] = (high[0] - low[0]) / span
            velocity[:, :, parameter] = (high[1] - low[1]) / span
        return rates, velocity

    def _rate_lag(self, theta: Array) -> LaggedCommands:
        return self._lag("rate", _key(theta[RATE_TAU]), _key(theta[TORQUE_TAU]))

    def _response(
        self, channel: str, time_constant: tuple[float, ...], torque: tuple[float, ...]
    ) -> LaggedCommands:
        """Return the response of the body rates (``rate``) or of the throttle (``thrust``)."""
        data = self._data
        command = data.w_command if channel == "rate" else data.throttle[:, None]
        return LaggedCommands(
            data.command_time, command, time_constant=time_constant, torque_time_constant=torque
        )


def _key(time_constants: ArrayLike) -> tuple[float, ...]:
    return tuple(np.ravel(time_constants).tolist())


def _beside(
    theta: Array, parameters: int | slice, difference: float
) -> tuple[Array, Array, Array]:
    """Return parameters with longer and with shorter times, and the difference of these times."""
    above, below = theta.copy(), theta.copy()
    above[parameters] += difference
    below[parameters] = np.maximum(below[parameters] - difference, 0.0)
    return above, below, np.asarray(above[parameters] - below[parameters])


def _air_columns(data: Measurements) -> tuple[Array, Array]:
    """Return velocity changes (n-1, 3, 3) per drag of each axis, and (n-1, 3) per lift."""
    v_WB_B = np.einsum("nji,nj->ni", data.R_WB, data.v_WB_W)
    drag = -data.R_WB * v_WB_B[:, None, :]
    across = np.sum(v_WB_B[:, :2] ** 2, axis=1)
    lift = data.R_WB[:, :, 2] * across[:, None]
    interval = np.diff(data.time)[:, None]
    return (
        np.asarray(0.5 * interval[..., None] * (drag[:-1] + drag[1:])),
        np.asarray(0.5 * interval * (lift[:-1] + lift[1:])),
    )


def _divided(time: Array) -> Array:
    """Return times with inserted times, at most the longest interval apart.

    Gaps may have any length, because a clock may have been set.
    """
    parts = np.clip(np.ceil(np.diff(time) / _MAX_SUBSTEP), 1.0, _MAX_SUBSTEPS)
    parts = parts.astype(np.intp)
    first = np.repeat(np.arange(len(parts)), parts)
    number = np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)
    inside = time[first] + number / parts[first] * np.diff(time)[first]
    return np.append(inside, time[-1])


def _summed(increments: Array) -> Array:
    """Return sums (n, ...) of the increments (n-1, ...) up to each odometry."""
    return np.concatenate((np.zeros((1, *increments.shape[1:])), np.cumsum(increments, axis=0)))


def _windows(data: Measurements) -> tuple[NDArray[np.intp], Array]:
    """Return the window of each odometry (n,), and 1 for odometries in usable windows, else 0."""
    longest_gap = _MAX_GAP_PERIODS * data.period
    block = np.zeros(len(data.time), dtype=np.intp)
    current, start = 0, data.time[0]
    for i in range(1, len(data.time)):
        broken = (
            data.usable[i] != data.usable[i - 1]
            or data.time[i] - data.time[i - 1] > longest_gap
            or data.time[i] - start >= WINDOW
        )
        if broken:
            current, start = current + 1, data.time[i]
        block[i] = current
    enough = np.bincount(block) >= _MIN_IN_WINDOW
    return block, (data.usable & enough[block]).astype(np.float64)
