# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fit of the response model: coarse search, robust least squares, confidence intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student_t

from quad_mpc_ros.analysis.identification.measurements import (
    RECORDED,
    Measurements,
    measurements_of,
    recorded_bridge,
)
from quad_mpc_ros.analysis.identification.model import (
    ACCELERATION,
    DELAY,
    DRAG,
    EXPONENT,
    LIFT,
    LINEAR_IN_VELOCITY,
    MOST_PARAMETERS,
    PLACES,
    RATE_BIAS,
    RATE_GAIN,
    RATE_TAU,
    ROTOR_DRAG,
    SCALE,
    THRUST_TAU,
    TORQUE_TAU,
    ResponseModel,
)
from quad_mpc_ros.analysis.identification.result import (
    FittedCourse,
    Identification,
    ParameterEstimate,
    ThrustOverVoltage,
)
from quad_mpc_ros.configuration import BagError, per_axis
from quad_mpc_ros.configuration.arguments import instance
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.recording import Recording

# Grid that is searched before the fit, which finds only the nearest minimum [s].
_TIME_CONSTANTS = (0.003, 0.01, 0.02, 0.04, 0.08, 0.16, 0.3)
_DELAYS = np.arange(0.0, 0.301, 0.02)


class _ParameterRange(NamedTuple):
    """Search range and natural size of a parameter.

    The parameter is not observable if half of its 95 % confidence interval exceeds both ``share``
    of its value and ``vague``.
    """

    lowest: float
    highest: float
    size: float
    share: float = 0.0
    vague: float = np.inf


_PARAMETER_RANGES = {
    "rate_tau": _ParameterRange(0.0, 1.0, 0.03, share=0.5, vague=0.01),
    "torque_tau": _ParameterRange(0.0, 1.0, 0.03, share=0.5, vague=0.01),
    "rate_gain": _ParameterRange(0.2, 3.0, 0.3, vague=0.1),
    "thrust_tau": _ParameterRange(0.0, 1.0, 0.03, share=0.5, vague=0.01),
    "delay": _ParameterRange(0.0, 0.5, 0.03, share=0.5, vague=0.01),
    "scale": _ParameterRange(0.1, 10.0, 1.0, share=0.5, vague=0.1),
    "drag": _ParameterRange(0.0, 10.0, 0.3, share=0.5, vague=0.1),
    "lift": _ParameterRange(-0.5, 0.5, 0.02, share=0.5, vague=0.01),
    "rotor_drag": _ParameterRange(0.0, 10.0, 0.3, share=0.5, vague=0.1),
    "acceleration": _ParameterRange(-20.0, 20.0, 1.0),
    "rate_bias": _ParameterRange(-5.0, 5.0, 0.1),
    "exponent": _ParameterRange(-1.0, 4.0, 1.0, vague=0.5),
}


def _vectors() -> Array:
    """Return one vector (25,) for each field of :class:`_ParameterRange`, in their order."""
    vectors = np.empty((len(_ParameterRange._fields), MOST_PARAMETERS))
    for name, known in _PARAMETER_RANGES.items():
        vectors[:, PLACES[name]] = np.array(known)[:, None]
    return vectors


_LOWEST, _HIGHEST, _SIZES, _MAX_RELATIVE_WIDTHS, _MAX_WIDTHS = _vectors()
_REPORTED = np.isfinite(_MAX_WIDTHS)
_ARE_TIMES = np.isin(np.arange(MOST_PARAMETERS), np.r_[RATE_TAU, TORQUE_TAU, THRUST_TAU, DELAY])

# Smaller residuals contain no information, only rounding and effects that are not modelled.
_MIN_SPREAD_RATE, _MIN_SPREAD_VELOCITY = 0.02, 0.005  # rad/s, m/s
_MIN_VARIED_RATE, _MIN_VARIED_VELOCITY = 0.3, 0.1  # rad/s, m/s
_MAD_TO_SIGMA = 1.4826
_OUTLIER_SPREADS = 2.0  # spreads above which a residual has less weight
_ROUNDS = 2
_AT_BOUND = 1e-3  # of the size of a parameter
_PRIOR_WEIGHT = 1e-6  # of a prior with the natural size of a parameter
_CORRELATED_WINDOWS = 4  # neighbouring windows with correlated residuals
_TIME_STEP = 0.005  # s; shorter steps do not resolve lags faster than the odometry
# Parameters that affect the velocity, without the drag of the rotors, which is rarely observable.
_VELOCITY_PARAMETERS = 10
_MIN_WINDOWS = _VELOCITY_PARAMETERS + 2

# No interval is narrower than this share of the value, the accuracy of the model.
_MIN_RELATIVE_WIDTH = 0.01
# The drag of the rotors is fitted only if it differs from the configured value by this many half
# intervals (by chance once in a hundred flights), because it blurs the drag of the body.
_SIGNIFICANT_HALF_WIDTHS = 1.2

_MAX_ODOMETRIES = 30_000  # ten minutes at 50 Hz; more needs memory without a benefit
_AVERAGING_TIME = 0.08  # s, of the specific force in the figure


@dataclass(frozen=True, kw_only=True)
class _Spread:
    rate: float
    velocity: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """Parameters; halves of their 95 % confidence intervals, joint and individual; all (p,)."""

    theta: Array
    half_width: Array
    alone: Array

    @property
    def enough(self) -> Array:
        """Largest useful half intervals (p,).

        If drags of body and rotors are both fitted, mostly their sum is observable.
        """
        p = len(self.theta)
        enough = np.maximum(_MAX_RELATIVE_WIDTHS[:p] * self.theta, _MAX_WIDTHS[:p])
        both = np.where(self.half_width[ROTOR_DRAG] > 0.0, self.theta[ROTOR_DRAG], -np.inf)
        both += self.theta[DRAG]
        for drag in (DRAG, ROTOR_DRAG):
            enough[drag] = np.maximum(enough[drag], both)
        return np.asarray(enough)

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """Whether each parameter is at a bound of its search range, except a bound of 0."""
        theta, p = self.theta, len(self.theta)
        margin = _AT_BOUND * _SIZES[:p]
        low = (theta <= _LOWEST[:p] + margin) & (_LOWEST[:p] != 0.0)
        return np.asarray(_REPORTED[:p] & (low | (theta >= _HIGHEST[:p] - margin)))

    def estimates(self, which: NDArray[np.intp], *, free: bool) -> dict[int, ParameterEstimate]:
        """Return the estimates of some parameters; ``free`` parameters are not fixed."""
        least = _MIN_RELATIVE_WIDTH * np.abs(self.theta)
        width, enough, at_bound = np.maximum(self.half_width, least), self.enough, self.at_bound
        return {
            p: ParameterEstimate(
                value=float(self.theta[p]),
                half_width=float(width[p]),
                seen=bool(self.alone[p] <= enough[p]),
                observable=bool(free and not at_bound[p]),
                at_bound=bool(at_bound[p]),
            )
            for p in which.tolist()
        }


def identify(recording: Recording) -> Identification:
    """Identify the vehicle of a recording, relative to its recorded parameters.

    Args:
        recording: Odometry and commands of one vehicle.

    Returns:
        Time constants and delay [s], thrust per mass relative to the recorded vehicle, drag [1/s],
        each with its 95 % confidence interval.

    Raises:
        BagError: The recording has too little flight under commands.
        ArgumentError: The argument is not a recording.
    """
    instance(recording, "recording", Recording)
    given = MpcConfig.build(recording.parameters_of(MpcConfig))
    run = recording.run(topics=RECORDED)
    measured = measurements_of(
        run,
        vehicle=given.vehicle(),
        twist_frame=given.odometry.twist_frame,
        bridge=recorded_bridge(run.parameters),
    )
    return fit(measured, given=given)


def fit(measured: Measurements, *, given: MpcConfig) -> Identification:
    """Fit lags, delay, thrust scale and drag to a flight, or to parts of a long flight.

    Parameters that are not observable are fixed at the values ``given``, one after the other,
    until all others are observable. Raises :class:`BagError` if the flight is too short.
    """
    data = measured.thinned(_MAX_ODOMETRIES)
    model = ResponseModel(data)
    windows = len(np.unique(model.blocks[model.in_window > 0.0]))
    if windows < _MIN_WINDOWS:
        raise BagError(
            f"{windows} flight segments of half a second under commands, expected "
            f"{_MIN_WINDOWS} or more: record a longer flight"
        )
    theta, held = _searched(model, data), _as_given(given, data)[: model.parameters]
    estimates: dict[int, ParameterEstimate] = {}
    free = np.ones(model.parameters, dtype=bool)
    while True:
        found = _fit(model, theta, free)
        theta, unobservable = found.theta.copy(), _unobservable(found, free, held)
        if not len(unobservable):
            break
        estimates |= found.estimates(unobservable, free=False)
        theta[unobservable], free[unobservable] = held[unobservable], False
    estimates |= found.estimates(np.flatnonzero(free & _REPORTED[: len(free)]), free=True)
    axes = {
        name: tuple(estimates[p] for p in range(PLACES[name].start, PLACES[name].stop))
        for name in ("rate_tau", "torque_tau", "rate_gain", "drag", "rotor_drag")
    }
    rates, velocity = model.residuals(theta)
    measured_rates = data.w_WB_B[model.usable]
    return Identification(
        rate_time_constant=axes["rate_tau"],
        torque_time_constant=axes["torque_tau"],
        rate_gain=axes["rate_gain"],
        thrust_time_constant=estimates[THRUST_TAU],
        input_delay=estimates[DELAY],
        thrust_scale=estimates[SCALE],
        drag=axes["drag"],
        translational_lift=estimates[LIFT],
        rotor_drag=axes["rotor_drag"],
        over_voltage=_over_voltage(estimates, data),
        wind_acceleration_W=theta[ACCELERATION],
        rate_residual=_root_mean_square(rates),
        velocity_residual=_root_mean_square(velocity[model.in_window > 0.0]),
        misfit=_misfit(model, data, rates, velocity),
        rates=FittedCourse(
            time=data.time[model.usable], measured=measured_rates, fitted=measured_rates - rates
        ),
        specific_force=_specific_force(model, data, theta),
        flown=measured.flown,
        fitted=data.flown,
    )


def _over_voltage(
    estimates: Mapping[int, ParameterEstimate], data: Measurements
) -> ThrustOverVoltage | None:
    if not data.knows_voltage:
        return None
    exponent = estimates[EXPONENT]
    # Without excitation the exponent reaches a bound by chance.
    at_bound = exponent.at_bound and exponent.seen
    return ThrustOverVoltage(
        exponent=dataclasses.replace(exponent, at_bound=at_bound),
        reference=data.reference_voltage,
        compensated=data.compensated,
    )


def _as_given(given: MpcConfig, data: Measurements) -> Array:
    """Return the parameters (25,) of a configuration, with a thrust scale of 1.

    The exponent of the voltage is the exponent of the compensation.
    """
    theta = np.zeros(MOST_PARAMETERS)
    theta[RATE_TAU] = per_axis(given.rate_time_constant)
    theta[TORQUE_TAU] = per_axis(given.torque_time_constant)
    theta[RATE_GAIN], theta[SCALE] = per_axis(given.rate_gain), 1.0
    theta[THRUST_TAU], theta[DELAY] = given.thrust_time_constant, given.input_delay
    theta[DRAG], theta[LIFT] = per_axis(given.drag), given.translational_lift
    theta[ROTOR_DRAG], theta[EXPONENT] = per_axis(given.rotor_drag), data.compensated
    return theta


def _fit(model: ResponseModel, theta: Array, free: NDArray[np.bool_]) -> _Fit:
    """Fit the free parameters, starting at ``theta`` (p,)."""
    for _ in range(_ROUNDS):
        spread = _spread(model, theta)
        theta = _fitted(model, theta, spread, free)
    half_width, alone = _half_widths(model, theta, spread, free)
    # Lags much shorter than the odometry period cannot be distinguished from zero.
    short = _ARE_TIMES[: len(theta)] & (theta < _TIME_STEP)
    half_width[short] = np.maximum(half_width, theta)[short]
    return _Fit(theta=theta, half_width=half_width, alone=alone)


def _unobservable(found: _Fit, free: NDArray[np.bool_], given: Array) -> NDArray[np.intp]:
    """Return the parameters without excitation, otherwise the least observable parameter, if any.

    Only one parameter is returned, as fixing it may make the others observable. The drag of the
    rotors comes first if it does not differ from the configured value, ``given`` (p,).
    """
    off = np.abs(found.theta - given)[ROTOR_DRAG]
    alike = free[ROTOR_DRAG] & (off <= _SIGNIFICANT_HALF_WIDTHS * found.half_width[ROTOR_DRAG])
    if alike.any():
        return np.asarray(ROTOR_DRAG.start + np.flatnonzero(alike))
    # A configured value is not kept if the flight contradicts it, however roughly.
    vague = free & (np.abs(found.theta - given) <= _SIGNIFICANT_HALF_WIDTHS * found.half_width)
    width = np.where(vague, found.half_width / found.enough, 0.0)
    alone = np.where(free, found.alone / found.enough, 0.0)
    unseen = np.flatnonzero((alone > 1.0) | (free & found.at_bound))
    if len(unseen):
        return unseen
    return np.flatnonzero((width > 1.0) & (width == width.max()))


def _misfit(
    model: ResponseModel, data: Measurements, rates: Array, velocity: Array
) -> tuple[float, float]:
    """Return the residuals of body rates and velocity beyond noise, as shares of their variation.

    Residuals that last longer than one odometry are not noise. The variation has a lower bound.
    """
    inside = model.in_window > 0.0
    neighbours = np.diff(model.usable) == 1
    together = inside[1:] & (np.diff(model.blocks) == 0)
    measured = data.w_WB_B[model.usable]
    return (
        _lasting(
            rates,
            np.diff(rates, axis=0)[neighbours],
            max(_root_mean_square(measured - measured.mean(axis=0)), _MIN_VARIED_RATE),
        ),
        _lasting(
            velocity[inside],
            np.diff(velocity, axis=0)[together],
            max(_root_mean_square(model.relative(data.v_WB_W)[inside]), _MIN_VARIED_VELOCITY),
        ),
    )


def _lasting(left: Array, steps: Array, varied: float) -> float:
    lasting = float(np.mean(left**2)) - 0.5 * float(np.mean(steps**2))
    return float(np.sqrt(max(lasting, 0.0))) / varied


def _searched(model: ResponseModel, data: Measurements) -> Array:
    """Return the best parameters of a grid of time constants and delays, without torque lags."""
    measured = data.w_WB_B[model.usable]
    shape = (len(_TIME_CONSTANTS), len(_DELAYS))
    rate_cost, thrust_cost = np.empty((*shape, 3)), np.empty(shape)
    linear = np.empty((*shape, LINEAR_IN_VELOCITY.stop - LINEAR_IN_VELOCITY.start))
    constants = np.array(_TIME_CONSTANTS)
    theta = np.zeros(model.parameters)
    theta[RATE_GAIN] = theta[SCALE] = 1.0
    if data.knows_voltage:
        theta[EXPONENT] = data.compensated
    for j, delay in enumerate(_DELAYS):
        theta[DELAY] = delay
        for i, tau in enumerate(_TIME_CONSTANTS):
            theta[RATE_TAU] = tau
            off = measured - model.rates(theta)
            rate_cost[i, j] = np.sum((off - off.mean(axis=0)) ** 2, axis=0)
        theta[RATE_TAU] = constants[np.argmin(rate_cost[:, j], axis=0)]
        for i, tau in enumerate(_TIME_CONSTANTS):
            theta[THRUST_TAU] = tau
            left, columns = model.velocity_columns(theta)
            A, b = columns.reshape(-1, columns.shape[-1]), left.ravel()
            linear[i, j] = np.linalg.lstsq(A, b, rcond=1e-6)[0]
            thrust_cost[i, j] = np.sum((b - A @ linear[i, j]) ** 2)
    # All channels share the delay; each is weighted by its smallest residuals.
    total = sum(
        np.min(cost, axis=0) / _scale(cost, _MIN_SPREAD_RATE, len(measured))
        for cost in np.moveaxis(rate_cost, -1, 0)
    ) + np.min(thrust_cost, axis=0) / _scale(
        thrust_cost, _MIN_SPREAD_VELOCITY, 3.0 * float(np.sum(model.in_window))
    )
    j = int(np.argmin(total))
    i_thrust = int(np.argmin(thrust_cost[:, j]))
    theta[RATE_TAU] = constants[np.argmin(rate_cost[:, j], axis=0)]
    theta[THRUST_TAU], theta[DELAY] = _TIME_CONSTANTS[i_thrust], _DELAYS[j]
    theta[LINEAR_IN_VELOCITY] = linear[i_thrust, j]
    theta[RATE_BIAS] = (measured - model.rates(theta)).mean(axis=0)
    margin = 1e-3 * _SIZES[: len(theta)]
    return np.clip(theta, _LOWEST[: len(theta)] + margin, _HIGHEST[: len(theta)] - margin)


def _scale(cost: Array, least_spread: float, count: float) -> float:
    return max(float(cost.min()) / count, least_spread**2)


def _spread(model: ResponseModel, theta: Array) -> _Spread:
    """Return the spread of the residuals from their median, which is robust to outliers."""
    rates, velocity = model.residuals(theta)
    inside = velocity[model.in_window > 0.0]
    return _Spread(
        rate=max(_MAD_TO_SIGMA * float(np.median(np.abs(rates))), _MIN_SPREAD_RATE),
        velocity=max(_MAD_TO_SIGMA * float(np.median(np.abs(inside))), _MIN_SPREAD_VELOCITY),
    )


def _fitted(model: ResponseModel, start: Array, spread: _Spread, free: NDArray[np.bool_]) -> Array:
    def scaled(rates: Array, velocity: Array) -> Array:
        return np.concatenate((rates / spread.rate, velocity / spread.velocity))

    def whole(some: Array) -> Array:
        theta = start.copy()
        theta[free] = some
        return theta

    def residuals(some: Array) -> Array:
        return scaled(*model.residuals(whole(some))).ravel()

    def jacobian(some: Array) -> Array:
        return scaled(*model.jacobians(whole(some))).reshape(-1, len(free))[:, free]

    lowest, highest, sizes = (each[: len(free)] for each in (_LOWEST, _HIGHEST, _SIZES))

    solution = least_squares(
        residuals,
        start[free],
        jac=jacobian,
        bounds=(lowest[free], highest[free]),
        x_scale=sizes[free],
        loss="soft_l1",
        f_scale=_OUTLIER_SPREADS,
        max_nfev=60,
    )
    return whole(solution.x)


def _half_widths(
    model: ResponseModel, theta: Array, spread: _Spread, fitted: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return half of the 95 % confidence intervals of fitted parameters, joint and individual.

    Neighbouring residuals are correlated (gusts, effects that are not modelled), so their number
    overstates the information. The covariance is the sandwich H^-1 M H^-1 (Huber 1967; White 1980)
    whose M sums the gradients window by window, and neighbouring windows with decreasing weights
    (Newey and West 1987). The covariance is at least H^-1, valid for independent residuals of the
    assumed spread, and excludes errors that last the whole flight. The second result comes from
    the diagonal of H: the information about a parameter if all others were known.
    """
    H, gradients = _curvature_and_gradients(model, theta, spread)
    count = len(gradients)
    # At a bound of the fit the gradients do not cancel, so only their scatter is used.
    gradients -= gradients.mean(axis=0)
    M = gradients.T @ gradients
    for lag in range(1, _CORRELATED_WINDOWS + 1):
        neighbours = gradients[lag:].T @ gradients[:-lag]
        M += (1.0 - lag / (_CORRELATED_WINDOWS + 1.0)) * (neighbours + neighbours.T)
    M *= count / (count - 1.0)
    variance = np.zeros(len(theta))
    lowest, highest, sizes = (each[: len(theta)] for each in (_LOWEST, _HIGHEST, _SIZES))
    inside = (theta > lowest + _AT_BOUND * sizes) & (theta < highest - _AT_BOUND * sizes)
    # The uncertainty of a drag at its lower bound depends on the other drag.
    inside[DRAG] = inside[ROTOR_DRAG] = True
    for free in (fitted, fitted & inside):
        block = np.ix_(free, free)
        variance[free] = _variances(H[block], M[block], sizes[free])
    quantile = student_t.ppf(0.975, max(count - _VELOCITY_PARAMETERS, 1))
    alone = 1.0 / np.sqrt(np.diag(H) + _PRIOR_WEIGHT / sizes**2)
    return quantile * np.sqrt(variance), quantile * alone


def _curvature_and_gradients(
    model: ResponseModel, theta: Array, spread: _Spread
) -> tuple[Array, Array]:
    """Return H (p, p) and the gradient of every window with data (windows, p)."""
    rates, velocity = model.residuals(theta)
    rate_jacobian, velocity_jacobian = model.jacobians(theta, difference=_TIME_STEP)
    H = np.zeros((len(theta), len(theta)))
    gradients = np.zeros((model.blocks[-1] + 1, len(theta)))
    for residual, jacobian, scale, blocks in (
        (rates, rate_jacobian, spread.rate, model.blocks[model.usable]),
        (velocity, velocity_jacobian, spread.velocity, model.blocks),
    ):
        r, J = residual / scale, jacobian / scale
        weight = 1.0 / np.sqrt(1.0 + (r / _OUTLIER_SPREADS) ** 2)
        H += np.einsum("nip,ni,niq->pq", J, weight, J)
        np.add.at(gradients, blocks, np.einsum("nip,ni->np", J, weight * r))
    return H, gradients[np.unique(model.blocks[model.usable])]


def _variances(H: Array, M: Array, sizes: Array) -> Array:
    """Return the diagonal of H^-1 M H^-1, or of H^-1 where the latter is larger."""
    # The prior keeps H regular if no residual depends on a parameter.
    inverse = np.linalg.pinv(H + np.diag(_PRIOR_WEIGHT / sizes**2), hermitian=True)
    return np.asarray(np.maximum(np.diag(inverse @ M @ inverse), np.diag(inverse)))


def _specific_force(model: ResponseModel, data: Measurements, theta: Array) -> FittedCourse:
    """Return the specific force along the thrust axis (n, 1), averaged over a few odometries."""
    stride = max(1, round(_AVERAGING_TIME / data.period))
    columns = model.increments(theta)
    interval = np.diff(data.time)
    fitted = columns @ theta[LINEAR_IN_VELOCITY]
    measured = np.diff(data.v_WB_W, axis=0)
    measured[:, 2] += data.vehicle.gravity * interval
    first = np.arange(0, len(interval) - stride + 1)
    duration = data.time[first + stride] - data.time[first]
    axis = data.R_WB[first + stride // 2][:, :, 2]

    def along(increments: Array) -> Array:
        sums = np.concatenate((np.zeros((1, 3)), np.cumsum(increments, axis=0)))
        moved = sums[first + stride] - sums[first]
        return np.asarray(np.einsum("ni,ni->n", moved, axis) / duration)[:, None]

    # Intervals in usable windows.
    sums = np.concatenate(([0.0], np.cumsum(model.in_window)))
    whole = sums[first + stride + 1] - sums[first] >= stride + 1
    return FittedCourse(
        time=(data.time[first] + 0.5 * duration)[whole],
        measured=along(measured)[whole],
        fitted=along(fitted)[whole],
    )


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
