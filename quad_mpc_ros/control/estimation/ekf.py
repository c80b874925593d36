# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The extended Kalman filter of the vehicle's motion and parameters.

Between two odometries the MPC's own model predicts position, velocity, throttle and body rates
from the delayed and lagged commands. The measurements correct the prediction and the parameters
(:mod:`.filter_state` has the states, :mod:`.kalman` the equations).
docs/explanation/estimation.md explains how the states are distinguished.

    dd/dt = noise, for d_z -d_z / T + noise        disturbance acceleration
    db/dt = -b / T_b + noise                       bias of the measured velocity
    da/dt = noise                                  bias of the accelerometer, if there is one
    all other parameters: a random walk, no more uncertain than at the start

    z_p = p + n,   z_v = v + b + n,   z_w = w + n,   z_f = R' (dv/dt - g) + a + n

**k and d_z** are not separately observable at hover, only the sum k T/m + d_z = g. Their process
noise separates them: wind changes, a thrust deficit lasts. **Drag** is distinguished from wind
by motion, and only considered at low speed. **A velocity bias** is distinguished by the change of
the position. :mod:`.update_mode` selects what an odometry may change. A time constant of zero
means no lag and stays zero. The input delay is not estimated (``docs/howto/tune.md``): an
unmodelled delay appears as a lag of the torque.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import measurement_noise
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.filter_state import (
    ACCELEROMETER,
    DISTURBANCE,
    DRAG,
    LEARNED_STATES,
    LONGEST_RATE_LAG,
    MOTION,
    OFFSET,
    OFFSET_BY_THRUST,
    RATE_LAG,
    RATES,
    ROLL_PITCH,
    SCALE,
    SCALE_BOUNDS,
    THRUST_LAG,
    TORQUE_LAG,
    VERTICAL,
    YAW,
    Filter,
    RateEstimate,
    TranslationEstimate,
    variances_at,
    write_estimated,
)
from quad_mpc_ros.control.estimation.rate_update import (
    begin_rates,
    take_rates,
    update_rates,
)
from quad_mpc_ros.control.estimation.rate_weights import start_rate_weights
from quad_mpc_ros.control.estimation.translation_update import restart, update_translation
from quad_mpc_ros.control.estimation.update_mode import UpdateMode, update_mode
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import U_THROTTLE

# A landing is detected some time after the touchdown, and the estimate since then is wrong. So the
# estimate is restored from the oldest of some snapshots.
_SNAPSHOT_PERIOD_NS, _MAX_SNAPSHOTS = 1_000_000_000, 5

# Of the model's rates [rad/s / sqrt(s)] and angular accelerations [rad/s^2 / sqrt(s)].
_RATE_PROCESS_NOISE, _ACCELERATION_PROCESS_NOISE = 0.2, 2.0
# Latency of the default vehicle from command to response [s], and the largest bandwidth scale.
_DEFAULT_LATENCY, _MAX_BANDWIDTH_SCALE = 0.13, 4.0


class VehicleEkf:
    """The filter of a vehicle; :func:`update` takes an odometry."""

    def __init__(
        self,
        nominal: ModelParameters,
        *,
        throttle: float,
        delay: float = 0.0,
        enabled: bool = True,
        uses_accelerometer: bool = False,
        state: Filter,
    ) -> None:
        """``nominal`` are the configured parameters, ``throttle`` is the initial throttle.

        ``delay`` [s] is the input delay. The estimate is kept in ``state``, initially zeros.
        """
        self._filter, self._initial_throttle = state, throttle
        self._snapshots: deque[tuple[int, TranslationEstimate, RateEstimate]] = deque(
            maxlen=_MAX_SNAPSHOTS
        )
        state.nominal = state.estimated = nominal
        state.enabled = int(enabled)
        state.drag_shape[:] = nominal.anisotropic_drag / (nominal.drag or 1.0)
        bounds = state.bounds
        bounds.throttle_min, bounds.throttle_max = -math.inf, math.inf
        bounds.disturbance_max = math.inf
        bandwidth_scale = bandwidth_scale_of(nominal, delay)
        measurement_noise.start(state.velocity_noise, measurement_noise.USUAL / bandwidth_scale)
        measurement_noise.start(state.position_noise, measurement_noise.LEAST_OF_POSITION)
        measurement_noise.start_drift(state.drift)
        state.translation.x[MOTION.scale] = 1.0
        set_initial_variances(state, bandwidth_scale, uses_accelerometer)
        self.start_over()
        self.start(p_WB=np.zeros(3), v_WB_W=np.zeros(3), w_WB_B=np.zeros(3))

    def start_over(self) -> None:
        """Return to the configured parameters, with the initial covariance.

        The vertical disturbance is moved into the thrust scale, so that the total vertical force
        is kept: the vehicle may depend on it in flight.
        """
        self._snapshots.clear()
        state = self._filter
        nominal, x = state.nominal, state.translation.x
        lifted = nominal.gravity - x[MOTION.disturbance + 2]
        scale = x[MOTION.scale] * nominal.gravity / lifted
        x[MOTION.disturbance : MOTION.scale] = 0.0
        x[MOTION.scale] = min(max(scale, SCALE_BOUNDS[0]), SCALE_BOUNDS[1])
        x[MOTION.accelerometer :] = 0.0
        x[MOTION.lag], x[MOTION.drag] = nominal.thrust_time_constant, nominal.drag
        state.translation.P[:] = state.process_noise.translation.P
        state.rates.x[:] = 0.0
        state.rates.P[:] = state.process_noise.rates.P
        start_rate_weights(state)
        restart(state, x[: MOTION.velocity].copy(), x[MOTION.velocity : MOTION.disturbance].copy())

    def reconfigure(
        self, *, throttle_min: float, throttle_max: float, disturbance_max: float
    ) -> None:
        """Apply changed bounds of the throttle and of the horizontal disturbance."""
        bounds = self._filter.bounds
        bounds.throttle_min, bounds.throttle_max = throttle_min, throttle_max
        bounds.disturbance_max = disturbance_max

    def parameters(self) -> ModelParameters:
        """Return the estimated parameters."""
        write_estimated(self._filter)
        return self._filter.estimated.copy()

    def keep(self, now_ns: int) -> None:
        """Keep a snapshot of estimate and covariance, once a second."""
        state, snapshots = self._filter, self._snapshots
        if not (snapshots and 0 <= now_ns - snapshots[-1][0] < _SNAPSHOT_PERIOD_NS):
            snapshots.append((now_ns, state.translation.copy(), state.rates.copy()))

    def restore(self) -> None:
        """Return to the oldest snapshot, if there is one, but keep the current motion."""
        if not self._snapshots:
            return
        _, translation, rates = self._snapshots[0]
        self._snapshots.clear()
        state, learned = self._filter, slice(*LEARNED_STATES)
        now = state.translation.x.copy()
        now[learned] = translation.x[learned]
        state.translation, state.rates = translation, rates
        state.translation.x[:] = now
        position, velocity = now[: MOTION.velocity], now[MOTION.velocity : MOTION.disturbance]
        restart(state, position.copy(), velocity + now[MOTION.bias : MOTION.accelerometer])
        take_rates(state)

    def turn(self, reset: EstimateReset) -> None:
        """Apply an announced jump of the world frame."""
        self._snapshots.clear()  # in the old coordinates
        x, P, turns = self._filter.translation.x, self._filter.translation.P, np.eye(MOTION.size)
        turn, drift = reset.vectors(np.eye(3)).T, self._filter.drift
        for begin in (MOTION.position, MOTION.velocity, MOTION.disturbance, MOTION.bias):
            block = slice(begin, begin + 3)
            turns[block, block] = turn
        x[:] = turns @ x
        x[: MOTION.velocity] += reset.step_W
        P[:] = turns @ P @ turns.T
        drift.p_WB[:], drift.v_WB_W[:] = reset.points(drift.p_WB), reset.vectors(drift.v_WB_W)
        drift.off[:] = reset.vectors(drift.off)
        for noise in (self._filter.position_noise, self._filter.velocity_noise):
            noise.change[:] = reset.vectors(noise.change)

    def start(self, *, p_WB: Array, v_WB_W: Array, w_WB_B: Array) -> None:
        """Start at measured position, velocity and rates (3,); parameters are kept."""
        state = self._filter
        state.translation.x[MOTION.throttle] = self._initial_throttle
        state.translation.P[MOTION.throttle, :] = state.translation.P[:, MOTION.throttle] = 0.0
        state.position_noise.has_previous = state.velocity_noise.has_previous = 0
        measurement_noise.begin_drift(state.drift, p_WB, v_WB_W)
        restart(state, p_WB, v_WB_W)
        begin_rates(state, w_WB_B)


@compiled
def update(
    state: Filter,
    before: StateRecord,
    after: StateRecord,
    acting: Acting,
    permitted: int,
    reported_variance: float,
) -> UpdateMode:
    """Update from one odometry to the next, with the commands in effect between them.

    ``before`` and ``after`` are the measured states, ``permitted`` is the :class:`.UpdateMode`
    that commands and ground permit, ``reported_variance`` [m^2/s^2] the variance of the second
    velocity, 0 if unknown. Returns the mode of the update.
    """
    if len(acting.durations) == 0:
        return UpdateMode.HOLD
    duration, saturated = acting.durations.sum(), False
    for k in range(len(acting.durations)):
        throttle = acting.commands[k, U_THROTTLE]
        saturated |= not state.bounds.throttle_min < throttle < state.bounds.throttle_max
    mode = update_mode(permitted, saturated, state.paused_for)
    if mode == UpdateMode.VELOCITY_ONLY:
        state.paused_for += duration
        mode = update_mode(permitted, saturated, state.paused_for)
    elif mode == UpdateMode.LEARN:
        state.paused_for = 0.0
    mode = update_translation(state, before, after, acting, mode, reported_variance)
    update_rates(state, after, acting, mode)
    return mode


def set_initial_variances(state: Filter, bandwidth_scale: float, uses_accelerometer: bool) -> None:
    """Write the initial variances and the process noise of each state."""
    nominal = state.nominal
    translation, rates = state.process_noise.translation, state.process_noise.rates
    roll, pitch, yaw = nominal.rate_time_constants.tolist()
    torque_roll, _pitch, torque_yaw = nominal.torque_time_constants.tolist()
    # Quickly estimated offsets raise the bandwidth: only for vehicles configured with short lags.
    share = min(bandwidth_scale - 1.0, 1.0) if max(roll, pitch, yaw) > 0.0 else 0.0
    d = MOTION.disturbance
    for i, assumed, scale in (
        (d, DISTURBANCE, 1.0),
        (d + 1, DISTURBANCE, 1.0),
        (d + 2, VERTICAL, 1.0),
        (MOTION.scale, SCALE, 1.0),
        (MOTION.lag, THRUST_LAG, nominal.thrust_time_constant),
        (MOTION.drag, DRAG, 1.0),
        *(
            (i, ACCELEROMETER, float(uses_accelerometer))
            for i in range(MOTION.accelerometer, MOTION.size)
        ),
    ):
        translation.P[i, i], translation.x[i] = variances_at(assumed, scale)
    initial = measurement_noise.drift_variance_in(state.drift, 0.0)
    for k in range(3):
        translation.P[MOTION.bias + k, MOTION.bias + k] = initial
    for i, assumed, scale in (
        (RATES.lag + ROLL_PITCH, RATE_LAG, float(roll + pitch > 0.0)),
        (RATES.lag + YAW, RATE_LAG, float(yaw > 0.0)),
        (RATES.torque_lag + ROLL_PITCH, TORQUE_LAG, float(torque_roll > 0.0)),
        (RATES.torque_lag + YAW, TORQUE_LAG, float(torque_yaw > 0.0)),
        *((RATES.offset + k, OFFSET, share) for k in range(2)),
        *((RATES.offset_by_thrust + k, OFFSET_BY_THRUST, share) for k in range(2)),
    ):
        rates.P[i, i], rates.x[i] = variances_at(assumed, scale)
    rates.x[RATES.rate : RATES.acceleration] = _RATE_PROCESS_NOISE**2
    rates.x[RATES.acceleration : RATES.lag] = _ACCELERATION_PROCESS_NOISE**2
    # Late odometry looks like a lag; compensating a lag that does not exist oscillates. So the
    # longest lag is closer to the configured one for quick vehicles.
    longest = LONGEST_RATE_LAG - 1.0
    state.longest_rate_lag = 1.0 + longest / bandwidth_scale


def bandwidth_scale_of(nominal: ModelParameters, delay: float) -> float:
    """Return the estimator's bandwidth relative to the default, at least 1.

    Commands respond to the estimate, and a loop faster than the actuators oscillates.
    """
    roll, pitch, _yaw = nominal.rate_time_constants
    latency = max(roll, pitch) + nominal.thrust_time_constant + delay
    if latency <= _DEFAULT_LATENCY / math.sqrt(_MAX_BANDWIDTH_SCALE):
        return _MAX_BANDWIDTH_SCALE
    return float(max((_DEFAULT_LATENCY / latency) ** 2, 1.0))
