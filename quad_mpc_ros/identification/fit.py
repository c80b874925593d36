"""Fitting the response model: a coarse search, a robust least-squares fit, and its confidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student_t

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.identification.measurements import Measurements, measurements_of
from quad_mpc_ros.identification.model import (
    ACCELERATION,
    DELAY,
    DRAG,
    LINEAR_IN_VELOCITY,
    PARAMETERS,
    RATE_BIAS,
    RATE_TAU,
    SCALE,
    THRUST_TAU,
    ResponseModel,
)
from quad_mpc_ros.identification.result import Estimate, FittedCourse, Identification
from quad_mpc_ros.lie import Array
from quad_mpc_ros.messages.topics import COMMAND, ENGAGED
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.recordings.recording import Recording

# Searched before the fit, which finds the nearest minimum only [s].
_TIME_CONSTANTS = (0.003, 0.01, 0.02, 0.04, 0.08, 0.16, 0.3)
_DELAYS = np.arange(0.0, 0.301, 0.02)

_LOWEST = np.array([0.0, 0.0, 0.0, 0.1, 0.0, -20.0, -20.0, -5.0, -5.0, -5.0])
_HIGHEST = np.array([1.0, 1.0, 0.5, 10.0, 10.0, 20.0, 20.0, 5.0, 5.0, 5.0])
_SIZES = np.array([0.03, 0.03, 0.03, 1.0, 0.3, 1.0, 1.0, 0.1, 0.1, 0.1])

# Residuals smaller than these are no knowledge: rounding, and what the model leaves out.
_LEAST_SPREAD_RATE, _LEAST_SPREAD_VELOCITY = 0.02, 0.005  # rad/s, m/s
_MAD_TO_SIGMA = 1.4826
_OUTLIER = 2.0  # spreads from where a residual counts less
_ROUNDS = 2
_AT_BOUND = 1e-3  # of the size of a parameter
_UNKNOWN = 1e-6  # what is known of a parameter beforehand, in its size
_ALIKE_WINDOWS = 4  # in a row whose residuals may be alike
_TIME_DIFFERENCE = 0.005  # s; a shorter one sees nothing of lags faster than the odometry
_FEWEST_WINDOWS = PARAMETERS + 2

# No interval is narrower than this share of the value: the model is not truer than that.
_LEAST_SHARE = 0.01
# Half of a 95 % interval above both is no answer: share of the value, and its natural size.
_VAGUE_SHARE = 0.5
_VAGUE = {RATE_TAU: 0.01, THRUST_TAU: 0.01, DELAY: 0.01, SCALE: 0.1, DRAG: 0.1}

_MOST_ODOMETRIES = 30_000  # ten minutes at 50 Hz: more costs memory and tells no more
_AVERAGED_OVER = 0.08  # s, of the specific force shown


@dataclass(frozen=True, kw_only=True)
class _Spread:
    rate: float
    velocity: float


def identify(recording: Recording) -> Identification:
    """Identify the vehicle of a recording, compared with the one in its recorded parameters.

    Args:
        recording: One vehicle's odometry and the commands that it flew by.

    Returns:
        Time constants and delay [s], thrust per mass over that of the given vehicle, drag [1/s],
        each with its 95 % interval.

    Raises:
        BagError: The recording has too little flight under commands.
    """
    given = MpcConfig.build(recording.parameters_of(MpcConfig))
    run = recording.run(topics=(COMMAND, ENGAGED))
    frame = given.odometry.twist_frame
    return fit(measurements_of(run, vehicle=given.vehicle(), twist_frame=frame))


def fit(measured: Measurements) -> Identification:
    """Fit lags, delay, thrust scale and drag to a flight; of a long one, to parts of it.

    Raises :class:`BagError` for a flight that is too short for a confidence.
    """
    data = measured.thinned(_MOST_ODOMETRIES)
    model = ResponseModel(data)
    windows = len(np.unique(model.blocks[model.in_window > 0.0]))
    if windows < _FEWEST_WINDOWS:
        raise BagError(
            f"{windows} stretches of flight of half a second, expected {_FEWEST_WINDOWS} or more "
            "under commands: record a longer flight"
        )
    theta = _searched(model, data)
    for _ in range(_ROUNDS):
        spread = _spread(model, theta)
        theta = _fitted(model, theta, spread)
    half_width, alone = _half_widths(model, theta, spread)
    rates, velocity = model.residuals(theta)

    def estimate(parameter: int) -> Estimate:
        value = float(theta[parameter])
        width = max(float(half_width[parameter]), _LEAST_SHARE * value)
        enough = max(_VAGUE_SHARE * value, _VAGUE[parameter])
        return Estimate(
            value=value,
            half_width=width,
            seen=bool(alone[parameter] <= enough),
            observable=width <= enough,
        )

    return Identification(
        rate_time_constant=estimate(RATE_TAU),
        thrust_time_constant=estimate(THRUST_TAU),
        input_delay=estimate(DELAY),
        thrust_scale=estimate(SCALE),
        drag=estimate(DRAG),
        wind_acceleration_W=theta[ACCELERATION],
        rate_residual=_root_mean_square(rates),
        velocity_residual=_root_mean_square(velocity[model.in_window > 0.0]),
        rates=_rate_course(model, data, theta),
        specific_force=_specific_force(model, data, theta),
        flown=measured.flown,
        fitted=data.flown,
    )


def _searched(model: ResponseModel, data: Measurements) -> Array:
    """Return the best parameters of a grid of time constants and delays."""
    measured = data.w_WB_B[model.usable]
    shape = (len(_TIME_CONSTANTS), len(_DELAYS))
    rate_cost, thrust_cost = np.empty(shape), np.empty(shape)
    linear = np.empty((*shape, len(LINEAR_IN_VELOCITY)))
    for j, delay in enumerate(_DELAYS):
        for i, tau in enumerate(_TIME_CONSTANTS):
            off = measured - model.rates(rate_tau=tau, delay=delay)
            rate_cost[i, j] = np.sum((off - off.mean(axis=0)) ** 2)
        best = _TIME_CONSTANTS[int(np.argmin(rate_cost[:, j]))]
        for i, tau in enumerate(_TIME_CONSTANTS):
            left, columns = model.velocity_columns(rate_tau=best, thrust_tau=tau, delay=delay)
            A, b = columns.reshape(-1, columns.shape[-1]), left.ravel()
            linear[i, j] = np.linalg.lstsq(A, b, rcond=1e-6)[0]
            thrust_cost[i, j] = np.sum((b - A @ linear[i, j]) ** 2)
    # The delay is one, and the channels are weighed by what each leaves at its best.
    total = np.min(rate_cost, axis=0) / _scale(rate_cost, _LEAST_SPREAD_RATE, measured.size)
    total += np.min(thrust_cost, axis=0) / _scale(
        thrust_cost, _LEAST_SPREAD_VELOCITY, 3.0 * float(np.sum(model.in_window))
    )
    j = int(np.argmin(total))
    i_rate, i_thrust = int(np.argmin(rate_cost[:, j])), int(np.argmin(thrust_cost[:, j]))
    theta = np.zeros(PARAMETERS)
    theta[RATE_TAU], theta[THRUST_TAU] = _TIME_CONSTANTS[i_rate], _TIME_CONSTANTS[i_thrust]
    theta[DELAY] = _DELAYS[j]
    theta[list(LINEAR_IN_VELOCITY)] = linear[i_thrust, j]
    theta[RATE_BIAS] = (measured - model.rates(rate_tau=theta[RATE_TAU], delay=theta[DELAY])).mean(
        axis=0
    )
    margin = 1e-3 * _SIZES
    return np.clip(theta, _LOWEST + margin, _HIGHEST - margin)


def _scale(cost: Array, least_spread: float, count: float) -> float:
    return max(float(cost.min()) / count, least_spread**2)


def _spread(model: ResponseModel, theta: Array) -> _Spread:
    """Return the spread of the residuals, by their median, which outliers do not move."""
    rates, velocity = model.residuals(theta)
    inside = velocity[model.in_window > 0.0]
    return _Spread(
        rate=max(_MAD_TO_SIGMA * float(np.median(np.abs(rates))), _LEAST_SPREAD_RATE),
        velocity=max(_MAD_TO_SIGMA * float(np.median(np.abs(inside))), _LEAST_SPREAD_VELOCITY),
    )


def _fitted(model: ResponseModel, start: Array, spread: _Spread) -> Array:
    def scaled(rates: Array, velocity: Array) -> Array:
        return np.concatenate((rates / spread.rate, velocity / spread.velocity))

    def residuals(theta: Array) -> Array:
        return scaled(*model.residuals(theta)).ravel()

    def jacobian(theta: Array) -> Array:
        return scaled(*model.jacobians(theta)).reshape(-1, PARAMETERS)

    solution = least_squares(
        residuals,
        start,
        jac=jacobian,
        bounds=(_LOWEST, _HIGHEST),
        x_scale=_SIZES,
        loss="soft_l1",
        f_scale=_OUTLIER,
        max_nfev=60,
    )
    return np.asarray(solution.x)


def _half_widths(model: ResponseModel, theta: Array, spread: _Spread) -> tuple[Array, Array]:
    """Return half of the 95 % interval of every parameter, and of each were it the only one.

    Residuals next to each other are alike (gusts, what the model leaves out), so their number
    says too much. The covariance is the sandwich H^-1 M H^-1 (Huber 1967; White 1980) whose M
    sums the gradients window by window, and neighbouring windows with falling weights (Newey and
    West 1987). It is taken no smaller than H^-1, that of independent residuals of the assumed
    spread, and knows of no error that lasts the whole flight. The second is from the diagonal of
    H: how much the flight says of a parameter if all others were known.
    """
    H, gradients = _curvature_and_gradients(model, theta, spread)
    count = len(gradients)
    # Where a bound holds the fit back the gradients do not cancel: only their scatter counts.
    gradients -= gradients.mean(axis=0)
    M = gradients.T @ gradients
    for lag in range(1, _ALIKE_WINDOWS + 1):
        neighbours = gradients[lag:].T @ gradients[:-lag]
        M += (1.0 - lag / (_ALIKE_WINDOWS + 1.0)) * (neighbours + neighbours.T)
    M *= count / (count - 1.0)
    variance = _variances(H, M, _SIZES)
    free = (theta > _LOWEST + _AT_BOUND * _SIZES) & (theta < _HIGHEST - _AT_BOUND * _SIZES)
    variance[free] = _variances(H[np.ix_(free, free)], M[np.ix_(free, free)], _SIZES[free])
    quantile = student_t.ppf(0.975, max(count - PARAMETERS, 1))
    alone = 1.0 / np.sqrt(np.diag(H) + _UNKNOWN / _SIZES**2)
    return quantile * np.sqrt(variance), quantile * alone


def _curvature_and_gradients(
    model: ResponseModel, theta: Array, spread: _Spread
) -> tuple[Array, Array]:
    """Return H (10, 10) and the gradient of every window with data (windows, 10)."""
    rates, velocity = model.residuals(theta)
    rate_jacobian, velocity_jacobian = model.jacobians(theta, difference=_TIME_DIFFERENCE)
    H = np.zeros((PARAMETERS, PARAMETERS))
    gradients = np.zeros((model.blocks[-1] + 1, PARAMETERS))
    for residual, jacobian, scale, blocks in (
        (rates, rate_jacobian, spread.rate, model.blocks[model.usable]),
        (velocity, velocity_jacobian, spread.velocity, model.blocks),
    ):
        r, J = residual / scale, jacobian / scale
        weight = 1.0 / np.sqrt(1.0 + (r / _OUTLIER) ** 2)
        H += np.einsum("nip,ni,niq->pq", J, weight, J)
        np.add.at(gradients, blocks, np.einsum("nip,ni->np", J, weight * r))
    return H, gradients[np.unique(model.blocks[model.usable])]


def _variances(H: Array, M: Array, sizes: Array) -> Array:
    """Return the diagonal of H^-1 M H^-1, or of H^-1 where that is larger."""
    # A parameter that nothing depends on would make H singular; this makes it just unknown.
    inverse = np.linalg.pinv(H + np.diag(_UNKNOWN / sizes**2), hermitian=True)
    return np.asarray(np.maximum(np.diag(inverse @ M @ inverse), np.diag(inverse)))


def _rate_course(model: ResponseModel, data: Measurements, theta: Array) -> FittedCourse:
    fitted = model.rates(rate_tau=theta[RATE_TAU], delay=theta[DELAY]) + theta[RATE_BIAS]
    return FittedCourse(
        time=data.time[model.usable], measured=data.w_WB_B[model.usable], fitted=fitted
    )


def _specific_force(model: ResponseModel, data: Measurements, theta: Array) -> FittedCourse:
    """Return the specific force along the thrust axis (n, 1), averaged over a few odometries."""
    stride = max(1, round(_AVERAGED_OVER / data.period))
    impulse = model.thrust_impulse(
        rate_tau=theta[RATE_TAU], thrust_tau=theta[THRUST_TAU], delay=theta[DELAY]
    )
    interval = np.diff(data.time)
    other = -theta[DRAG] * 0.5 * interval[:, None] * (data.v_WB_W[:-1] + data.v_WB_W[1:])
    other[:, :2] += np.outer(interval, theta[ACCELERATION])
    fitted = theta[SCALE] * impulse + other
    measured = np.diff(data.v_WB_W, axis=0)
    measured[:, 2] += data.vehicle.gravity * interval
    first = np.arange(0, len(interval) - stride + 1)
    duration = data.time[first + stride] - data.time[first]
    axis = data.R_WB[first + stride // 2][:, :, 2]

    def along(increments: Array) -> Array:
        sums = np.concatenate((np.zeros((1, 3)), np.cumsum(increments, axis=0)))
        moved = sums[first + stride] - sums[first]
        return np.asarray(np.einsum("ni,ni->n", moved, axis) / duration)[:, None]

    whole = _whole(model, first, stride)
    return FittedCourse(
        time=(data.time[first] + 0.5 * duration)[whole],
        measured=along(measured)[whole],
        fitted=along(fitted)[whole],
    )


def _whole(model: ResponseModel, first: NDArray[np.intp], stride: int) -> NDArray[np.bool_]:
    """Return which stretches from ``first`` on lie in usable windows."""
    sums = np.concatenate(([0.0], np.cumsum(model.in_window)))
    return np.asarray(sums[first + stride + 1] - sums[first] >= stride + 1)


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
