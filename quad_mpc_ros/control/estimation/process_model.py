"""The process model of the filter: the MPC's model between two odometries, with its derivatives.

Position, velocity and throttle follow from the commands that acted, delayed and lagged, and from
the estimated parameters. The attitude turns at a constant rate between two measured attitudes.
The modelled rates follow their commands and offsets.
"""

from __future__ import annotations

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.error_state import (
    MOTION,
    RATES,
    ROLL_PITCH,
    YAW,
    RateEstimate,
    TranslationEstimate,
)
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.parameter_jacobians import (
    BY,
    OF_NO_TIME,
    MotionDerivatives,
    followed_rate,
    no_motion,
    propagated_with_derivatives,
)
from quad_mpc_ros.control.model.parameters import ModelParameters, modelled_thrust
from quad_mpc_ros.control.model.rollout import LONGEST_SUBSTEP, Body, StateRecord
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

    ``before`` and ``after`` are the measured states. Disturbance and bias have ones in F.
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
    )
    derivatives, shape, throttle = no_motion(), kernels.vector(drag_shape), x[MOTION.throttle]
    for k in range(len(acting.durations)):
        command = acting.commands[k, U_THROTTLE], w[0], w[1], w[2]
        body = propagated_with_derivatives(
            model, shape, command, acting.durations[k], LONGEST_SUBSTEP, body, derivatives
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

    To first order, the velocity lacks D times the change of the thrust over the duration.
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
    """Predict at constant velocity, without forces, and the throttle by the model."""
    x, duration = estimate.x, acting.durations.sum()
    identity(F)
    for k in range(3):
        F[MOTION.position + k, MOTION.velocity + k] = duration
        x[MOTION.position + k] += duration * x[MOTION.velocity + k]
    throttle, derivatives = x[MOTION.throttle], OF_NO_TIME
    for k in range(len(acting.durations)):
        throttle, derivatives = followed_rate(
            model.thrust_time_constant,
            acting.commands[k, U_THROTTLE],
            0.0,
            acting.durations[k],
            throttle,
            derivatives,
        )
    x[MOTION.throttle] = throttle
    F[MOTION.throttle, MOTION.throttle] = derivatives.by_rate
    F[MOTION.throttle, MOTION.lag] = derivatives.by_lag


@compiled
def predict_rates(
    nominal: ModelParameters,
    shares: Array,
    estimate: RateEstimate,
    acting: Acting,
    F: Array,
    H: Array,
) -> None:
    """Predict the rates of the model, and write the Jacobian F and the measurement H (3, n).

    ``shares`` (3,) are the axes' shares of the common time constants. H x = w - D dw/dt, as the
    measurement is late.
    """
    x, duration = estimate.x, acting.durations.sum()
    identity(F)
    H[:] = 0.0
    for axis in range(3):
        rate, lag = RATES.rate + axis, YAW if axis == 2 else ROLL_PITCH
        w, by = x[rate], OF_NO_TIME
        for k in range(len(acting.durations)):
            thrust = modelled_thrust(nominal, acting.commands[k, U_THROTTLE])
            command = acting.commands[k, U_RATE + axis]
            if axis < 2:
                by_thrust = x[RATES.offset_by_thrust + axis]
                command += x[RATES.offset + axis] + by_thrust * thrust
            time_constant = shares[axis] * x[lag]
            w, by = followed_rate(time_constant, command, thrust, acting.durations[k], w, by)
        F[rate, rate], F[rate, lag] = by.by_rate, shares[axis] * by.by_lag
        H[axis, rate] = 1.0
        if axis < 2:
            F[rate, RATES.offset + axis] = by.by_offset
            F[rate, RATES.offset_by_thrust + axis] = by.by_offset_by_thrust
            H[axis, RATES.lateness] = -(w - x[rate]) / duration
        x[rate] = w


@compiled
def identity(F: Array) -> None:
    """Write a unit matrix."""
    F[:] = 0.0
    for k in range(len(F)):
        F[k, k] = 1.0
