# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller of the node and the simulation: inputs in, at most one command out.

An odometry that is due triggers the control step: validate, estimate, guide, plan, decide, limit,
record. The controller uses neither ROS nor a wall clock; ``now_ns`` is an argument.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from quad_mpc_ros.configuration.arguments import instance, number
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimate_stage import EstimateStage
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.guide import Guide, GuideStage
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
    RotorCommand,
)
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.mpc import Mpc, NewPlanner, Planned
from quad_mpc_ros.control.safety.decide_stage import Decided, DecideStage
from quad_mpc_ros.control.safety.input_monitor import InputMonitor
from quad_mpc_ros.control.safety.limit_stage import LimitStage
from quad_mpc_ros.control.stage import Due, Stage, StageLog
from quad_mpc_ros.control.tick import Tick

_SECOND = 1_000_000_000
_CLOCK_SET_PERIODS = 3  # an odometry so many periods from its due time means a clock was set


class Controller:
    """MPC with fallbacks and limits around it.

    Odometry triggers the ticks. At each step the MPC minimises, over the inputs u_i = (throttle,
    body rates) of the horizon and subject to the linearised model and the bounds on the inputs,

        sum_i x_i' Q x_i + u_i' R u_i,

    where x_i and u_i are the errors to the reference on the manifold R^6 x SO(3), and returns the
    first input. Sent commands are recorded; if another command was executed, call
    :meth:`replace_last_command`.

    In lockstep an odometry waits for the reference of its stamp, and a repeated odometry gets an
    identical command, so that lost messages can be sent again.

    Args:
        config: Parameters; :meth:`reconfigure` changes live parameters.
        deadline: Longest time for a plan [s]; later plans are dropped.
        guide: Guide for obstacles or gates, None without a guide.
        planner: Stage that replaces the MPC, for another controller.

    The constructor, :meth:`step` and :meth:`replace_last_command` raise :class:`.ArgumentError`, a
    ``ValueError``, for an argument of a wrong type; other methods check no types. Unusable
    odometry and references are ignored: :meth:`take_warnings` returns the reason, and the last
    valid inputs stay in use.

    Example:
        >>> controller = Controller(MpcConfig())
        >>> odometry = OdometrySample.at_rest([0.0, 0.0, 1.0])
        >>> tick = controller.step(odometry, ReferenceWindow.hover([0.0, 0.0, 2.0]))
        >>> tick.command.throttle > MpcConfig().vehicle().hover_throttle
        True
    """

    def __init__(
        self,
        config: MpcConfig,
        *,
        deadline: float = math.inf,
        guide: Guide | None = None,
        planner: NewPlanner = Mpc,
    ) -> None:
        self._config = instance(config, "config", MpcConfig)
        endless = isinstance(deadline, float) and deadline == math.inf
        self._deadline = math.inf if endless else number(deadline, "deadline", above=0.0)
        self._engaged = True
        self._log = log = StageLog()
        self._inputs = InputMonitor(config, log)
        self._estimation = EstimateStage(config, log)
        self._guidance = GuideStage(config, guide, log)
        self._planner, self._planning = planner, planner(config, self._deadline, log)
        self._deciding = DecideStage(config, self._inputs, self._estimation.ground, log)
        self._limiting = LimitStage(config, self._inputs, self._estimation, self._deciding, log)
        self._period_ns = round(_SECOND / config.control_rate)
        self._decimation = Decimation(self._period_ns)
        self._last_tick: Tick | None = None
        self._sent_ns = 0  # of the last command, by the clock of the odometry

    @property
    def config(self) -> MpcConfig:
        """The active configuration."""
        return self._config

    @property
    def ground_state(self) -> GroundState:
        """Whether the vehicle is on the ground or flies, at the last odometry."""
        return self._estimation.ground.state

    @property
    def commands_rotors(self) -> bool:
        """Whether commands are for rotors (:class:`.RotorCommand`)."""
        return self._planning.commands_rotors

    def fresh_copy(self) -> Controller:
        """Return a new controller with the same configuration, deadline and guide."""
        guide, planner = self._guidance.guide, self._planner
        return Controller(self._config, deadline=self._deadline, guide=guide, planner=planner)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All owners of flight state, in the order of the control step."""
        owners = [each for each in vars(self).values() if isinstance(each, Stage)]
        return tuple(dict.fromkeys(stage for owner in owners for stage in owner.stages))

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed live parameters between two ticks; the warm start is kept."""
        self._config = config
        self._to_all(lambda stage: stage.reconfigure(config))

    def engage(self, engaged: bool) -> None:
        """Set whether the vehicle executes commands: armed, and in offboard mode."""
        if engaged == self._engaged:
            return
        self._engaged = engaged
        self._to_all(lambda stage: stage.engage(engaged))

    def landed(self, landed: bool | None) -> None:
        """Set whether the flight stack reports the vehicle landed; None without a report."""
        self._estimation.ground.landed = landed

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Apply an announced odometry jump: the vehicle stays, its coordinates change.

        Held positions and the current reference are transformed. Call this before the first
        odometry in the new coordinates.
        """
        self._to_all(lambda stage: stage.reset_estimate(reset))

    def _to_all(self, event: Callable[[Stage], None]) -> None:
        """Pass an event to every stage, even if one of them raises."""
        for stage in self.stages:
            try:
                event(stage)
            except Exception as error:
                self._log.stage_error(type(stage).__name__, error)

    def take_warnings(self) -> list[str]:
        """Return the warnings for the log since the last call."""
        self._inputs.report()
        self._estimation.report()
        return self._log.take_warnings()

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> Tick | None:
        """Run a control step, as if odometry and reference arrived at the odometry's stamp.

        Args:
            odometry: State of the vehicle, in ENU and FLU.
            reference: Reference window that covers the stamp.

        Returns:
            The tick; its ``command`` is None if the safety ladder sends nothing. None without a
            tick: the odometry is unusable (:meth:`take_warnings` returns the reason), or not yet
            due at ``control_rate``.
        """
        instance(reference, "reference", ReferenceWindow)
        now_ns = instance(odometry, "odometry", OdometrySample).stamp_ns
        answered = self.receive_reference(reference, now_ns=now_ns)
        return self.receive_odometry(odometry, now_ns=now_ns) or answered

    def check_stamps(self, wanted: bool) -> None:
        """Set whether stamps are compared with arrivals; disable for recorded odometry."""
        self._inputs.gate.checks_stamps = wanted

    def receive_odometry(self, odometry: OdometrySample, *, now_ns: int) -> Tick | None:
        """Take an odometry, which may trigger a tick.

        Args:
            odometry: The state of the vehicle.
            now_ns: Time of arrival [ns], by any steady clock; ignored in lockstep.

        Returns:
            The tick with the command to send; None if the odometry is rejected or not due.
        """
        now_ns = odometry.stamp_ns if self._config.lockstep else now_ns
        accepted = self._inputs.accept_odometry(odometry, now_ns=now_ns)
        if accepted is None:
            return None
        while self._inputs.jumps.resets:
            self._estimation.estimator.reset_estimate(self._inputs.jumps.resets.pop(0))
        if self._config.lockstep:
            return self._last_tick if self._is_answered() else self._answer_in_lockstep()
        if not self._decimation.is_due(accepted.stamp_ns):
            return None
        return self._control(accepted, held_ns=self._period_ns, now_ns=now_ns)

    def receive_reference(self, window: ReferenceWindow, *, now_ns: int) -> Tick | None:
        """Take a reference window.

        Args:
            window: Samples that cover the stamps of the next odometries.
            now_ns: Time of arrival [ns], by the clock of :meth:`receive_odometry`.

        Returns:
            In lockstep the tick of the odometry that waited for this window, otherwise None.
        """
        now_ns = window.stamp_ns if self._config.lockstep else now_ns
        if not self._inputs.accept_reference(window, now_ns=now_ns):
            return None
        if self._config.lockstep and not self._is_answered():
            return self._answer_in_lockstep()
        return None

    def receive_imu(self, sample: ImuSample) -> Tick | None:
        """Take an accelerometer sample for the next odometry; ignored without a noise.

        Args:
            sample: The specific force, stamped by the clock of the odometry.

        Returns:
            In lockstep the tick of the odometry that waited for the sample, otherwise None.
        """
        if not self._config.uses_accelerometer or not self._inputs.accept_imu(sample):
            return None
        self._estimation.estimator.specific_forces.add(sample)
        if self._config.lockstep and not self._is_answered():
            return self._answer_in_lockstep()
        return None

    def watch(self, *, now_ns: int) -> Tick | None:
        """Run a control step if odometry is lost; call this every control period.

        The timer may pause for :meth:`seconds_until_odometry_lost`.

        Args:
            now_ns: The time [ns], by the clock of :meth:`receive_odometry`.

        Returns:
            A tick if the odometry is older than its timeout, otherwise None.
        """
        lost = self._limiting.acting is not None and self._inputs.is_odometry_lost(now_ns=now_ns)
        if self._config.lockstep or not lost:
            return None
        return self._control(None, held_ns=self._period_ns, now_ns=now_ns)

    def seconds_until_odometry_lost(self, *, now_ns: int) -> float:
        """Return the time for which :meth:`watch` certainly does nothing [s]."""
        return self._inputs.seconds_until_odometry_lost(now_ns=now_ns)

    def replace_last_command(self, command: CommandSample, *, now_ns: int) -> None:
        """Record that this command was sent instead of the last tick's command."""
        command = instance(command, "command", CommandSample).checked()
        u = Input(throttle=command.throttle, w_WB_B=command.w_WB_B)
        self._limiting.replace(u, now_ns=now_ns)
        tick = self._last_tick
        replaces = tick is not None and tick.stamp_ns == command.stamp_ns
        sent_ns = self._sent_ns if replaces else command.stamp_ns
        self._estimation.record(u, stamp_ns=sent_ns)

    def _is_answered(self) -> bool:
        """Whether the last tick belongs to the newest odometry."""
        odometry, tick = self._inputs.odometry, self._last_tick
        return odometry is not None and tick is not None and tick.stamp_ns == odometry.stamp_ns

    def _answer_in_lockstep(self) -> Tick | None:
        """Run the control step of the newest odometry if its reference has arrived."""
        odometry, window = self._inputs.odometry, self._inputs.reference
        if odometry is None or window is None or window.stamp_ns != odometry.stamp_ns:
            return None
        if self._awaits_imu(odometry.stamp_ns):
            return None
        held_ns = self._period_ns
        if self._last_tick is not None:  # each odometry is answered, at any rate
            held_ns = min(odometry.stamp_ns - self._last_tick.stamp_ns, held_ns)
        return self._control(odometry, held_ns=held_ns, now_ns=odometry.stamp_ns)

    def _awaits_imu(self, stamp_ns: int) -> bool:
        """Whether an odometry in lockstep, except the first, waits for its IMU sample."""
        if not self._config.uses_accelerometer or self._last_tick is None:
            return False
        imu_ns = self._inputs.imu_stamp_ns
        return imu_ns is None or imu_ns < stamp_ns

    def _control(self, odometry: OdometrySample | None, *, held_ns: int, now_ns: int) -> Tick:
        """Run a control step: validate, estimate, guide, plan, decide, limit, record.

        The command is expected to act for ``held_ns``.
        """
        inputs, acting = self._inputs, self._limiting.acting
        lateness, stamp_ns = self._estimation.lateness, now_ns
        if odometry is not None:
            stamp_ns = odometry.stamp_ns
            lateness.arrive(stamp_ns, now_ns=now_ns)
        due = Due(
            odometry,
            stamp_ns=stamp_ns,
            sent_ns=lateness.sent_ns(now_ns),
            now_ns=now_ns,
            duration=held_ns * 1e-9,
            started=time.perf_counter(),
        )
        reference = inputs.reference_at(due.sent_ns, now_ns=due.now_ns)
        state = self._estimation.step(
            due,
            acting=acting,
            reference=inputs.reference,
            idle_wanted=inputs.idle_wanted,
            may_predict=due.odometry is None
            and self._deciding.may_predict_without_odometry(now_ns=due.now_ns),
        )
        guided = self._guidance.step(due, state, reference)
        planned = self._planning.step(due, state, guided)
        decided = self._deciding.step(due, planned, flown=self._guidance.window, acting=acting)
        command = self._limiting.step(due, decided, corridor=self._guidance.corridor)
        return self._record(due, planned, decided, command)

    def _record(self, due: Due, planned: Planned, decided: Decided, u: Input | None) -> Tick:
        """Pass command and plan to the stages that record them, and return the tick."""
        inputs, estimation, guidance = self._inputs, self._estimation, self._guidance
        command, odometry, now_ns = None, inputs.odometry, due.now_ns
        if u is not None:
            self._sent_ns = due.sent_ns
            estimation.record(u, stamp_ns=due.sent_ns)
            command = CommandSample(stamp_ns=due.stamp_ns, throttle=u.throttle, w_WB_B=u.w_WB_B)
            plan = decided.plan
            rotors = None if plan is None else plan.rotor_throttles
            # Only if no limit has changed the expected motion.
            if plan and rotors is not None and np.array_equal(u.vector(), plan.inputs[0]):
                command = RotorCommand(**vars(command), rotor_throttles=rotors)
        guidance.record(decided.plan, sent_ns=due.sent_ns)
        self._last_tick = Tick(
            command=command,
            decision=decided.decision,
            stamp_ns=due.stamp_ns,
            plan=decided.plan,
            guided=guidance.guided,
            behind=guidance.delayed.behind,
            step=planned.step,
            counts=dict(self._log.counts),
            ages_ns=(
                0 if odometry is None else now_ns - odometry.stamp_ns,
                now_ns - (inputs.reference_ns or 0),
            ),
            reference_stamp_ns=0 if inputs.reference is None else inputs.reference.stamp_ns,
            ground=estimation.ground.state,
            estimate=estimation.estimator.status,
        )
        return self._last_tick


class Decimation:
    """Selects the odometry nearest to each tick of the control rate.

    An odometry may be early by half the distance between odometries, so that jitter at the control
    rate skips no tick.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._due_ns: int | None = None
        self._mean_ns = period_ns  # mean distance between odometries, at most the period
        self._previous_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Take the stamp of an odometry; return whether the odometry triggers a tick."""
        if self._previous_ns is not None and stamp_ns > self._previous_ns:
            distance_ns = min(stamp_ns - self._previous_ns, self._period_ns)
            self._mean_ns += (distance_ns - self._mean_ns) // 4
        self._previous_ns = stamp_ns
        away_ns = _CLOCK_SET_PERIODS * self._period_ns
        if self._due_ns is None or not -away_ns <= stamp_ns - self._due_ns <= away_ns:
            self._due_ns = stamp_ns  # the first odometry, or a clock was set
        if stamp_ns < self._due_ns - self._mean_ns // 2:
            return False
        overdue = stamp_ns > self._due_ns + self._period_ns
        self._due_ns = (stamp_ns if overdue else self._due_ns) + self._period_ns
        return True
