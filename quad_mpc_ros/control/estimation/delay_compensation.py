"""Delay compensation: from an odometry to the state in which the next command will act.

A command sent now acts after the delay of the input. The state is rolled forward over that time
through the commands already sent, with the parameters that the EKF estimates, which follows the
vehicle from odometry to odometry.

All that is known of the vehicle is in one record, and a tick makes two calls into compiled code:
one from the previous odometry to this one, one from this to the state in which the command acts.
The conditions of the update are judged before the first, its outcome between the two.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.command_history import CommandHistory, acting_between
from quad_mpc_ros.control.estimation.ekf import EkfMemory, VehicleEkf, update
from quad_mpc_ros.control.estimation.error_state import MOTION
from quad_mpc_ros.control.estimation.estimate_health import EstimateHealth
from quad_mpc_ros.control.estimation.filter_state import Filter, is_at_bounds, write_estimated
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import Learning
from quad_mpc_ros.control.estimation.rate_update import add_offsets
from quad_mpc_ros.control.estimation.specific_force import SpecificForces
from quad_mpc_ros.control.estimation.update_mode import (
    LONGEST_GAP_NS,
    MODE_TEXTS,
    Conditions,
    UpdateMode,
)
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import ModelParameters, parameters_of
from quad_mpc_ros.control.model.prediction import PredictedState, Prediction
from quad_mpc_ros.control.model.rollout import (
    LONGEST_SUBSTEP,
    StateRecord,
    read_odometry,
    roll_forward,
)
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample
from quad_mpc_ros.control.model.state import BODY_RATE, U_THROTTLE, Input
from quad_mpc_ros.control.stage import Stage

# How long commands must have acted before something is learned, once they had not acted: the
# actuators are still on their way from where something else had them.
_SETTLING_NS = 300_000_000
# A landing is known only some time after the touchdown, and what was learned in between is wrong.
# So the estimate that is kept is the oldest of so many, one a second.
_MEMORY_NS, _MEMORIES = 1_000_000_000, 5


class EstimatorState(Record):
    """What is known of the vehicle."""

    # Its states at an odometry and at the one before as measured, but for their throttle.
    measured: StateRecord
    before: StateRecord
    filter: Filter


class EstimateStatus(NamedTuple):
    """Status of the estimate: the update mode, or ``at bounds`` or ``reset``.

    ``resets`` is how often it was reset so far, ``accelerometer`` what became of what it measured.
    """

    text: str = MODE_TEXTS[UpdateMode.HOLD]
    resets: int = 0
    accelerometer: str = "off"  # or missing, paused, used, refused
    imu_stamp_ns: int = 0  # of the newest measurement of the accelerometer


class DelayCompensation(Stage):
    """Follows the vehicle through the commands sent, and predicts across the input delay."""

    def __init__(self, config: MpcConfig, *, ground: GroundDetector | None = None) -> None:
        """Without ``ground`` the vehicle counts as flying."""
        vehicle = config.vehicle()
        hover = Input(throttle=vehicle.hover_throttle, w_WB_B=np.zeros(3))
        self._delay_ns = round(config.input_delay * 1e9)
        self._rate_gain = np.array(per_axis(config.rate_gain))
        self._history = CommandHistory(delay_ns=self._delay_ns, initial=hover.vector())
        self._learns = config.estimate_disturbance
        # Without a lag the throttle is the command: nothing of it is to be followed.
        self._follows = self._learns or config.thrust_time_constant > 0.0
        self._buffer = EstimatorState.zeros()
        self._followed = followed = self._buffer[()]
        nominal = parameters_of(
            vehicle,
            rate_time_constant=config.rate_time_constant,
            thrust_time_constant=config.thrust_time_constant,
        )
        self._ekf = VehicleEkf(
            nominal[()],
            throttle=hover.throttle,
            delay=config.input_delay,
            enabled=self._learns,
            uses_accelerometer=config.uses_accelerometer,
            state=followed.filter,
        )
        self._force_variance = config.accelerometer_noise**2 if config.uses_accelerometer else 0.0
        self._specific_forces = SpecificForces()
        self._ground = ground
        self._health = EstimateHealth()
        self.status = EstimateStatus()
        self._memories: deque[tuple[int, EkfMemory]] = deque(maxlen=_MEMORIES)
        self._sent = hover.vector()
        self._sent_ns: int | None = None
        self._engaged, self._was_idle = True, False
        # Stamp of the last odometry, if what has acted since is known.
        self._previous_ns: int | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed bounds."""
        self._config = config
        self._ekf.reconfigure(
            throttle_min=config.throttle_min,
            throttle_max=config.throttle_max,
            disturbance_max=config.disturbance_max,
        )

    def renewed(self) -> DelayCompensation:
        """Return one like this that knows the engagement and nothing else."""
        fresh = DelayCompensation(self._config, ground=self._ground)
        fresh.engage(self._engaged)
        return fresh

    def estimated(self) -> ModelParameters:
        """Return the parameters of the vehicle as estimated by now."""
        return self._ekf.parameters()

    def record(self, command: Input, *, stamp_ns: int) -> None:
        """Remember a command by when it is sent, on the clock of the odometry's stamps."""
        # What the rates follow, but for their offsets: the model has no gain of its own.
        self._sent[U_THROTTLE], self._sent_ns = command.throttle, stamp_ns
        self._sent[BODY_RATE] = self._rate_gain * command.w_WB_B
        self._history.record(self._sent, stamp_ns=stamp_ns)

    def add_imu(self, sample: ImuSample) -> None:
        """Take what an accelerometer measured, for the next odometry."""
        self._specific_forces.add(sample)

    def engage(self, engaged: bool) -> None:
        """Set whether commands act on the vehicle; at the start they do.

        While they do not, nothing is learned, and the estimate of some seconds before the last of
        them counts. What is sent in that time is remembered, for this call may be late.
        """
        if engaged and not self._engaged:
            self._history.forget()
            self._previous_ns = None
            self._was_idle = True
        elif self._engaged and not engaged:
            # Who disarms may have landed just before, and what came last was of the ground.
            self._recall()
        self._engaged = engaged

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Move what is remembered of odometries, and what was learned in the world."""
        self._ekf.turn(reset)
        self._memories.clear()  # of the former directions
        if self._previous_ns is not None and self._previous_ns < reset.stamp_ns:
            state = self._followed.measured
            state.p_WB[:] = reset.points(state.p_WB)
            state.v_WB_W[:] = reset.vectors(state.v_WB_W)
            state.R_WB[:] = reset.vectors(state.R_WB.T).T

    def predict(self, odometry: OdometrySample, *, late_ns: int = 0) -> PredictedState:
        """Return the state in which a command sent now will begin to act.

        It is that of the odometry rolled forward over the delay of the input, and over what the
        odometry came later than usual.
        """
        stamp_ns, previous_ns = odometry.stamp_ns, self._previous_ns
        # Not across a long silence, nor from a clock to one that was set.
        if previous_ns is None or not 0 <= stamp_ns - previous_ns <= LONGEST_GAP_NS:
            self._see(odometry)
            measured = self._followed.measured
            self._ekf.start(p_WB=measured.p_WB, v_WB_W=measured.v_WB_W, w_WB_B=measured.w_WB_B)
            self.status = EstimateStatus(resets=self._health.resets)
            if self._force_variance > 0.0:
                self._take_specific_force(stamp_ns, stamp_ns)
        elif self._follows:
            self._go_on(odometry, previous_ns)
        else:
            self._see(odometry)
        self._previous_ns = stamp_ns
        return self._predicted(stamp_ns + late_ns, begin_ns=stamp_ns)

    def foresee(self, stamp_ns: int) -> PredictedState | None:
        """Return the same of a time after the last odometry, None where none is known.

        Nothing is learned.
        """
        if self._previous_ns is None or stamp_ns < self._previous_ns:
            return None
        return self._predicted(stamp_ns, begin_ns=self._previous_ns)

    def _predicted(self, stamp_ns: int, *, begin_ns: int) -> PredictedState:
        """Roll the measured state forward from its time until a command sent at a stamp acts."""
        prediction = Prediction.zeros()
        since_sent = math.inf
        if self._sent_ns is not None and stamp_ns >= self._sent_ns:
            since_sent = (stamp_ns - self._sent_ns) * 1e-9
        _ahead(
            buffer=self._buffer,
            acts_ns=self._history.acts_ns,
            commands=self._history.commands,
            begin_ns=begin_ns,
            end_ns=stamp_ns + self._delay_ns,
            sent=self._sent,
            since_sent=since_sent,
            prediction=prediction,
        )
        return PredictedState(stamp_ns + self._delay_ns, prediction)

    def _see(self, odometry: OdometrySample) -> None:
        """Take an odometry, whatever was before."""
        _read(
            buffer=self._buffer,
            p_WB=odometry.p_WB,
            q_WB_xyzw=odometry.q_WB_xyzw,
            v_WB_B=odometry.v_WB_B,
            w_WB_B=odometry.w_WB_B,
        )

    def _go_on(self, odometry: OdometrySample, previous_ns: int) -> None:
        """Take an odometry, and bring the EKF from the one before to it."""
        stamp_ns = odometry.stamp_ns
        measures = self._force_variance > 0.0
        is_measured = measures and self._take_specific_force(previous_ns, stamp_ns)
        mode, at_bounds = _follow(
            buffer=self._buffer,
            p_WB=odometry.p_WB,
            q_WB_xyzw=odometry.q_WB_xyzw,
            v_WB_B=odometry.v_WB_B,
            w_WB_B=odometry.w_WB_B,
            v_variance=odometry.v_variance,
            acts_ns=self._history.acts_ns,
            commands=self._history.commands,
            stamps_ns=(previous_ns, stamp_ns),
            conditions=self._conditions(previous_ns),
        )
        self._judge(mode, at_bounds, stamp_ns, duration=1e-9 * (stamp_ns - previous_ns))
        if measures:
            self.status = self.status._replace(
                accelerometer=self._accelerometer_use(mode, is_measured),
                imu_stamp_ns=self._specific_forces.newest_ns,
            )

    def _take_specific_force(self, previous_ns: int, stamp_ns: int) -> bool:
        """Give the filter the specific force since the last odometry; return whether it exists."""
        mean = self._specific_forces.mean(start_ns=previous_ns, end_ns=stamp_ns)
        force = self._followed.filter.specific_force
        force.variance = 0.0 if mean is None else self._force_variance
        if mean is not None:
            force.f_B[:] = mean
        return mean is not None

    def _accelerometer_use(self, mode: int, is_measured: bool) -> str:
        if not is_measured:
            return "missing"
        if self._followed.filter.specific_force.used:
            return "used"
        return "refused" if mode in (UpdateMode.LEARN, UpdateMode.REJECT) else "paused"

    def _judge(self, mode: int, at_bounds: bool, stamp_ns: int, *, duration: float) -> None:
        """Note what an odometry did to the estimate; reset one that fails for long."""
        text = MODE_TEXTS[mode]
        if mode in (UpdateMode.LEARN, UpdateMode.REJECT):
            refused = mode == UpdateMode.REJECT
            if at_bounds and not refused:
                text = "at bounds"
            if self._health.fails(
                stamp_ns, duration=duration, refused=refused, at_bounds=at_bounds
            ):
                self._ekf.start_over()
                self._memories.clear()
            if self._health.was_reset(stamp_ns):
                text = "reset"
        self.status = EstimateStatus(text, self._health.resets)

    def _conditions(self, previous_ns: int) -> Conditions:
        """Return the conditions of an update since the odometry before."""
        learning = Learning.LEARN
        if self._ground is not None and self._learns and self._engaged:
            learning = self._ground.learning
            if self._ground.state.stands:
                self._recall()
        flies, may_touch = learning is not Learning.HOLD, learning is Learning.PAUSE
        # Before that what acted is not known, or has not acted for long enough.
        known = self._history.knows(previous_ns - (_SETTLING_NS if self._was_idle else 0))
        acts = self._learns and self._engaged and known
        if acts and learning is Learning.LEARN:
            self._remember(previous_ns)
        return Conditions(acts, flies, may_touch)

    def _remember(self, now_ns: int) -> None:
        """Keep the estimate, once a second."""
        if self._memories and 0 <= now_ns - self._memories[-1][0] < _MEMORY_NS:
            return
        self._memories.append((now_ns, self._ekf.memory()))

    def _recall(self) -> None:
        """Return to the estimate of some seconds ago, in flight."""
        if self._memories:
            self._ekf.recall(self._memories[0][1])
            self._memories.clear()


@compiled
def _read(
    buffer: RecordArray[EstimatorState],
    p_WB: Array,
    q_WB_xyzw: Array,
    v_WB_B: Array,
    w_WB_B: Array,
) -> None:
    """Read an odometry."""
    followed = buffer[()]
    followed.before = followed.measured
    read_odometry(
        p_WB=p_WB,
        q_WB_xyzw=q_WB_xyzw,
        v_WB_B=v_WB_B,
        w_WB_B=w_WB_B,
        state=followed.measured,
    )


@compiled
def _follow(
    buffer: RecordArray[EstimatorState],
    p_WB: Array,
    q_WB_xyzw: Array,
    v_WB_B: Array,
    w_WB_B: Array,
    v_variance: float,
    acts_ns: NDArray[np.int64],
    commands: Array,
    stamps_ns: tuple[int, int],
    conditions: Conditions,
) -> tuple[int, bool]:
    """Go on to an odometry from the one before, under what acted of a history between the two.

    Returns:
        The update mode, and whether the estimate is as far as it may go.
    """
    start_ns, end_ns = stamps_ns
    _read(buffer=buffer, p_WB=p_WB, q_WB_xyzw=q_WB_xyzw, v_WB_B=v_WB_B, w_WB_B=w_WB_B)
    followed = buffer[()]
    mode = update(
        state=followed.filter,
        before=followed.before,
        after=followed.measured,
        acting=acting_between(
            acts_ns=acts_ns, commands=commands, start_ns=start_ns, end_ns=end_ns
        ),
        conditions=conditions,
        given_variance=v_variance,
    )
    return mode.value, is_at_bounds(followed.filter)


@compiled
def _ahead(
    buffer: RecordArray[EstimatorState],
    acts_ns: NDArray[np.int64],
    commands: Array,
    begin_ns: int,
    end_ns: int,
    sent: Array,
    since_sent: float,
    prediction: RecordArray[Prediction],
) -> None:
    """Write the prediction of the time ``end_ns`` from the state measured at ``begin_ns``.

    ``sent`` (4,) is what was commanded last, ``since_sent`` [s] ago.
    """
    followed, predicted = buffer[()], prediction[()]
    known, x = followed.filter, followed.filter.translation.x
    predicted.state = followed.measured
    predicted.state.throttle = x[MOTION.throttle]
    if known.enabled:
        kernels.store_vector(
            kernels.vector(x[MOTION.position : MOTION.velocity]), predicted.state.p_WB
        )
        kernels.store_vector(
            kernels.vector(x[MOTION.velocity : MOTION.disturbance]), predicted.state.v_WB_W
        )
    write_estimated(known, predicted.parameters)
    if end_ns > begin_ns:
        acting = acting_between(
            acts_ns=acts_ns, commands=commands, start_ns=begin_ns, end_ns=end_ns
        )
        for k in range(len(acting.commands)):
            add_offsets(known, acting.commands[k])
        roll_forward(
            predicted.parameters,
            commands=acting.commands,
            durations=acting.durations,
            longest=LONGEST_SUBSTEP,
            start=predicted.state,
            end=predicted.state,
        )
    predicted.sent[:] = sent
    add_offsets(known, predicted.sent)
    predicted.since_sent = since_sent
