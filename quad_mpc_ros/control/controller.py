"""The controller as the node and the simulation use it: inputs in, at most one command out.

One tick is a page of the paper: take an odometry, see whether it is due, run the MPC (delay
compensation, linearise, update, solve, line search: :meth:`.mpc.Mpc.step`), let the supervisor say
who commands and limit the command. It reads no ROS and no wall clock: ``now_ns`` is given.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration import ArgumentError
from quad_mpc_ros.configuration.arguments import instance, number, stamp
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.delayed_reference import DelayedReference
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.guide import Avoidance, Guide, Guided
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
)
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.mpc import Mpc, MpcStep
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.safety.clock_offset import Lateness
from quad_mpc_ros.control.safety.ladder import Decision
from quad_mpc_ros.control.safety.supervisor import Supervisor
from quad_mpc_ros.control.tick import Tick, figures_of

_SECOND = 1_000_000_000
_NOT_RUN = "not run without odometry"
# An odometry so many periods away from when it is due means that the clock was set.
_PERIODS_AWAY = 3

_RESET = (
    "the estimate of thrust, wind and lags did not fit the vehicle and was reset: check mass, "
    "thrust_curve and lags, and whether the odometry jumps"
)


class _Answered(NamedTuple):
    """When an odometry was answered, by the clock of the stamps and by that of arrivals [ns]."""

    stamp_ns: int
    now_ns: int


class Controller:
    """MPC under a supervisor.

    Odometry triggers the ticks. At each it minimises, over the inputs u_i = (throttle, body
    rates) of the horizon and subject to the linearised model and the bounds on the inputs,

        sum_i x_i' Q x_i + u_i' R u_i,

    where x_i and u_i are the errors to the reference on the manifold R^6 x SO(3), and gives the
    first input. It remembers what was sent; only when something else acted, call
    :meth:`replace_last_command`.

    In lockstep an odometry waits for the reference of its own stamp
    and a repeated odometry gets the same answer again, so that lost messages can be sent again.

    Args:
        config: What to fly and how. Live parameters may change by :meth:`reconfigure`.
        deadline: How long the MPC may take for a plan that is flown [s].
        guide: What leads around obstacles, if anything does.

    Every method raises :class:`.ArgumentError`, a ``ValueError``, for an argument of another type,
    and is then as if it had not been called. What odometry and reference hold is not an error: of
    what cannot be flown :meth:`take_warnings` says why, and the last good one is kept.

    Example:
        >>> controller = Controller(MpcConfig())
        >>> odometry = OdometrySample.at_rest([0.0, 0.0, 1.0])
        >>> tick = controller.step(odometry, ReferenceWindow.hover([0.0, 0.0, 2.0]))
        >>> tick.command.throttle > MpcConfig().vehicle().hover_throttle
        True
    """

    def __init__(
        self, config: MpcConfig, *, deadline: float = math.inf, guide: Guide | None = None
    ) -> None:
        self._config = instance(config, "config", MpcConfig)
        self._guide = guide
        self._plan: Plan | None = None
        self._guided: Guided | None = None
        gives_way = config.formulation == "contouring"
        self._delayed = DelayedReference(config.contouring.behind_max) if gives_way else None
        endless = isinstance(deadline, float) and deadline == math.inf
        self._deadline = math.inf if endless else number(deadline, "deadline", above=0.0)
        self._ground = GroundDetector(config.gravity)
        self._mpc = Mpc(config, ground=self._ground, deadline=self._deadline)
        self._supervisor = Supervisor(config, ground=self._ground, deadline=self._deadline)
        self._period_ns = round(_SECOND / config.control_rate)
        self._decimation = Decimation(self._period_ns)
        self._last_tick: Tick | None = None
        self._answered: _Answered | None = None
        self._lateness = Lateness(most_ns=round(config.odom_timeout * _SECOND))
        self._sent_ns = 0  # when the last command was, on the clock of the odometries
        self._resets_reported = 0

    @property
    def config(self) -> MpcConfig:
        """The configuration in force."""
        return self._config

    @property
    def ground_state(self) -> GroundState:
        """Whether the vehicle stands or flies, by the last odometry."""
        return self._ground.state

    def renewed(self) -> Controller:
        """Return a controller like this one that has seen nothing yet."""
        return Controller(self._config, deadline=self._deadline, guide=self._guide)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed live parameters between two ticks; the warm start stays."""
        self._config = instance(config, "config", MpcConfig)
        self._mpc.reconfigure(config)
        self._supervisor.reconfigure(config)
        if self._guide is not None:
            self._guide.reconfigure(config)
        if self._delayed is not None:
            self._delayed.behind_max = config.contouring.behind_max

    def engage(self, engaged: bool) -> None:
        """Set whether commands act on the vehicle: armed, and in the mode that takes them."""
        instance(engaged, "engaged", bool)
        self._mpc.engage(engaged)
        self._ground.engage(engaged)
        self._supervisor.engage(engaged)

    def landed(self, landed: bool | None) -> None:
        """Set whether the flight stack reports the vehicle landed; None where it does not say."""
        self._ground.tell_landed(instance(landed, "landed", bool, type(None)))

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: the vehicle stays, its coordinates change.

        What is held and the reference move along at once, the reference for as long as no other
        comes. Call it before the first odometry in the new coordinates.
        """
        self._ground.reset_estimate(instance(reset, "reset", EstimateReset))
        self._mpc.reset_estimate(reset)
        self._supervisor.reset_estimate(reset)
        if self._delayed is not None:
            self._delayed.reset_estimate(reset)

    def take_warnings(self) -> list[str]:
        """Return the warnings for the log since the last call."""
        warnings = self._supervisor.take_warnings()
        resets, before = self._mpc.estimate.resets, self._resets_reported
        self._resets_reported = resets
        return [*warnings, _RESET] if resets > before else warnings

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> Tick | None:
        """Answer an odometry, as if it and the reference arrived at the odometry's stamp.

        Args:
            odometry: The vehicle, in ENU and FLU.
            reference: Where it shall be from now on; it has to cover the stamp.

        Returns:
            What came of it. ``command`` is None when the safety ladder says to send nothing.
            Without a tick, None: the odometry is unfit (:meth:`take_warnings` says why), or came
            before it was due at ``control_rate``.
        """
        instance(reference, "reference", ReferenceWindow)
        now_ns = instance(odometry, "odometry", OdometrySample).stamp_ns
        answered = self.receive_reference(reference, now_ns=now_ns)
        return self.receive_odometry(odometry, now_ns=now_ns) or answered

    def check_stamps(self, wanted: bool) -> None:
        """Compare stamps with arrivals, or not, as of a recorded odometry known to be accepted."""
        self._supervisor.inputs.gate.checks_stamps = instance(wanted, "wanted", bool)

    def receive_odometry(self, odometry: OdometrySample, *, now_ns: int) -> Tick | None:
        """Take an odometry, which may trigger a tick.

        Args:
            odometry: The state of the vehicle.
            now_ns: When it arrived [ns], by any clock that runs evenly; not read in lockstep.

        Returns:
            The tick, with the command to send; None if the odometry is refused or none is due.
        """
        instance(odometry, "odometry", OdometrySample)
        now_ns = odometry.stamp_ns if self._config.lockstep else stamp(now_ns, "now_ns")
        accepted = self._supervisor.accept_odometry(odometry, now_ns=now_ns)
        if accepted is None:
            return None
        if self._config.lockstep:
            return self._last_tick if self._is_answered() else self._answer_in_lockstep()
        if not self._decimation.is_due(accepted.stamp_ns):
            return None
        return self._answer(accepted, duration=self._period_ns * 1e-9, now_ns=now_ns)

    def receive_reference(self, window: ReferenceWindow, *, now_ns: int) -> Tick | None:
        """Take a reference window, the samples of the reference from now on.

        Args:
            window: The samples; they must cover the stamps of the odometries to come.
            now_ns: When it arrived [ns], by the clock of :meth:`receive_odometry`.

        Returns:
            In lockstep the tick of the odometry that waited for this window, otherwise None.
        """
        instance(window, "window", ReferenceWindow)
        now_ns = window.stamp_ns if self._config.lockstep else stamp(now_ns, "now_ns")
        if not self._supervisor.accept_reference(window, now_ns=now_ns):
            return None
        if self._config.lockstep and not self._is_answered():
            return self._answer_in_lockstep()
        return None

    def receive_imu(self, sample: ImuSample) -> Tick | None:
        """Take what an accelerometer measured, for the next odometry.

        Without ``accelerometer_noise`` nothing comes of it.

        Args:
            sample: The specific force, stamped by the clock of the odometry.

        Returns:
            In lockstep the tick of the odometry that waited for it, otherwise None.
        """
        instance(sample, "sample", ImuSample)
        if not self._config.feels or not self._supervisor.accept_imu(sample):
            return None
        self._mpc.feel(sample)
        if self._config.lockstep and not self._is_answered():
            return self._answer_in_lockstep()
        return None

    def watch(self, *, now_ns: int) -> Tick | None:
        """Act when no odometry comes: to be called every control period by a timer.

        It may pause for :meth:`seconds_until_unseen`.

        Args:
            now_ns: The time [ns], by the clock of :meth:`receive_odometry`.

        Returns:
            A tick when the odometry is older than its timeout, otherwise None.
        """
        now_ns = stamp(now_ns, "now_ns")
        if self._config.lockstep or not self._supervisor.is_unseen(now_ns=now_ns):
            return None
        # By the clock of the odometries' stamps.
        answered = self._answered or _Answered(now_ns, now_ns)
        unseen_ns = answered.stamp_ns + now_ns - answered.now_ns
        step, plan, fault = None, None, _NOT_RUN
        if self._supervisor.may_foresee(now_ns=now_ns):
            step, fault = self._step(unseen_ns, now_ns=now_ns)
            plan = step.plan if step is not None and not fault else None
        return self._send(
            self._supervisor.decide_unseen(plan=plan, plan_fault=fault, now_ns=now_ns),
            stamp_ns=now_ns,
            sent_ns=unseen_ns,
            duration=self._period_ns * 1e-9,
            now_ns=now_ns,
            step=step,
            plan=plan,
        )

    def seconds_until_unseen(self, *, now_ns: int) -> float:
        """Return how long :meth:`watch` will have nothing to do, whatever comes; 0 if it acts."""
        return self._supervisor.seconds_until_unseen(now_ns=stamp(now_ns, "now_ns"))

    def replace_last_command(self, command: CommandSample, *, now_ns: int) -> None:
        """Take note that this command was sent in place of that of the last tick."""
        instance(command, "command", CommandSample)
        now_ns = stamp(now_ns, "now_ns")
        finite = math.isfinite(command.throttle) and np.isfinite(command.w_WB_B).all()
        if not finite:
            raise ArgumentError("command", command, "a command of finite numbers")
        u = Input(throttle=command.throttle, w_WB_B=command.w_WB_B)
        self._supervisor.note_sent(u, now_ns=now_ns)
        tick = self._last_tick
        replaces = tick is not None and tick.stamp_ns == command.stamp_ns
        self._mpc.sent(u, stamp_ns=self._sent_ns if replaces else command.stamp_ns)

    def _is_answered(self) -> bool:
        """Whether the last tick belongs to the newest odometry."""
        odometry, tick = self._supervisor.inputs.odometry, self._last_tick
        return odometry is not None and tick is not None and tick.stamp_ns == odometry.stamp_ns

    def _answer_in_lockstep(self) -> Tick | None:
        """Answer the newest odometry if the reference of its stamp is there."""
        odometry, window = self._supervisor.inputs.odometry, self._supervisor.inputs.reference
        if odometry is None or window is None or window.stamp_ns != odometry.stamp_ns:
            return None
        if self._awaits_imu(odometry.stamp_ns):
            return None
        held_ns = self._period_ns
        if self._last_tick is not None:  # each odometry is answered, at whatever rate they come
            held_ns = min(odometry.stamp_ns - self._last_tick.stamp_ns, held_ns)
        return self._answer(odometry, duration=held_ns * 1e-9, now_ns=odometry.stamp_ns)

    def _awaits_imu(self, stamp_ns: int) -> bool:
        """Whether an odometry in lockstep is to wait for what was felt until its stamp.

        Not the first one: there is no time before it.
        """
        if not self._config.feels or self._last_tick is None:
            return False
        felt_ns = self._supervisor.inputs.imu_stamp_ns
        return felt_ns is None or felt_ns < stamp_ns

    def _answer(self, odometry: OdometrySample, *, duration: float, now_ns: int) -> Tick:
        """Plan, let the supervisor decide who commands, and send.

        The command is expected to act for ``duration`` [s].
        """
        sent_ns = odometry.stamp_ns + self._lateness.of(odometry.stamp_ns, now_ns=now_ns)
        self._answered = _Answered(sent_ns, now_ns)
        self._supervisor.judge_ground(odometry)
        step, plan_fault = self._step(sent_ns, odometry=odometry, now_ns=now_ns)
        plan = step.plan if step is not None and not plan_fault else None
        decision = self._supervisor.decide(
            odometry, plan=plan, plan_fault=plan_fault, now_ns=now_ns
        )
        return self._send(
            decision,
            stamp_ns=odometry.stamp_ns,
            sent_ns=sent_ns,
            duration=duration,
            now_ns=now_ns,
            step=step,
            plan=plan,
        )

    def _step(
        self, stamp_ns: int, *, odometry: OdometrySample | None = None, now_ns: int
    ) -> tuple[MpcStep | None, str]:
        """Run the MPC for a command sent at a stamp; if it gives no plan to fly, return why.

        Without an odometry it begins where the vehicle should be then.
        """
        window, fault = self._supervisor.inputs.reference_at(stamp_ns, now_ns=now_ns)
        if window is None:
            return None, fault
        if self._delayed is not None:
            window = self._delayed.at(window, stamp_ns)
            self._supervisor.fly_around(window, None)
        try:
            if odometry is not None:
                flown = self._guided_by(odometry, window)
                step: MpcStep | None = self._mpc.step(
                    odometry,
                    flown.window,
                    flown.corridor,
                    late_ns=stamp_ns - odometry.stamp_ns,
                )
            else:
                flown = self._guided or Guided(window)
                step = self._mpc.step_unseen(stamp_ns, flown.window, flown.corridor)
        except Exception as error:  # whatever it is, something has to fly the vehicle
            self._mpc.begin_anew()
            fault = f"error in the control step: {error!r}"
            return None, self._supervisor.solver_failure(fault)
        if step is None:
            return None, _NOT_RUN
        fault = self._supervisor.plan_fault(
            step.plan, status=step.solution.status, step_time=step.step_time
        )
        if odometry is None:
            fault = fault or self._supervisor.foreseen_fault(step.state)
        if self._delayed is not None and step.plan is not None and not fault:
            self._delayed.take(step.plan, stamp_ns=stamp_ns)
        return step, fault

    def _guided_by(self, odometry: OdometrySample, window: ReferenceWindow) -> Guided:
        """Return what to fly in place of a window, and within which corridor."""
        if self._guide is None:
            return Guided(window)
        self._guided = self._guide.guide(odometry, window, self._plan)
        around = self._guided.window
        self._supervisor.fly_around(around, self._guided.corridor)
        return self._guided

    def _send(
        self,
        decision: Decision,
        *,
        stamp_ns: int,
        sent_ns: int,
        duration: float,
        now_ns: int,
        step: MpcStep | None = None,
        plan: Plan | None = None,
    ) -> Tick:
        """Have the command of who commands, record that it is sent, and return the tick.

        ``sent_ns`` is when that is on the clock of the odometries' stamps.
        """
        u = self._supervisor.command(
            decision.source, duration=duration, now_ns=now_ns, learned=self._mpc.learned
        )
        command = None
        if u is not None:
            self._sent_ns = sent_ns
            self._mpc.sent(u, stamp_ns=sent_ns)
            command = CommandSample(stamp_ns=stamp_ns, throttle=u.throttle, w_WB_B=u.w_WB_B)
        odom_age_ns, reference_age_ns = self._supervisor.inputs.ages_ns(now_ns)
        reference = self._supervisor.inputs.reference
        self._plan = plan
        behind = 0.0 if self._delayed is None else self._delayed.behind
        self._last_tick = Tick(
            command=command,
            decision=decision,
            stamp_ns=stamp_ns,
            figures=functools.partial(
                figures_of,
                decision,
                step,
                self._supervisor.counts,
                stamp_ns=stamp_ns,
                odom_age_ns=odom_age_ns,
                reference_age_ns=reference_age_ns,
                reference_stamp_ns=0 if reference is None else reference.stamp_ns,
                ground=self._ground.state.value,
                avoidance=Avoidance() if self._guided is None else self._guided.avoidance,
                behind=behind,
            ),
            guided=self._guided,
            behind=behind,
            plan=plan,
        )
        return self._last_tick


class Decimation:
    """Which odometries are due: of those around each tick of the control rate the nearest.

    Half the distance between odometries is forgiven, so jitter costs no tick when they come at the
    control rate, and faster ones are still distinguished.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._due_ns: int | None = None
        self._mean_ns = period_ns  # smoothed distance between odometries, never above the period
        self._previous_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Take the stamp of the next odometry and return whether it triggers a tick."""
        self._measure(stamp_ns)
        if self._due_ns is None or abs(stamp_ns - self._due_ns) > _PERIODS_AWAY * self._period_ns:
            self._due_ns = stamp_ns  # the first, or the first of a clock that was set
        if stamp_ns < self._due_ns - self._mean_ns // 2:
            return False
        overdue = stamp_ns > self._due_ns + self._period_ns
        self._due_ns = (stamp_ns if overdue else self._due_ns) + self._period_ns
        return True

    def _measure(self, stamp_ns: int) -> None:
        if self._previous_ns is not None and stamp_ns > self._previous_ns:
            distance_ns = min(stamp_ns - self._previous_ns, self._period_ns)
            self._mean_ns += (distance_ns - self._mean_ns) // 4
        self._previous_ns = stamp_ns
