# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Delay compensation: prediction of the state in which the next command will act.

A command sent now acts after the input delay. The state is predicted over the delay through the
commands already sent, with the parameters estimated by the EKF. A tick makes two calls into
compiled code: the update of the EKF, and the prediction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.command_history import CommandHistory, acting_between
from quad_mpc_ros.control.estimation.ekf import VehicleEkf, update
from quad_mpc_ros.control.estimation.estimate_health import EstimateHealth
from quad_mpc_ros.control.estimation.filter_state import (
    MOTION,
    Filter,
    is_at_bounds,
    write_estimated,
)
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.rate_update import add_offsets, track_acceleration
from quad_mpc_ros.control.estimation.rate_weights import rate_weight_scale
from quad_mpc_ros.control.estimation.specific_force import SpecificForces
from quad_mpc_ros.control.estimation.update_mode import LONGEST_GAP_NS, MODE_TEXTS, UpdateMode
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import parameters_of
from quad_mpc_ros.control.model.prediction import PredictedState, Prediction
from quad_mpc_ros.control.model.rollout import (
    StateRecord,
    read_odometry,
    roll_forward,
)
from quad_mpc_ros.control.model.samples import Measured, OdometrySample
from quad_mpc_ros.control.model.state import BODY_RATE, U_THROTTLE, Input
from quad_mpc_ros.control.stage import Stage

# Learning starts this long after commands begin to act, as the actuators have to settle.
_ACTUATOR_SETTLING_NS = 300_000_000


class EstimatorState(Record):
    """The last two measured states, without throttle, and the filter."""

    measured: StateRecord
    before: StateRecord
    filter: Filter


class EstimateStatus(NamedTuple):
    """Status of the estimate: the update mode, ``at bounds`` or ``reset``.

    ``resets`` is the number of resets, ``accelerometer`` the use of accelerometer samples.
    """

    text: str = MODE_TEXTS[UpdateMode.HOLD]
    resets: int = 0
    accelerometer: str = "off"  # or missing, paused, used, refused
    imu_stamp_ns: int = 0  # of the newest accelerometer sample


class LearnedModel(NamedTuple):
    """The estimate for the fallbacks.

    ``thrust_scale`` is the ratio of true to modelled thrust, ``a_W`` (3,) [m/s^2] the disturbance
    acceleration. In hover only their combined effect is observable, so use both. ``rate_lag`` and
    ``torque_lag`` are the time constants of the rate loop of roll and pitch [s], ``acceleration``
    (3,) is the angular acceleration at the last odometry [rad/s^2].
    """

    thrust_scale: float = 1.0
    a_W: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate_lag: float = 0.0
    torque_lag: float = 0.0
    acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0)


class DelayCompensation(Stage):
    """Estimates the vehicle's state and parameters, and predicts over the input delay."""

    def __init__(self, config: MpcConfig, *, ground: GroundDetector | None = None) -> None:
        """Without ``ground`` the vehicle is assumed to fly."""
        vehicle = config.vehicle()
        hover = Input(throttle=vehicle.hover_throttle, w_WB_B=np.zeros(3))
        self._delay_ns = round(config.input_delay * 1e9)
        self._rate_gain = np.array(per_axis(config.rate_gain))
        self._history = CommandHistory(delay_ns=self._delay_ns, initial=hover.vector())
        self._learns = config.estimate_disturbance
        # Without lags throttle and acceleration follow from the command and need no update.
        lags = config.lags
        self._follows = self._learns or max(lags.thrust, *per_axis(lags.torque)) > 0.0
        self._buffer = EstimatorState.zeros()
        self._estimator = estimator = self._buffer[()]
        nominal = parameters_of(vehicle, config.lags)
        estimator.filter.latency_uncertainty = config.latency_uncertainty
        self._ekf = VehicleEkf(
            nominal[()],
            throttle=hover.throttle,
            delay=config.input_delay,
            enabled=self._learns,
            uses_accelerometer=config.uses_accelerometer,
            state=estimator.filter,
        )
        self._force_variance = config.accelerometer_noise**2 if config.uses_accelerometer else 0.0
        self.specific_forces = SpecificForces()
        """Accelerometer samples for the next odometry."""
        self._ground = ground
        self._health = EstimateHealth()
        self.status = EstimateStatus()
        self._sent = hover.vector()
        self._engaged, self._was_idle = True, False
        # Stamp of the last odometry, if the commands since then are known.
        self._previous_ns: int | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed bounds."""
        self._config = config
        self._ekf.reconfigure(
            throttle_min=config.throttle_min,
            throttle_max=config.throttle_max,
            disturbance_max=config.disturbance_max,
        )

    def fresh_copy(self) -> DelayCompensation:
        """Return a new instance with the same engagement."""
        fresh = DelayCompensation(self._config, ground=self._ground)
        fresh.engage(self._engaged)
        return fresh

    def learned(self) -> LearnedModel:
        """Return the estimate for the fallbacks."""
        model = self._ekf.parameters()
        return LearnedModel(
            thrust_scale=float(model.thrust_scale),
            a_W=tuple(model.a_W.tolist()),
            rate_lag=0.5 * sum(model.rate_time_constants.tolist()[:2]),
            torque_lag=0.5 * sum(model.torque_time_constants.tolist()[:2]),
            acceleration=tuple(self._estimator.measured.angular_acceleration.tolist()),
        )

    def record(self, command: Input, *, stamp_ns: int) -> None:
        """Record a command and its sending time, by the clock of the odometry's stamps."""
        # The model has no rate gain, so commands are recorded times the gain.
        self._sent[U_THROTTLE] = command.throttle
        self._sent[BODY_RATE] = self._rate_gain * command.w_WB_B
        self._history.record(self._sent, stamp_ns=stamp_ns)

    def engage(self, engaged: bool) -> None:
        """Set whether the vehicle executes commands (initially true).

        If not, estimation is paused, and the estimate of some seconds before is restored. Commands
        are still recorded, as this call may be late.
        """
        if engaged and not self._engaged:
            self._history.forget()
            self._previous_ns = None
            self._was_idle = True
        elif self._engaged and not engaged:
            # The vehicle may have landed before disarming.
            self._ekf.restore()
        self._engaged = engaged

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the measured state and the estimate by an announced odometry jump."""
        self._ekf.turn(reset)
        if self._previous_ns is not None and self._previous_ns < reset.stamp_ns:
            state = self._estimator.measured
            state.p_WB[:] = reset.points(state.p_WB)
            state.v_WB_W[:] = reset.vectors(state.v_WB_W)
            state.R_WB[:] = reset.vectors(state.R_WB.T).T

    def predict(self, odometry: OdometrySample, *, late_ns: int = 0) -> PredictedState:
        """Return the state in which a command sent now will begin to act.

        The odometry's state is predicted over the input delay plus the extra latency ``late_ns``.
        """
        stamp_ns, previous_ns = odometry.stamp_ns, self._previous_ns
        # Restart after a long gap, after a clock was set, and until commands act: what moved the
        # vehicle before is unknown.
        is_next = previous_ns is not None and 0 <= stamp_ns - previous_ns <= LONGEST_GAP_NS
        if previous_ns is None or not (is_next and self._history.acts_at(previous_ns)):
            _read_measurement(self._buffer, odometry.measured)
            measured = self._estimator.measured
            measured.angular_acceleration[:] = 0.0
            self._history.assume(measured.w_WB_B)
            self._ekf.start(p_WB=measured.p_WB, v_WB_W=measured.v_WB_W, w_WB_B=measured.w_WB_B)
            self.status = EstimateStatus(resets=self._health.resets)
            if self._force_variance > 0.0:
                self._take_specific_force(stamp_ns, stamp_ns)
                self.status = self.status._replace(accelerometer="paused")
        elif self._follows:
            self._update_to(odometry, previous_ns)
        else:
            _read_measurement(self._buffer, odometry.measured)
        self._previous_ns = stamp_ns
        return self._predicted(stamp_ns + late_ns, begin_ns=stamp_ns)

    def predict_without_odometry(self, stamp_ns: int) -> PredictedState | None:
        """Return the predicted state at a time after the last odometry; None without odometry."""
        if self._previous_ns is None or stamp_ns < self._previous_ns:
            return None
        return self._predicted(stamp_ns, begin_ns=self._previous_ns)

    def _predicted(self, stamp_ns: int, *, begin_ns: int) -> PredictedState:
        """Predict the measured state until a command sent at a stamp acts."""
        prediction = Prediction.zeros()
        _predict_ahead(
            buffer=self._buffer,
            acts_ns=self._history.acts_ns,
            commands=self._history.commands,
            begin_ns=begin_ns,
            end_ns=stamp_ns + self._delay_ns,
            sent=self._sent,
            prediction=prediction,
        )
        return PredictedState(stamp_ns + self._delay_ns, prediction)

    def _update_to(self, odometry: OdometrySample, previous_ns: int) -> None:
        """Update the EKF with an odometry."""
        stamp_ns = odometry.stamp_ns
        measures = self._force_variance > 0.0
        is_measured = measures and self._take_specific_force(previous_ns, stamp_ns)
        mode, at_bounds = _update_filter(
            buffer=self._buffer,
            measured=odometry.measured,
            v_variance=odometry.v_variance,
            acts_ns=self._history.acts_ns,
            commands=self._history.commands,
            stamps_ns=(previous_ns, stamp_ns),
            permitted=int(self._permitted_mode(previous_ns)),
        )
        self._check_health(mode, at_bounds, stamp_ns, duration=1e-9 * (stamp_ns - previous_ns))
        if measures:
            self.status = self.status._replace(
                accelerometer=self._accelerometer_use(mode, is_measured),
                imu_stamp_ns=self.specific_forces.newest_ns,
            )

    def _take_specific_force(self, previous_ns: int, stamp_ns: int) -> bool:
        """Set the specific force since the last odometry; return whether it was measured."""
        mean = self.specific_forces.mean(start_ns=previous_ns, end_ns=stamp_ns)
        force = self._estimator.filter.specific_force
        force.variance = 0.0 if mean is None else self._force_variance
        if mean is not None:
            force.f_B[:] = mean
        return mean is not None

    def _accelerometer_use(self, mode: int, is_measured: bool) -> str:
        if not is_measured:
            return "missing"
        if self._estimator.filter.specific_force.used:
            return "used"
        return "refused" if mode in (UpdateMode.LEARN, UpdateMode.REJECT) else "paused"

    def _check_health(self, mode: int, at_bounds: bool, stamp_ns: int, *, duration: float) -> None:
        """Set the status after an odometry; reset an estimate that has failed too long."""
        text = MODE_TEXTS[mode]
        if mode in (UpdateMode.LEARN, UpdateMode.REJECT):
            refused = mode == UpdateMode.REJECT
            if at_bounds and not refused:
                text = "at bounds"
            if self._health.fails(
                stamp_ns, duration=duration, refused=refused, at_bounds=at_bounds
            ):
                self._ekf.start_over()
            if self._health.resets > 0 and self._health.was_reset(stamp_ns):
                text = "reset"
        if (text, self._health.resets) != self.status[:2]:
            self.status = EstimateStatus(text, self._health.resets)

    def _permitted_mode(self, previous_ns: int) -> UpdateMode:
        """Return the update that commands and ground permit since the previous odometry."""
        permitted = UpdateMode.LEARN
        if self._ground is not None and self._learns and self._engaged:
            permitted = self._ground.learning
            if self._ground.state.is_on_ground:
                self._ekf.restore()
        settles = self._was_idle and not self._history.acts_at(previous_ns - _ACTUATOR_SETTLING_NS)
        if settles or not (self._learns and self._engaged):
            return UpdateMode.HOLD
        if permitted is UpdateMode.LEARN:
            self._ekf.keep(previous_ns)
        return permitted


@compiled
def _read_measurement(buffer: RecordArray[EstimatorState], measured: Measured) -> None:
    """Read an odometry; the measured state becomes the previous state."""
    estimator, (p_WB, q_WB_xyzw, v_WB_B, w_WB_B) = buffer[()], measured
    estimator.before = estimator.measured
    read_odometry(p_WB, q_WB_xyzw, v_WB_B, w_WB_B, estimator.measured)


@compiled
def _update_filter(
    buffer: RecordArray[EstimatorState],
    measured: Measured,
    v_variance: float,
    acts_ns: NDArray[np.int64],
    commands: Array,
    stamps_ns: tuple[int, int],
    permitted: int,
) -> tuple[int, bool]:
    """Update the filter with an odometry and the commands in effect since the previous one.

    The modes are integers: members of an enum are slow arguments in numba.

    Returns:
        The update mode, and whether the estimate is at its bounds.
    """
    start_ns, end_ns = stamps_ns
    _read_measurement(buffer, measured)
    estimator = buffer[()]
    acting = acting_between(acts_ns=acts_ns, commands=commands, start_ns=start_ns, end_ns=end_ns)
    mode = update(
        state=estimator.filter,
        before=estimator.before,
        after=estimator.measured,
        acting=acting,
        permitted=permitted,
        reported_variance=v_variance,
    )
    if len(acting.durations) > 0:
        track_acceleration(estimator.filter, estimator.before, estimator.measured, acting)
    return mode.value, is_at_bounds(estimator.filter)


@compiled
def _predict_ahead(
    buffer: RecordArray[EstimatorState],
    acts_ns: NDArray[np.int64],
    commands: Array,
    begin_ns: int,
    end_ns: int,
    sent: Array,
    prediction: RecordArray[Prediction],
) -> None:
    """Write the prediction for ``end_ns`` from the state measured at ``begin_ns``.

    ``sent`` (4,) is the last command.
    """
    estimator, predicted = buffer[()], prediction[()]
    estimate, x = estimator.filter, estimator.filter.translation.x
    predicted.state = estimator.measured
    predicted.state.throttle = x[MOTION.throttle]
    if estimate.enabled:
        kernels.store_vector(
            kernels.vector(x[MOTION.position : MOTION.velocity]), predicted.state.p_WB
        )
        kernels.store_vector(
            kernels.vector(x[MOTION.velocity : MOTION.disturbance]), predicted.state.v_WB_W
        )
    write_estimated(estimate)
    predicted.parameters = estimate.estimated
    if end_ns > begin_ns:
        acting = acting_between(
            acts_ns=acts_ns, commands=commands, start_ns=begin_ns, end_ns=end_ns
        )
        for k in range(len(acting.commands)):
            add_offsets(estimate, acting.commands[k])
        roll_forward(
            predicted.parameters,
            commands=acting.commands,
            durations=acting.durations,
            start=predicted.state,
            end=predicted.state,
        )
    predicted.rate_weight_scale = rate_weight_scale(estimate)
    predicted.sent[:] = sent
    add_offsets(estimate, predicted.sent)
