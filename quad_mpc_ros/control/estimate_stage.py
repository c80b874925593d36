# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The estimate stage: the ground state, and the state in which a command will act."""

from __future__ import annotations

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.arrival_stamps import ArrivalStamps
from quad_mpc_ros.control.estimation.clock_offset import Lateness
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.stage import Due, Failure, Stage, StageLog

_RESET = (
    "the estimate of thrust, wind and lags did not fit the vehicle and was reset: check mass, "
    "thrust_curve and lags, and whether the odometry jumps"
)
_NO_ODOMETRY = Failure("estimate", "skipped without odometry")


class EstimateStage(Stage):
    """Owns the estimators.

    Attributes:
        ground: The ground detector.
        estimator: The estimator of state and parameters; replaced after repeated errors.
    """

    def __init__(self, config: MpcConfig, log: StageLog) -> None:
        self._log = log
        self._in_lockstep = config.lockstep
        self._vehicle = config.vehicle()
        self.lateness = Lateness(config)
        self._arrival_stamps = ArrivalStamps()
        self.ground = GroundDetector(config.gravity)
        self.estimator = DelayCompensation(config, ground=self.ground)
        self._has_failed = False
        self._resets_reported = 0

    def step(
        self,
        due: Due,
        *,
        acting: Input | None,
        reference: ReferenceWindow | None,
        idle_wanted: bool,
        may_predict: bool,
    ) -> PredictedState | Failure:
        """Update the estimators by an odometry, and predict the state in which a command acts.

        Args:
            due: The control step. Without odometry nothing is estimated.
            acting: The active command, None before the first command.
            reference: The newest reference, None without a reference.
            idle_wanted: Whether the reference requests idle motors.
            may_predict: Whether to predict in a step without odometry.
        """
        odometry = due.odometry
        if odometry is None and not may_predict:
            return _NO_ODOMETRY
        if odometry is not None:
            self._update_ground(odometry, acting, reference, idle_wanted)
            if not self._in_lockstep:
                odometry = self._arrival_stamps.corrected(odometry, now_ns=due.now_ns)
        try:
            if odometry is None:
                return self.estimator.predict_without_odometry(due.sent_ns) or _NO_ODOMETRY
            late_ns = due.sent_ns - odometry.stamp_ns
            state = self.estimator.predict(odometry, late_ns=late_ns)
        except Exception as error:
            return self._fail(error)
        self._has_failed = False
        return state

    def _fail(self, error: Exception) -> Failure:
        """Replace an estimator that fails twice in a row, as its estimate may be the cause."""
        if self._has_failed:
            self.estimator = self.estimator.fresh_copy()
        self._has_failed = not self._has_failed
        return self._log.stage_error("estimator", error)

    def record(self, command: Input, *, stamp_ns: int) -> None:
        """Record a command and when it is sent, by the clock of the odometry's stamps."""
        try:
            self.estimator.record(command, stamp_ns=stamp_ns)
        except Exception as error:
            self._log.stage_error("record of commands", error)

    def _update_ground(
        self,
        odometry: OdometrySample,
        acting: Input | None,
        reference: ReferenceWindow | None,
        idle_wanted: bool,
    ) -> None:
        try:
            self.ground.idle_wanted = idle_wanted
            if acting is None:  # another controller may fly the vehicle
                return
            weight = self._vehicle.mass * self._vehicle.gravity
            thrust = self._vehicle.thrust(acting.throttle) / weight
            self.ground.update(odometry, thrust=thrust, window=reference)
        except Exception as error:
            self._log.stage_error("ground detector", error)

    def report(self) -> None:
        """Warn of a reset of the estimate since the last call."""
        resets = self.estimator.status.resets
        if resets > self._resets_reported:
            self._log.warn(_RESET)
        self._resets_reported = resets
