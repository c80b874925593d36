"""The extended Kalman filter of the vehicle: its motion, and what the model does not know of it.

Between two odometries position, velocity, throttle and body rates are predicted by the MPC's own
model with the commands that were really acting, delayed and lagged (:mod:`.process_model`); then
they are corrected by what was measured, and with them what is learned of the vehicle
(:mod:`.error_state` has the states, :mod:`.kalman` the equations of the filter). What tells one
state from another is derived in docs/estimation.md.

    dd/dt = noise, of d_z -d_z / T + noise         the disturbance; what lasts of d_z is thrust
    db/dt = -b / T_b + noise                       what the measured velocity errs for long
    da/dt = noise                                  the bias of an accelerometer, if there is one
    all else that is learned: a random walk, no more uncertain than at the start

    z_p = p + n,   z_v = v + b + n,   z_w = w - D dw/dt + n,   z_f = R' (dv/dt - g) + a + n

**k and d_z look alike at hover**: only their sum k T/m + d_z = g is observable. What is likely
tells them apart: winds change, a lack of thrust lasts. **Drag** is distinguished from wind by
motion, and is considered below a speed. **A velocity that errs for seconds**, as that of
autopilots, is distinguished by how the position moves. What an odometry may change says
:mod:`.update_mode`; a time constant of zero is no lag and stays. The delay of the input is not
estimated: ``docs/tuning.md`` says why.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3, Vector4
from quad_mpc_ros.control.estimation import error_state, kalman, measurement_noise
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.error_state import (
    LEARNED_OF_MOTION,
    MOTION,
    ROLL_PITCH,
    SCALE_BOUNDS,
    TURNING,
    VERTICAL_BOUND,
    YAW,
    MotionEstimate,
    TurningEstimate,
    variances_at,
)
from quad_mpc_ros.control.estimation.measurement_noise import VelocityDrift, WhiteNoise
from quad_mpc_ros.control.estimation.process_model import (
    predict_motion,
    predict_turning,
    predict_unmodelled,
)
from quad_mpc_ros.control.estimation.specific_force import SpecificForce, force_innovation
from quad_mpc_ros.control.estimation.update_mode import Conditions, UpdateMode, update_mode
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import ModelParameters, modelled_thrust
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import U_RATE, U_THROTTLE

_ACCELERATION_NOISE = 0.1  # m/s^2 / sqrt(Hz), of the model within a step
_UNMODELLED = 100.0  # m/s^2, of a vehicle that something else moves
_BIAS_TIME = 1.0  # s, for which an error of the velocity lasts
_RATE_WALK = 0.2  # rad/s / sqrt(s), of the model's rates
_SMOOTHING = 0.1  # s, the low-pass of commands and rates
_RATE_NOISE = 0.02  # rad/s / sqrt(Hz), of a measured rate against the model
_TURN_JUMP = 0.2  # rad, an attitude that the rates do not lead to
# Drag is told from wind above this speed across the thrust [m/s], a lag where thrust changes by so
# much [m/s^2], at rest and per m/s.
_OBSERVABLE_SPEED = 1.0
_HIDDEN, _HIDDEN_BY_SPEED = 0.05, 0.05
# From a command to what it does by default [s], and by how much closer at most vehicles are
# followed that answer sooner.
_USUAL_LATENCY, _CLOSEST = 0.13, 4.0


class Bounds(Record):
    """Within what commands and estimate are."""

    throttle_min: float
    throttle_max: float
    disturbance_max: float  # m/s^2, along the ground


class Walks(Record):
    """Variance at the start and its growth per second, of each state."""

    motion: MotionEstimate  # x the growth, the diagonal of P that at the start
    turning: TurningEstimate


class RateLags(Record):
    """Of each axis: its share of the time constant it has with others, and bounds of that [s]."""

    share: Vector3
    shortest: Vector3
    longest: Vector3


class SlowRates(Record):
    """Commands and measured rates behind one low-pass: what a rate loop is of first order in."""

    command: Vector4
    measured: Vector3  # rad/s
    last: Vector3  # rad/s, measured before, as it was


class Filter(Record):
    """All that the filter knows, and what is configured of it."""

    motion: MotionEstimate
    turning: TurningEstimate
    walks: Walks
    position_noise: WhiteNoise
    velocity_noise: WhiteNoise
    drift: VelocityDrift
    nominal: ModelParameters  # as configured
    estimated: ModelParameters
    drag_shape: Vector3  # what of the mean drag each axis has more or less, as a share of it
    rate_lags: RateLags
    slow: SlowRates
    bounds: Bounds
    enabled: int  # whether anything is learned
    paused_for: float  # s, for how long the velocity alone has been estimated
    # Normalised innovations squared of the last odometry, of 3 degrees of freedom each.
    position_nis: float
    velocity_nis: float
    velocity_innovation: Vector3  # m/s
    felt: SpecificForce  # between the last two odometries


class EkfMemory(NamedTuple):
    """What is estimated at a moment."""

    motion: Any
    turning: Any


class VehicleEkf:
    """Follows a vehicle from odometry to odometry."""

    def __init__(
        self,
        nominal: ModelParameters,
        *,
        throttle: float,
        delay: float = 0.0,
        enabled: bool = True,
        feels: bool = False,
        state: Filter,
    ) -> None:
        """``nominal`` are the configured parameters, ``throttle`` is where it begins.

        ``delay`` [s] is that of the input; ``feels`` says that there is an accelerometer. The
        estimate is kept in ``state``, zeros to begin with; :func:`update` goes on with it.
        """
        self._filter, self._initial_throttle = state, throttle
        state.nominal = state.estimated = nominal
        state.enabled = int(enabled)
        state.drag_shape[:] = nominal.uneven_drag / (nominal.drag or 1.0)
        bounds = state.bounds
        bounds.throttle_min, bounds.throttle_max = -math.inf, math.inf
        bounds.disturbance_max = math.inf
        closer = _closer(nominal, delay)
        measurement_noise.start(state.velocity_noise, measurement_noise.USUAL / closer)
        measurement_noise.start(state.position_noise, measurement_noise.LEAST_OF_POSITION)
        measurement_noise.start_drift(state.drift)
        state.motion.x[MOTION.scale] = 1.0
        _assume(state, closer)
        if feels:
            _assume_accelerometer(state)
        self.reset()
        self.start(p_WB=np.zeros(3), v_WB_W=np.zeros(3), w_WB_B=np.zeros(3))

    def reset(self) -> None:
        """Return to the configured parameters, with the covariance of the start.

        But for the thrust: its scale becomes that which alone carries the vehicle as scale and
        disturbance did together, for it may have been flying by them.
        """
        state = self._filter
        nominal, x = state.nominal, state.motion.x
        lifted = nominal.gravity - x[MOTION.disturbance + 2]
        scale = x[MOTION.scale] * nominal.gravity / lifted
        x[MOTION.disturbance : MOTION.scale] = 0.0
        x[MOTION.scale] = min(max(scale, SCALE_BOUNDS[0]), SCALE_BOUNDS[1])
        x[MOTION.accelerometer :] = 0.0
        x[MOTION.lag], x[MOTION.drag] = nominal.thrust_time_constant, nominal.drag
        state.motion.P[:] = state.walks.motion.P
        state.turning.x[:] = 0.0
        state.turning.x[ROLL_PITCH] = 0.5 * sum(nominal.rate_time_constants.tolist()[:2])
        state.turning.x[YAW] = nominal.rate_time_constants[2]
        state.turning.P[:] = state.walks.turning.P
        restart(state, x[: MOTION.velocity].copy(), x[MOTION.velocity : MOTION.disturbance].copy())

    def reconfigure(
        self, *, throttle_min: float, throttle_max: float, disturbance_max: float
    ) -> None:
        """Take over changed bounds of the throttle, and of the disturbance along the ground."""
        bounds = self._filter.bounds
        bounds.throttle_min, bounds.throttle_max = throttle_min, throttle_max
        bounds.disturbance_max = disturbance_max

    def parameters(self) -> ModelParameters:
        """Return the parameters as estimated by now."""
        estimated = ModelParameters.zeros()
        write_estimated(self._filter, estimated[()])
        return estimated[()]

    def memory(self) -> EkfMemory:
        """Return the estimate and its covariance."""
        return EkfMemory(self._filter.motion.copy(), self._filter.turning.copy())

    def recall(self, memory: EkfMemory) -> None:
        """Return to an earlier estimate of all but the present motion."""
        state, learned = self._filter, slice(*LEARNED_OF_MOTION)
        now = state.motion.x.copy()
        now[learned] = memory.motion.x[learned]
        state.motion, state.turning = memory.motion, memory.turning
        state.motion.x[:] = now
        position, velocity = now[: MOTION.velocity], now[MOTION.velocity : MOTION.disturbance]
        restart(state, position.copy(), velocity + now[MOTION.bias : MOTION.accelerometer])
        _take_rates(state)

    def turn(self, reset: EstimateReset) -> None:
        """Take an announced step of the world's coordinates."""
        x, P, turns = self._filter.motion.x, self._filter.motion.P, np.eye(MOTION.size)
        turn, drift = reset.vectors(np.eye(3)).T, self._filter.drift
        for begin in (MOTION.position, MOTION.velocity, MOTION.disturbance, MOTION.bias):
            block = slice(begin, begin + 3)
            turns[block, block] = turn
        x[:] = turns @ x
        x[: MOTION.velocity] += reset.step_W
        P[:] = turns @ P @ turns.T
        drift.p_WB[:], drift.v_WB_W[:] = reset.points(drift.p_WB), reset.vectors(drift.v_WB_W)
        drift.off[:] = reset.vectors(drift.off)

    def start(self, *, p_WB: Array, v_WB_W: Array, w_WB_B: Array) -> None:
        """Begin with position, velocity and rates (3,) as measured; what was learned is kept."""
        state = self._filter
        state.motion.x[MOTION.throttle] = self._initial_throttle
        state.motion.P[MOTION.throttle, :] = state.motion.P[:, MOTION.throttle] = 0.0
        state.position_noise.known = state.velocity_noise.known = 0
        measurement_noise.begin_drift(state.drift, p_WB, v_WB_W)
        restart(state, p_WB, v_WB_W)
        _begin_turning(state, w_WB_B)


@compiled
def update(
    state: Filter,
    before: StateRecord,
    after: StateRecord,
    acting: Acting,
    conditions: Conditions,
    given_variance: float,
) -> UpdateMode:
    """Go on from one odometry to the next, under the commands that acted between them.

    ``before`` and ``after`` are their states as measured; the throttle is always followed.
    ``given_variance`` [m^2/s^2] is that of the second velocity, 0 where it is not known. Returns
    the mode in which it was done.
    """
    if len(acting.durations) == 0:
        return UpdateMode.HOLD
    duration, saturated = acting.durations.sum(), False
    for k in range(len(acting.durations)):
        throttle = acting.commands[k, U_THROTTLE]
        saturated |= not state.bounds.throttle_min < throttle < state.bounds.throttle_max
    mode = update_mode(conditions, saturated, state.paused_for, True)
    if mode == UpdateMode.VELOCITY_ONLY:
        state.paused_for += duration
        mode = update_mode(conditions, saturated, state.paused_for, True)
    elif mode == UpdateMode.LEARN:
        state.paused_for = 0.0
    write_estimated(state, state.estimated)
    mode = update_motion(state, before, after, acting, mode, given_variance)
    update_turning(state, after, acting, mode)
    return mode


@compiled
def update_motion(
    state: Filter,
    before: StateRecord,
    after: StateRecord,
    acting: Acting,
    mode: UpdateMode,
    given_variance: float,
) -> UpdateMode:
    """Predict, gate and update the motion; return the mode, which may now be that of a jump."""
    x, P, duration = state.motion.x, state.motion.P, acting.durations.sum()
    F, lag_shows = np.empty((MOTION.size, MOTION.size)), False
    state.felt.used = 0
    if mode == UpdateMode.LEARN and state.felt.variance > 0.0:
        _update_by_force(state, before, after, acting, F)
    was = x.copy()
    if mode == UpdateMode.HOLD:
        predict_unmodelled(state.estimated, state.motion, acting, F)
    else:
        predict_motion(state.estimated, state.drag_shape, state.motion, acting, before, after, F)
        lag_shows = _lag_shows(state, F, duration)
    _follow_noise(state, was, (before, after), mode, duration)
    white = measurement_noise.variance_in(state.velocity_noise)
    drifting = measurement_noise.drift_variance_in(state.drift, given_variance)
    _add_memory(x, F, mode, duration)
    kalman.predict(P, F, _motion_noise(state, white, drifting, duration))
    if mode == UpdateMode.HOLD:
        _add_unmodelled(P, duration)

    H = np.zeros((3, MOTION.size))
    nu = np.empty(3)
    for k in range(3):
        H[k, MOTION.velocity + k] = H[k, MOTION.bias + k] = 1.0
        nu[k] = after.v_WB_W[k] - x[MOTION.velocity + k] - x[MOTION.bias + k]
    seen = kalman.innovation(P, H, white, nu)
    # Of a quiet odometry a sudden push is no jump either.
    doubt = max(measurement_noise.USUAL**2 - white, 0.0)
    passed = kalman.squared_distance(seen, doubt) <= kalman.GATE
    state.velocity_nis = kalman.squared_distance(seen, 0.0)
    state.velocity_innovation[:] = nu
    if mode != UpdateMode.HOLD and not (passed and _turns_evenly(before, after, duration)):
        x[:] = was
        restart(state, after.p_WB, after.v_WB_W)
        return UpdateMode.REJECT
    considered = _considered(state, mode, after.R_WB, lag_shows)
    kalman.update(x, P, seen, considered)
    _update_position(state, after.p_WB, considered)
    if mode == UpdateMode.LEARN:
        _constrain_motion(state, considered)
    most = measurement_noise.MOST
    for i in range(MOTION.bias, MOTION.accelerometer):
        x[i] = kernels.clamp(x[i], -most, most)
    return mode


@compiled
def _update_by_force(
    state: Filter, before: StateRecord, after: StateRecord, acting: Acting, F: Array
) -> None:
    """Correct the estimate at ``before`` by the specific force felt since; F is overwritten."""
    x, P, duration = state.motion.x, state.motion.P, acting.durations.sum()
    was = x.copy()
    predict_motion(state.estimated, state.drag_shape, state.motion, acting, before, after, F)
    later = x.copy()
    x[:] = was
    lag_shows = _lag_shows(state, F, duration)
    gravity, between = state.nominal.gravity, (before, after)
    seen = force_innovation(x, P, F, later, between, duration, gravity, state.felt)
    state.felt.nis = kalman.squared_distance(seen, 0.0)
    if not state.felt.nis <= kalman.GATE:
        return
    considered = _considered(state, UpdateMode.LEARN, after.R_WB, lag_shows)
    kalman.update(x, P, seen, considered)
    _constrain_motion(state, considered)
    write_estimated(state, state.estimated)
    state.felt.used = 1


@compiled
def _update_position(state: Filter, measured: Array, considered: Array) -> None:
    """Correct by a measured position (3,); where it jumps it is taken as it is."""
    x, P, H, nu = state.motion.x, state.motion.P, np.zeros((3, MOTION.size)), np.empty(3)
    for k in range(3):
        H[k, MOTION.position + k] = 1.0
        nu[k] = measured[k] - x[MOTION.position + k]
    variance = measurement_noise.variance_in(state.position_noise)
    seen = kalman.innovation(P, H, variance, nu)
    state.position_nis = kalman.squared_distance(seen, 0.0)
    if state.position_nis <= kalman.GATE:
        kalman.update(x, P, seen, considered)
        return
    state.drift.off[:] = 0.0
    for k in range(3):
        i = MOTION.position + k
        x[i] = measured[k]
        P[i, :] = 0.0
        P[:, i] = 0.0
        P[i, i] = variance


@compiled
def update_turning(state: Filter, after: StateRecord, acting: Acting, mode: UpdateMode) -> None:
    """Predict and update the rates, and what is learned by them."""
    x, P, walks, n = state.turning.x, state.turning.P, state.walks.turning, TURNING.size
    if P[ROLL_PITCH, ROLL_PITCH] + P[YAW, YAW] <= 0.0:
        return
    duration, slow = acting.durations.sum(), _slowed(state.slow, acting, after.w_WB_B)
    if mode in (UpdateMode.HOLD, UpdateMode.REJECT):
        _take_rates(state)
        return
    F, H = np.empty((n, n)), np.empty((3, n))
    predict_turning(state.nominal, state.rate_lags.share, state.turning, slow, F, H)
    Q = np.zeros(n)
    for i in range(n):
        if i < TURNING.lag or P[i, i] < walks.P[i, i]:
            Q[i] = walks.x[i] * duration
    kalman.predict(P, F, Q)
    nu, considered = np.zeros(3), np.zeros(n)
    for k in range(3):
        for i in range(n):
            nu[k] -= H[k, i] * x[i]
        nu[k] += state.slow.measured[k]
    if mode != UpdateMode.LEARN:
        considered[TURNING.lag :] = 1.0
    R = _RATE_NOISE**2 / duration
    kalman.update(x, P, kalman.innovation(P, H, R, nu), considered)
    _constrain_turning(state, considered)


@compiled
def _take_rates(state: Filter) -> None:
    """Take the rates as measured, behind the low-pass, and keep what was learned."""
    x, P = state.turning.x, state.turning.P
    for k in range(3):
        i = TURNING.rate + k
        x[i] = state.slow.measured[k]
        P[i, :] = 0.0
        P[:, i] = 0.0


@compiled
def _begin_turning(state: Filter, w_WB_B: Array) -> None:
    """Begin with rates (3,) as measured.

    Rates that follow commands and offsets through a lag do so behind the low-pass too, if it
    begins with rates and commands that are alike, but for the offset, and without thrust.
    """
    slow = state.slow
    slow.command[:] = 0.0
    add_offsets(state, slow.command)
    for k in range(3):
        slow.measured[k] = slow.last[k] = w_WB_B[k]
        slow.command[U_RATE + k] = w_WB_B[k] - slow.command[U_RATE + k]
    _take_rates(state)


@compiled
def _slowed(slow: SlowRates, acting: Acting, measured: Array) -> Acting:
    """Carry commands and measured rates (3,) through the low-pass; return the former.

    Each is the mean over its duration. The rates were linear since those before.
    """
    commands = acting.commands.copy()
    for k in range(len(commands)):
        decay, share = first_order_lag(_SMOOTHING, acting.durations[k])
        for i in range(commands.shape[1]):
            command, off = acting.commands[k, i], slow.command[i] - acting.commands[k, i]
            commands[k, i] = command + share * off
            slow.command[i] = command + decay * off
    decay, share = first_order_lag(_SMOOTHING, acting.durations.sum())
    for i in range(3):
        change = measured[i] - slow.last[i]
        slow.measured[i] = decay * (slow.measured[i] - slow.last[i]) + measured[i] - share * change
        slow.last[i] = measured[i]
    return Acting(acting.durations, commands)


@compiled
def restart(state: Filter, p_WB: Array, v_WB_W: Array) -> None:
    """Take position and velocity (3,) as measured, and keep what was learned, and the bias."""
    x, P = state.motion.x, state.motion.P
    for k in range(3):
        p, v, b = MOTION.position + k, MOTION.velocity + k, MOTION.bias + k
        x[p], x[v] = p_WB[k], v_WB_W[k] - x[b]
        P[p, :] = 0.0
        P[:, p] = 0.0
        P[p, p] = measurement_noise.variance_in(state.position_noise)
        # Its error is that of the bias, with the other sign, and the noise.
        P[v, :] = -P[b, :]
        P[:, v] = -P[:, b]
        P[v, v] = P[b, b] + measurement_noise.variance_in(state.velocity_noise)


@compiled
def write_estimated(state: Filter, parameters: ModelParameters) -> None:
    """Write the parameters as estimated by now."""
    x, turning, shares = state.motion.x, state.turning.x, state.rate_lags.share
    shape, nominal = state.drag_shape, state.nominal
    learned = x[MOTION.drag] - nominal.drag
    parameters.a, parameters.b, parameters.c = nominal.a, nominal.b, nominal.c
    parameters.gravity = nominal.gravity
    parameters.translational_lift = nominal.translational_lift
    longest = error_state.LAG_FACTOR * nominal.thrust_time_constant
    parameters.thrust_time_constant = min(x[MOTION.lag], longest)
    parameters.thrust_scale = x[MOTION.scale]
    parameters.drag = x[MOTION.drag]
    for k in range(3):
        parameters.rotor_drag[k] = nominal.rotor_drag[k]
        parameters.a_W[k] = x[MOTION.disturbance + k]
        uneven = learned * shape[k]
        parameters.learned_drag[k] = learned + uneven
        parameters.uneven_drag[k] = nominal.uneven_drag[k] + uneven
        lag = YAW if k == 2 else ROLL_PITCH
        parameters.rate_time_constants[k] = shares[k] * turning[lag]
    for k in range(2):
        parameters.rate_offset[k] = turning[TURNING.offset + k]
        parameters.rate_offset_by_thrust[k] = turning[TURNING.offset_by_thrust + k]


@compiled
def add_offsets(state: Filter, command: Array) -> None:
    """Make of a command (4,) what the rates follow."""
    x, thrust = state.turning.x, modelled_thrust(state.nominal, command[U_THROTTLE])
    for k in range(2):
        command[U_RATE + k] += x[TURNING.offset + k] + x[TURNING.offset_by_thrust + k] * thrust


@compiled
def is_at_bounds(state: Filter) -> bool:
    """Whether disturbance or scale are as far as they may go."""
    x, farthest = state.motion.x, state.bounds.disturbance_max
    d, k = MOTION.disturbance, x[MOTION.scale]
    far = max(abs(x[d]), abs(x[d + 1])) >= farthest or abs(x[d + 2]) >= VERTICAL_BOUND
    return bool(far or not SCALE_BOUNDS[0] < k < SCALE_BOUNDS[1])


@compiled
def _lag_shows(state: Filter, F: Array, duration: float) -> bool:
    """Whether the thrust changes so fast that its time constant shows in the velocity.

    By itself, and by the throttle, which has lagged with it until now.
    """
    shown, speed, P = 0.0, 0.0, state.motion.P
    if P[MOTION.lag, MOTION.lag] <= 0.0:
        return False
    lagged = P[MOTION.throttle, MOTION.lag] / P[MOTION.lag, MOTION.lag]
    for k in range(3):
        i = MOTION.velocity + k
        shown += (F[i, MOTION.lag] + F[i, MOTION.throttle] * lagged) ** 2
        speed += state.motion.x[i] ** 2
    spread = math.sqrt(state.walks.motion.P[MOTION.lag, MOTION.lag])
    hidden = _HIDDEN + _HIDDEN_BY_SPEED * math.sqrt(speed)
    return spread * math.sqrt(shown) > hidden * duration


@compiled
def _follow_noise(
    state: Filter,
    was: Array,
    states: tuple[StateRecord, StateRecord],
    mode: UpdateMode,
    duration: float,
) -> None:
    """Learn of the noise by two measurements and by the prediction from the estimate ``was``."""
    before, after = states
    white = measurement_noise.variance_in(state.position_noise)
    measurement_noise.follow_drift(state.drift, after.p_WB, after.v_WB_W, white, duration)
    if mode == UpdateMode.HOLD:
        state.position_noise.known = state.velocity_noise.known = 0
        return
    x = state.motion.x
    of_p = _unpredicted(before.p_WB, after.p_WB, was, x, MOTION.position)
    of_v = _unpredicted(before.v_WB_W, after.v_WB_W, was, x, MOTION.velocity)
    measurement_noise.follow(state.position_noise, of_p, duration)
    measurement_noise.follow(state.velocity_noise, of_v, duration)


@compiled
def _unpredicted(
    measured_before: Array, measured: Array, was: Array, x: Array, i: int
) -> kernels.Vector:
    """Return by how much a measured change (3,) differs from that of a block of the state."""
    return (
        measured[0] - measured_before[0] - x[i] + was[i],
        measured[1] - measured_before[1] - x[i + 1] + was[i + 1],
        measured[2] - measured_before[2] - x[i + 2] + was[i + 2],
    )


@compiled
def _add_memory(x: Array, F: Array, mode: UpdateMode, duration: float) -> None:
    """Let what lasts for a time only decay, of the estimate and in its Jacobian."""
    kept = math.exp(-duration / _BIAS_TIME)
    for k in range(3):
        x[MOTION.bias + k] *= kept
        F[MOTION.bias + k, MOTION.bias + k] = kept
    if mode == UpdateMode.LEARN:
        vertical = MOTION.disturbance + 2
        kept = math.exp(-duration / error_state.VERTICAL_TIME)
        x[vertical] *= kept
        F[vertical, vertical] = kept


@compiled
def _motion_noise(state: Filter, white: float, drifting: float, duration: float) -> Array:
    """Return the process noise over a duration, the variances (n,)."""
    P, walks, Q = state.motion.P, state.walks.motion, np.zeros(MOTION.size)
    # What is felt follows the disturbance whatever noise the velocity has.
    quieter = 1.0 if state.felt.used else measurement_noise.USUAL / math.sqrt(white)
    for i in range(LEARNED_OF_MOTION[0], LEARNED_OF_MOTION[1]):
        if i < MOTION.scale:
            Q[i] = walks.x[i] * quieter * max(quieter, 1.0) * duration
        elif P[i, i] < walks.P[i, i]:  # what is not observed is no less certain than at first
            Q[i] = walks.x[i] * duration
    for k in range(3):
        Q[MOTION.velocity + k] = _ACCELERATION_NOISE**2 * duration
        Q[MOTION.bias + k] = drifting * -math.expm1(-2.0 * duration / _BIAS_TIME)
        i = MOTION.accelerometer + k
        if P[i, i] < walks.P[i, i]:
            Q[i] = walks.x[i] * duration
    return Q


@compiled
def _add_unmodelled(P: Array, duration: float) -> None:
    """Add what an unknown acceleration makes of position and velocity over a duration."""
    by_p, by_v = 0.5 * duration**2 * _UNMODELLED, duration * _UNMODELLED
    for k in range(3):
        p, v = MOTION.position + k, MOTION.velocity + k
        P[p, p] += by_p**2
        P[v, v] += by_v**2
        P[p, v] += by_p * by_v
        P[v, p] += by_p * by_v


@compiled
def _turns_evenly(before: StateRecord, after: StateRecord, duration: float) -> bool:
    """Whether the attitude turned by the mean of the measured rates."""
    w = kernels.plus(kernels.vector(before.w_WB_B), kernels.vector(after.w_WB_B))
    turn, R_after = kernels.scaled(0.5 * duration, w), kernels.matrix(after.R_WB)
    R_turned = kernels.multiply(kernels.matrix(before.R_WB), kernels.exp(turn))
    cosines = 0.0
    for i in range(9):
        cosines += R_turned[i] * R_after[i]
    return cosines >= 1.0 + 2.0 * math.cos(_TURN_JUMP)


@compiled
def _considered(state: Filter, mode: UpdateMode, R_WB: Array, lag_shows: bool) -> Array:
    """Return which states of the motion (n,) are considered, not estimated."""
    considered, x = np.zeros(MOTION.size), state.motion.x
    if mode != UpdateMode.LEARN:
        considered[LEARNED_OF_MOTION[0] : LEARNED_OF_MOTION[1]] = 1.0
        return considered
    d, v = MOTION.disturbance, kernels.vector(x[MOTION.velocity : MOTION.disturbance])
    # Along the thrust, as in a climb, drag is not told from thrust.
    along = kernels.dot(v, kernels.column(kernels.matrix(R_WB), 2))
    speed = kernels.dot(v, v) - along**2
    pushed = max(abs(x[d]), abs(x[d + 1])) >= state.bounds.disturbance_max
    considered[MOTION.lag] = not lag_shows
    # What a bound of the disturbance leaves is not to be taken for drag.
    considered[MOTION.drag] = speed <= _OBSERVABLE_SPEED**2 or pushed
    return considered


@compiled
def _constrain_motion(state: Filter, considered: Array) -> None:
    """Bring what was learned of the motion inside its bounds."""
    x, P, nominal = state.motion.x, state.motion.P, state.nominal
    lag, drag, d = nominal.thrust_time_constant, nominal.drag, MOTION.disturbance
    factor, farthest = error_state.LAG_FACTOR, state.bounds.disturbance_max
    latest = lag * factor + (error_state.LATEST if lag > 0.0 else 0.0)
    least, most = error_state.DRAG_FACTORS
    most = max(most * drag, drag + error_state.DRAG_MORE)
    for i, low, high in (
        (d, -farthest, farthest),
        (d + 1, -farthest, farthest),
        (d + 2, -VERTICAL_BOUND, VERTICAL_BOUND),
        (MOTION.drag, least * drag, most),
        (MOTION.lag, lag / factor, latest),
        (MOTION.scale, SCALE_BOUNDS[0], SCALE_BOUNDS[1]),
    ):
        kalman.constrain(x, P, i, (low, high), considered)
    # What went along with one may be beyond its own by now.
    x[MOTION.drag] = kernels.clamp(x[MOTION.drag], least * drag, most)
    x[MOTION.lag] = kernels.clamp(x[MOTION.lag], lag / factor, latest)
    for k in range(3):
        bound = VERTICAL_BOUND if k == 2 else farthest
        x[d + k] = kernels.clamp(x[d + k], -bound, bound)


@compiled
def _constrain_turning(state: Filter, considered: Array) -> None:
    """Bring what was learned of the rates inside its bounds."""
    x, P, lags = state.turning.x, state.turning.P, state.rate_lags
    for i, axis in ((ROLL_PITCH, 0), (YAW, 2)):
        bounds = lags.shortest[axis], lags.longest[axis]
        kalman.constrain(x, P, i, bounds, considered)
    for k in range(2):
        i, most = TURNING.offset + k, error_state.OFFSET_BOUND
        x[i] = kernels.clamp(x[i], -most, most)
        i, most = TURNING.offset_by_thrust + k, error_state.OFFSET_BY_THRUST_BOUND
        x[i] = kernels.clamp(x[i], -most, most)


def _assume(state: Filter, closer: float) -> None:
    """Write what is assumed of each state, by the configured parameters."""
    nominal, motion, turning = state.nominal, state.walks.motion, state.walks.turning
    roll, pitch, yaw = nominal.rate_time_constants.tolist()
    shared = 0.5 * (roll + pitch)
    # An offset that is found soon makes a loop as quick: only where short lags are configured.
    share = min(closer - 1.0, 1.0) if max(roll, pitch, yaw) > 0.0 else 0.0
    d, of_lag = MOTION.disturbance, error_state.LAG
    for i, assumed, scale in (
        (d, error_state.DISTURBANCE, 1.0),
        (d + 1, error_state.DISTURBANCE, 1.0),
        (d + 2, error_state.VERTICAL, 1.0),
        (MOTION.scale, error_state.SCALE, 1.0),
        (MOTION.lag, error_state.THRUST_LAG, nominal.thrust_time_constant),
        (MOTION.drag, error_state.DRAG, 1.0),
    ):
        motion.P[i, i], motion.x[i] = variances_at(assumed, scale)
    initial = measurement_noise.drift_variance_in(state.drift, 0.0)
    for k in range(3):
        motion.P[MOTION.bias + k, MOTION.bias + k] = initial
    for i, assumed, scale in (
        (ROLL_PITCH, of_lag, shared),
        (YAW, error_state.YAW_LAG, yaw),
        *((TURNING.offset + k, error_state.OFFSET, share) for k in range(2)),
        *((TURNING.offset_by_thrust + k, error_state.OFFSET_BY_THRUST, share) for k in range(2)),
        (TURNING.lateness, error_state.LATENESS, share),
    ):
        turning.P[i, i], turning.x[i] = variances_at(assumed, scale)
    turning.x[TURNING.rate : TURNING.lag] = _RATE_WALK**2
    # Shorter lags are trusted more: a lag that is learned although it is none, of odometry that
    # is late, is answered by commands that lead more, and oscillates.
    lags, shortest = state.rate_lags, error_state.SHORTEST_RATE_LAG
    lags.share[:] = roll / (shared or 1.0), pitch / (shared or 1.0), yaw / (yaw or 1.0)
    lags.shortest[:] = shortest * shared, shortest * shared, shortest * yaw
    slowest = (1.0 + 1.0 / closer) * shared
    lags.longest[:] = slowest, slowest, error_state.SLOWEST_YAW * yaw


def _assume_accelerometer(state: Filter) -> None:
    """Write what is assumed of an accelerometer; without one it is known to have no bias."""
    motion = state.walks.motion
    for i in range(MOTION.accelerometer, MOTION.size):
        motion.P[i, i], motion.x[i] = variances_at(error_state.ACCELEROMETER)


def _closer(nominal: ModelParameters, delay: float) -> float:
    """Return by how much closer than usual a vehicle is followed, 1 at least.

    What is learned is answered by commands, and a loop that is quicker than the actuators
    oscillates. Where they are as quick as the default's it is as usual. No lag is a lag of 0.
    """
    roll, pitch, _yaw = nominal.rate_time_constants
    latency = max(roll, pitch) + nominal.thrust_time_constant + delay
    if latency <= _USUAL_LATENCY / math.sqrt(_CLOSEST):
        return _CLOSEST
    return float(max((_USUAL_LATENCY / latency) ** 2, 1.0))
