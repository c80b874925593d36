"""The estimate stage: the ground state, and the state in which a command will act."""

from __future__ import annotations

import time
from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.arrival_stamps import ArrivalStamps
from quad_mpc_ros.control.estimation.clock_offset import Lateness
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation, EstimateStatus
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.stage import Due, Failure, Stage
from quad_mpc_ros.control.stage_log import StageLog

_RESET = (
    "the estimate of thrust, wind and lags did not fit the vehicle and was reset: check mass, "
    "thrust_curve and lags, and whether the odometry jumps"
)


class Estimate(NamedTuple):
    """The state in which a command sent now will act, and the start of its estimation [s].

    ``started`` is by :func:`time.perf_counter`.
    """

    state: PredictedState
    started: float


class EstimateStage(Stage):
    """Owns the estimators.

    Attributes:
        ground: The ground detector.
    """

    def __init__(self, config: MpcConfig, log: StageLog) -> None:
        self._log = log
        self._in_lockstep = config.lockstep
        self._vehicle = config.vehicle()
        self._lateness = Lateness(config)
        self._arrival_stamps = ArrivalStamps()
        self.ground = GroundDetector(config.gravity)
        self._estimator = DelayCompensation(config, ground=self.ground)
        self._has_failed = False
        # Answer of the last odometry, by the clock of the stamps and that of the arrivals.
        self._answered_ns: tuple[int, int] | None = None
        self._resets_reported = 0

    @property
    def stages(self) -> tuple[Stage, ...]:
        """This stage, clocks, ground detector and estimator."""
        return self, self._lateness, self._arrival_stamps, self.ground, self._estimator

    @property
    def status(self) -> EstimateStatus:
        """Status of the estimate after the last step."""
        return self._estimator.status

    def parameters(self) -> ModelParameters:
        """Return the estimated parameters of the vehicle."""
        return self._estimator.estimated()

    def angular_acceleration(self) -> tuple[float, float, float]:
        """Return the estimated angular acceleration at the last odometry [rad/s^2]."""
        return self._estimator.angular_acceleration()

    def answer_ns(self, stamp_ns: int, *, now_ns: int) -> int:
        """Take the arrival of an odometry; return when its answer is sent, by its clock."""
        sent_ns = stamp_ns + self._lateness.of(stamp_ns, now_ns=now_ns)
        self._answered_ns = sent_ns, now_ns
        return sent_ns

    def elapsed_ns(self, *, now_ns: int) -> int:
        """Return the time by the clock of the odometry's stamps."""
        sent_ns, then_ns = self._answered_ns or (now_ns, now_ns)
        return sent_ns + now_ns - then_ns

    def take_imu(self, sample: ImuSample) -> None:
        """Buffer an accelerometer sample for the next odometry."""
        self._estimator.add_imu(sample)

    def step(
        self,
        due: Due,
        *,
        acting: Input | None,
        reference: ReferenceWindow | None,
        idle_wanted: bool,
    ) -> Estimate | Failure:
        """Update the estimators by an odometry, and predict the state in which a command acts.

        Args:
            due: The control step. Without odometry nothing is learned.
            acting: The active command, None before the first.
            reference: The newest reference, None without one.
            idle_wanted: Whether the reference requests idle motors.
        """
        odometry = due.odometry
        if odometry is not None:
            self._update_ground(odometry, acting, reference, idle_wanted)
            if not self._in_lockstep:
                odometry = self._arrival_stamps.corrected(odometry, now_ns=due.now_ns)
        started = time.perf_counter()
        try:
            state = self._predicted(odometry, due.sent_ns)
        except Exception as error:
            return self._fail(error)
        if state is None:
            return Failure("estimate", "not run without odometry")
        return Estimate(state, started)

    def _predicted(self, odometry: OdometrySample | None, sent_ns: int) -> PredictedState | None:
        if odometry is None:
            return self._estimator.predict_without_odometry(sent_ns)
        state = self._estimator.predict(odometry, late_ns=sent_ns - odometry.stamp_ns)
        self._has_failed = False
        return state

    def _fail(self, error: Exception) -> Failure:
        """Replace an estimator that fails twice in a row, as its estimate may be the cause."""
        if self._has_failed:
            self._estimator = self._estimator.fresh_copy()
        self._has_failed = not self._has_failed
        return self._log.stage_error("estimator", error)

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

    def record(self, command: Input, *, stamp_ns: int) -> None:
        """Record a command and when it is sent, by the clock of the odometry's stamps."""
        self._estimator.record(command, stamp_ns=stamp_ns)

    def transform_estimate(self, reset: EstimateReset) -> None:
        """Transform the estimate after an accepted jump of the odometry."""
        self._estimator.reset_estimate(reset)

    def report(self) -> None:
        """Warn of a reset of the estimate since the last call."""
        resets = self._estimator.status.resets
        if resets > self._resets_reported:
            self._log.warn(_RESET)
        self._resets_reported = resets
