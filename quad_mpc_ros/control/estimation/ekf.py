"""The extended Kalman filter of the vehicle: its motion, and what the model does not know of it.

Between two odometries position, velocity, throttle and body rates are predicted by the MPC's own
model with the commands that were really acting, delayed and lagged (:mod:`.process_model`); then
they are corrected by what was measured, and with them what is learned of the vehicle
(:mod:`.error_state` has the states, :mod:`.kalman` the equations of the filter).
docs/explanation/estimation.md derives how the states are distinguished.

    dd/dt = noise, of d_z -d_z / T + noise         the disturbance; what lasts of d_z is thrust
    db/dt = -b / T_b + noise                       what the measured velocity errs for long
    da/dt = noise                                  the bias of an accelerometer, if there is one
    all else that is learned: a random walk, no more uncertain than at the start

    z_p = p + n,   z_v = v + b + n,   z_w = w - D dw/dt + n,   z_f = R' (dv/dt - g) + a + n

**k and d_z look alike at hover**: only their sum k T/m + d_z = g is observable. What is likely
separates them: winds change, a lack of thrust lasts. **Drag** is distinguished from wind by
motion, and is considered below a speed. **A velocity that errs for seconds**, as that of
autopilots, is distinguished by how the position moves. What an odometry may change says
:mod:`.update_mode`; a time constant of zero is no lag and stays. The delay of the input is not
estimated: ``docs/howto/tune.md`` says why.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import measurement_noise
from quad_mpc_ros.control.estimation.assumptions import assume, assume_accelerometer, closeness
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.error_state import (
    LEARNED_STATES,
    MOTION,
    ROLL_PITCH,
    SCALE_BOUNDS,
    YAW,
)
from quad_mpc_ros.control.estimation.filter_state import Filter, write_estimated
from quad_mpc_ros.control.estimation.rate_update import (
    begin_rates,
    take_rates,
    update_rates,
)
from quad_mpc_ros.control.estimation.translation_update import restart, update_translation
from quad_mpc_ros.control.estimation.update_mode import Conditions, UpdateMode, update_mode
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.state import U_THROTTLE


class EkfMemory(NamedTuple):
    """What is estimated at a moment."""

    translation: Any
    rates: Any


class VehicleEkf:
    """Follows a vehicle from odometry to odometry."""

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
        """``nominal`` are the configured parameters, ``throttle`` is where it begins.

        ``delay`` [s] is that of the input; ``uses_accelerometer`` says that there is one. The
        estimate is kept in ``state``, zeros to begin with; :func:`update` goes on with it.
        """
        self._filter, self._initial_throttle = state, throttle
        state.nominal = state.estimated = nominal
        state.enabled = int(enabled)
        state.drag_shape[:] = nominal.anisotropic_drag / (nominal.drag or 1.0)
        bounds = state.bounds
        bounds.throttle_min, bounds.throttle_max = -math.inf, math.inf
        bounds.disturbance_max = math.inf
        closer = closeness(nominal, delay)
        measurement_noise.start(state.velocity_noise, measurement_noise.USUAL / closer)
        measurement_noise.start(state.position_noise, measurement_noise.LEAST_OF_POSITION)
        measurement_noise.start_drift(state.drift)
        state.translation.x[MOTION.scale] = 1.0
        assume(state, closer)
        if uses_accelerometer:
            assume_accelerometer(state)
        self.start_over()
        self.start(p_WB=np.zeros(3), v_WB_W=np.zeros(3), w_WB_B=np.zeros(3))

    def start_over(self) -> None:
        """Return to the configured parameters, with the covariance of the start.

        But for the thrust: its scale becomes that which alone carries the vehicle as scale and
        disturbance did together, for it may have been flying by them.
        """
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
        state.rates.x[ROLL_PITCH] = 0.5 * sum(nominal.rate_time_constants.tolist()[:2])
        state.rates.x[YAW] = nominal.rate_time_constants[2]
        state.rates.P[:] = state.process_noise.rates.P
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
        return EkfMemory(self._filter.translation.copy(), self._filter.rates.copy())

    def recall(self, memory: EkfMemory) -> None:
        """Return to an earlier estimate of all but the present motion."""
        state, learned = self._filter, slice(*LEARNED_STATES)
        now = state.translation.x.copy()
        now[learned] = memory.translation.x[learned]
        state.translation, state.rates = memory.translation, memory.rates
        state.translation.x[:] = now
        position, velocity = now[: MOTION.velocity], now[MOTION.velocity : MOTION.disturbance]
        restart(state, position.copy(), velocity + now[MOTION.bias : MOTION.accelerometer])
        take_rates(state)

    def turn(self, reset: EstimateReset) -> None:
        """Take an announced step of the world's coordinates."""
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

    def start(self, *, p_WB: Array, v_WB_W: Array, w_WB_B: Array) -> None:
        """Begin with position, velocity and rates (3,) as measured; what was learned is kept."""
        state = self._filter
        state.translation.x[MOTION.throttle] = self._initial_throttle
        state.translation.P[MOTION.throttle, :] = state.translation.P[:, MOTION.throttle] = 0.0
        state.position_noise.known = state.velocity_noise.known = 0
        measurement_noise.begin_drift(state.drift, p_WB, v_WB_W)
        restart(state, p_WB, v_WB_W)
        begin_rates(state, w_WB_B)


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
    mode = update_mode(conditions, saturated, state.paused_for)
    if mode == UpdateMode.VELOCITY_ONLY:
        state.paused_for += duration
        mode = update_mode(conditions, saturated, state.paused_for)
    elif mode == UpdateMode.LEARN:
        state.paused_for = 0.0
    write_estimated(state, state.estimated)
    mode = update_translation(state, before, after, acting, mode, given_variance)
    update_rates(state, after, acting, mode)
    return mode
