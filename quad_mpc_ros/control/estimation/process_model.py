"""The process model of the filter: the MPC's model between two odometries, with its derivatives.

Position, velocity and throttle follow from the commands that acted, delayed and lagged, and from
the estimated parameters. The attitude rotates at a constant rate between two measured attitudes.
The modelled rates follow their commands and offsets through the loop of each axis.
"""

from __future__ import annotations

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.filter_state import (
    MOTION,
    RATES,
    ROLL_PITCH,
    YAW,
    Filter,
    TranslationEstimate,
    loop_lags,
)
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag
from quad_mpc_ros.control.model.parameter_jacobians import (
    BY,
    MotionDerivatives,
    at_start,
    followed_loop,
    no_motion,
    propagated_with_derivatives,
    thrust_lag_slopes,
)
from quad_mpc_ros.control.model.parameters import ModelParameters, modelled_thrust
from quad_mpc_ros.control.model.rollout import Body, StateRecord
from quad_mpc_ros.control.model.state import U_RATE, U_THROTTLE


@compiled
def predict_translation(
    model: ModelParameters,
    drag_shape: Array,
    estimate: TranslationEstimate,
    acting: Acting,
    before: StateRecord,
    after: StateRecord,
    F: Array,
) -> None:
    """Predict the translation with the estimated ``model``, and write the Jacobian F.

    ``before`` and ``after`` are the measured states. Disturbance and bias have 1 on F's diagonal.
    """
    x, duration = estimate.x, acting.durations.sum()
    R = kernels.matrix(before.R_WB)
    turn = kernels.log(kernels.multiply(kernels.transposed(R), kernels.matrix(after.R_WB)))
    w = kernels.scaled(1.0 / duration, turn)
    body = Body(
        kernels.vector(x[MOTION.position : MOTION.velocity]),
        kernels.vector(x[MOTION.velocity : MOTION.disturbance]),
        R,
        (x[MOTION.throttle], w[0], w[1], w[2]),
        (0.0, 0.0, 0.0),
    )
    derivatives, shape, throttle = no_motion(), kernels.vector(drag_shape), x[MOTION.throttle]
    for k in range(len(acting.durations)):
        command = acting.commands[k, U_THROTTLE], w[0], w[1], w[2]
        body = propagated_with_derivatives(
            model, shape, command, acting.durations[k], body, derivatives
        )
    kernels.store_vector(body.p, x[MOTION.position : MOTION.velocity])
    kernels.store_vector(body.v, x[MOTION.velocity : MOTION.disturbance])
    x[MOTION.throttle] = body.actuators[U_THROTTLE]
    _write_jacobian(derivatives, F)
    _add_lateness(model, estimate, (throttle, body.actuators[U_THROTTLE]), body, duration, F)


@compiled
def _add_lateness(
    model: ModelParameters,
    estimate: TranslationEstimate,
    throttles: tuple[float, float],
    after: Body,
    duration: float,
    F: Array,
) -> None:
    """Add the effect of a thrust delay D beyond the longest time constant.

    To first order, the velocity lags by D times the change of the thrust over the duration.
    """
    x, late = estimate.x, estimate.x[MOTION.lag] - model.thrust_time_constant
    if late <= 0.0:
        return
    F[MOTION.throttle, MOTION.lag] = 0.0
    change = modelled_thrust(model, throttles[1]) - modelled_thrust(model, throttles[0])
    lacking = kernels.scaled(-model.thrust_scale * change, kernels.column(after.R, 2))
    for k in range(3):
        p, v = MOTION.position + k, MOTION.velocity + k
        F[v, MOTION.lag], F[p, MOTION.lag] = lacking[k], 0.5 * duration * lacking[k]
        x[p] += late * F[p, MOTION.lag]
        x[v] += late * F[v, MOTION.lag]


@compiled
def _write_jacobian(derivatives: MotionDerivatives, F: Array) -> None:
    """Write the rows of position, velocity and throttle into a unit matrix."""
    identity(F)
    p, v, s = derivatives
    for k in range(3):
        for n in range(3):
            F[MOTION.position + k, MOTION.velocity + n] = p[BY.velocity + n, k]
            F[MOTION.velocity + k, MOTION.velocity + n] = v[BY.velocity + n, k]
            F[MOTION.position + k, MOTION.disturbance + n] = p[BY.disturbance + n, k]
            F[MOTION.velocity + k, MOTION.disturbance + n] = v[BY.disturbance + n, k]
        for column, n in (
            (MOTION.scale, BY.scale),
            (MOTION.lag, BY.lag),
            (MOTION.drag, BY.drag),
            (MOTION.throttle, BY.throttle),
        ):
            F[MOTION.position + k, column] = p[n, k]
            F[MOTION.velocity + k, column] = v[n, k]
    F[MOTION.throttle, MOTION.throttle] = s[BY.throttle]
    F[MOTION.throttle, MOTION.lag] = s[BY.lag]


@compiled
def predict_unmodelled(
    model: ModelParameters, estimate: TranslationEstimate, acting: Acting, F: Array
) -> None:
    """Predict with constant velocity, without forces, and the throttle with the model."""
    x, duration = estimate.x, acting.durations.sum()
    identity(F)
    for k in range(3):
        F[MOTION.position + k, MOTION.velocity + k] = duration
        x[MOTION.position + k] += duration * x[MOTION.velocity + k]
    throttle, by_throttle, by_lag = x[MOTION.throttle], 1.0, 0.0
    for k in range(len(acting.durations)):
        command, seconds = acting.commands[k, U_THROTTLE], acting.durations[k]
        lag = model.thrust_time_constant
        if command < throttle:
            lag = model.thrust_time_constant_down
        decay, _share = first_order_lag(lag, seconds)
        slope, _share_slope = thrust_lag_slopes(model, throttle, command, seconds)
        by_throttle, by_lag = decay * by_throttle, decay * by_lag + slope * (throttle - command)
        throttle = command + decay * (throttle - command)
    x[MOTION.throttle] = throttle
    F[MOTION.throttle, MOTION.throttle], F[MOTION.throttle, MOTION.lag] = by_throttle, by_lag


@compiled
def predict_rates(state: Filter, acting: Acting, F: Array) -> None:
    """Predict rates and accelerations of the model, and write the Jacobian F."""
    x, nominal = state.rates.x, state.nominal
    identity(F)
    for axis in range(3):
        k = YAW if axis == 2 else ROLL_PITCH
        columns = (
            RATES.rate + axis,
            RATES.acceleration + axis,
            RATES.lag + k,
            RATES.torque_lag + k,
            RATES.offset + axis,
            RATES.offset_by_thrust + axis,
        )
        rows, lags, D = columns[:2], loop_lags(state, axis), at_start()
        w, acceleration = x[rows[0]], x[rows[1]]
        for n in range(len(acting.durations)):
            thrust = modelled_thrust(nominal, acting.commands[n, U_THROTTLE])
            command = acting.commands[n, U_RATE + axis]
            if axis < 2:
                command += x[RATES.offset + axis] + x[RATES.offset_by_thrust + axis] * thrust
            w, acceleration = followed_loop(
                lags, (command, thrust), acting.durations[n], (w, acceleration), D
            )
        x[rows[0]], x[rows[1]] = w, acceleration
        for i in range(2):
            for n in range(6 if axis < 2 else 4):  # yaw has no offsets
                F[rows[i], columns[n]] = D[i, n]


@compiled
def identity(F: Array) -> None:
    """Write a unit matrix."""
    F[:] = 0.0
    for k in range(len(F)):
        F[k, k] = 1.0
