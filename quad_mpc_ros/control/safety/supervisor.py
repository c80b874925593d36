"""The supervisor of the MPC, see ``docs/safety.md``.

It checks what comes in (:mod:`.input_monitor`), asks the safety ladder (:mod:`.ladder`) who
commands, lets a fallback (:mod:`.fallbacks`) command where the MPC cannot, and limits every
command (:mod:`.command_limits`). It reads no clock: ``now_ns`` is given.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import AllowedCommand, GroundState
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.lie.kernels import infinity_norm
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input, state_from_odometry
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.problem import PredictedState
from quad_mpc_ros.control.safety import ladder
from quad_mpc_ros.control.safety.command_limits import clamped, rate_limited
from quad_mpc_ros.control.safety.fallbacks import (
    BlindFallback,
    HoverFallback,
    Learned,
    idle,
    levelling,
    stop_within,
)
from quad_mpc_ros.control.safety.flight_limits import FlightLimits
from quad_mpc_ros.control.safety.input_monitor import InputMonitor
from quad_mpc_ros.control.safety.ladder import Action, Breach, Decision, LadderState, Source
from quad_mpc_ros.control.safety.oscillation import OscillationMonitor

_CRASHED = (
    "crashed: it lies upside down, or does not rise with thrust; put it upright, then deactivate "
    "and activate the MPC, or disengage and engage"
)

# They turn for where the vehicle is to be; the others, if at all, to make it level.
_STEERING = (Source.MPC, Source.PLAN, Source.HOVER)


class Counts(NamedTuple):
    """What has been counted so far; ``TickStats`` says of each what it is."""

    commands: int = 0
    fallbacks: int = 0
    solver_failures: int = 0
    deadline_misses: int = 0
    rejected_inputs: int = 0


class _HeldPlan(NamedTuple):
    plan: Plan
    planned_ns: int


class _Sent(NamedTuple):
    command: Input
    sent_ns: int


class Supervisor:
    """Checks what comes in, decides who commands, and limits what goes out."""

    def __init__(
        self,
        config: MpcConfig,
        *,
        ground: GroundDetector | None = None,
        deadline: float = math.inf,
    ) -> None:
        """``deadline`` [s] is how long the MPC may take for a plan that is flown.

        ``ground`` is where others read whether the vehicle stands.
        """
        self._config = config
        self._deadline = deadline
        self._vehicle = config.vehicle()
        self._weight = self._vehicle.mass * self._vehicle.gravity
        self.inputs = InputMonitor(config)
        self._flight_limits = FlightLimits(config)
        self._oscillation = OscillationMonitor(config)
        self._ground = ground or GroundDetector(config.gravity)
        self._hover = HoverFallback(config)
        self._blind = BlindFallback(config)
        self._timeouts = ladder.timeouts_of(config)
        self._ladder = LadderState()
        self._source = Source.WAITING
        self._plan: _HeldPlan | None = None
        self._sent: _Sent | None = None
        self._flown: ReferenceWindow | None = None
        self._corridor: Corridor | None = None
        self._warnings: list[str] = []
        self.counts = Counts()

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed live parameters; what is known stays."""
        self._config = config
        self._timeouts = ladder.timeouts_of(config)
        self.inputs.reconfigure(config)
        self._flight_limits.reconfigure(config)
        self._oscillation.reconfigure(config)
        self._hover.reconfigure(config)
        self._blind.reconfigure(config)

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: what is held moves along."""
        self.inputs.reset_estimate(reset)
        self._hover.reset_estimate(reset)
        self._flown = self._corridor = None  # of the coordinates before

    def engage(self, engaged: bool) -> None:
        """Set whether commands act; meanwhile neither oscillation nor jumps are looked for."""
        self.inputs.jumps.engage(engaged)
        self._oscillation.engage(engaged)

    def take_warnings(self) -> list[str]:
        """Return what there is to tell the log since the last call."""
        twist = self.inputs.twist_warning()
        warnings, self._warnings = self._warnings, []
        return warnings if twist is None else [*warnings, twist]

    # --- what comes in

    def accept_odometry(self, odometry: OdometrySample, *, now_ns: int) -> OdometrySample | None:
        """Take an odometry and return it, the twist in the body frame; None if it is unfit."""
        fault = self.inputs.take_odometry(odometry, now_ns=now_ns)
        if fault is not None:
            self._reject(fault)
            return None
        jumps = self.inputs.jumps
        if jumps.fault:
            self._reject(jumps.fault)
        self._warnings.extend(jumps.take_notes())
        return self.inputs.odometry

    def accept_imu(self, sample: ImuSample) -> bool:
        """Take what an accelerometer measured if it is fit to be used."""
        fault = self.inputs.take_imu(sample)
        if fault:
            self._reject(fault)
        return fault is None

    def accept_reference(self, window: ReferenceWindow, *, now_ns: int) -> bool:
        """Take a reference window if it is fit to be used."""
        fault = self.inputs.take_reference(window, now_ns=now_ns)
        if fault is not None:
            self._reject(fault)
        return fault is None

    def fly_around(self, window: ReferenceWindow, corridor: Corridor | None) -> None:
        """Take what is flown in place of the reference, which tilts to one side and the other.

        The hover fallback holds a place inside of the corridor, None for anywhere.
        """
        self._flown, self._corridor = window, corridor

    def judge_ground(self, odometry: OdometrySample) -> None:
        """Find out, before a tick, whether the vehicle stands on the ground."""
        self._ground.idle_wanted = self.inputs.idle_wanted
        if self._sent is None:  # others may keep it in the air
            return
        thrust = self._vehicle.thrust(self._sent.command.throttle) / self._weight
        self._ground.update(odometry, thrust=thrust, window=self.inputs.reference)

    def _reject(self, fault: str) -> None:
        self._count("rejected_inputs")
        self._warnings.append(fault)

    # --- what the MPC made of it

    def plan_fault(self, plan: Plan | None, *, status: str, step_time: float) -> str:
        """Return why a plan cannot be flown, empty if it can.

        The plan is None if the solver, whose ``status`` it is, found none; ``step_time`` [s] is
        how long it took.
        """
        if plan is None:
            return self.solver_failure(f"solver: {status}")
        if not math.isfinite(infinity_norm(plan.inputs.ravel())):
            return self.solver_failure("the plan is not finite")
        if step_time > self._deadline:
            self._count("deadline_misses")
            return f"late: the plan took {1e3 * step_time:.1f} ms"
        return ""

    def solver_failure(self, fault: str) -> str:
        """Count a solve that gave no plan, and return why it did not."""
        self._count("solver_failures")
        return fault

    # --- who commands

    def decide(
        self, odometry: OdometrySample, *, plan: Plan | None, plan_fault: str, now_ns: int
    ) -> Decision:
        """Return who commands in answer to an odometry; the plan is None if it has a fault."""
        self._blind.release()
        if plan is not None:
            self._plan = _HeldPlan(plan, now_ns)
        window = self.inputs.reference
        reference = None if window is None else window.pose_at(odometry.stamp_ns)
        around = self._flown
        flown = reference if around is None else around.pose_at(odometry.stamp_ns)
        breaches = (
            self._flight_limits.check(
                odometry,
                p_reference=reference[0] if reference is not None else None,
                now_ns=now_ns,
            ),
            self._oscillation.check(odometry, flown, now_ns=now_ns),
        )
        breach = max(filter(None, breaches), key=lambda each: each.action, default=None)
        return self._decision(now_ns, plan_fault=plan_fault, breach=breach)

    def is_unseen(self, *, now_ns: int) -> bool:
        """Whether odometry is missing in flight for longer than its timeout."""
        seen_ns = self.inputs.odometry_ns
        if seen_ns is None or self._sent is None:
            return False
        return abs(now_ns - seen_ns) > self._timeouts.odometry

    def may_foresee(self, *, now_ns: int) -> bool:
        """Whether the MPC may plan from where an unseen vehicle should be.

        For a while, in flight, and only as long as nothing else has had to command.
        """
        seen_ns = self.inputs.odometry_ns or 0
        return (
            self._source is Source.MPC
            and not self._lies_or_stands
            and 0 <= now_ns - seen_ns <= self._timeouts.gap
        )

    @property
    def _lies_or_stands(self) -> bool:
        return self._ground.state.stands or self._ground.state is GroundState.CRASHED

    def foreseen_fault(self, state: PredictedState) -> str:
        """Return which limit an unseen vehicle is about to break, empty if none."""
        x = state.x
        ahead = OdometrySample(
            stamp_ns=state.stamp_ns,
            p_WB=x.p_WB,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(x.R_WB),
            v_WB_B=x.v_WB_B,
            w_WB_B=state.w_WB_B,
        )
        breach = self._flight_limits.foreseen(ahead)
        return breach.reason if breach is not None and breach.action > Action.WARN else ""

    def decide_unseen(
        self,
        *,
        plan: Plan | None = None,
        plan_fault: str = "not run without odometry",
        now_ns: int,
    ) -> Decision:
        """Return who commands while the vehicle :meth:`is_unseen`.

        A plan begins where it should be by now.
        """
        odometry, sent = self.inputs.odometry, self._sent
        assert odometry is not None and sent is not None
        self._blind.dead_reckon(
            state_from_odometry(odometry).R_WB,
            sent.command.w_WB_B,
            duration=(now_ns - sent.sent_ns) * 1e-9,
        )
        if plan is not None:
            self._plan = _HeldPlan(plan, now_ns)
        return self._decision(now_ns, plan_fault=plan_fault, foreseen=plan is not None)

    def seconds_until_unseen(self, *, now_ns: int) -> float:
        """Return for how long the vehicle will not be unseen yet."""
        seen_ns, timeout_ns = self.inputs.odometry_ns, self._timeouts.odometry
        age_ns = 0 if seen_ns is None else now_ns - seen_ns
        return max(timeout_ns + 1 - age_ns, 0) * 1e-9 if age_ns >= 0 else 0.0

    def _decision(
        self,
        now_ns: int,
        *,
        plan_fault: str,
        breach: Breach | None = None,
        foreseen: bool = False,
    ) -> Decision:
        crashed = self._ground.state is GroundState.CRASHED
        decision, self._ladder = ladder.decide(
            ladder.Inputs(
                now_ns=now_ns,
                odometry_ns=self.inputs.odometry_ns,
                reference_ns=self.inputs.reference_seen_ns(now_ns),
                plan_fault=_CRASHED if crashed else plan_fault,
                breach=breach,
                standing=self._lies_or_stands,
                foreseen=foreseen,
                jumped=self.inputs.jumps.fault,
            ),
            self._ladder,
            self._timeouts,
        )
        self._source = decision.source
        return decision

    # --- what is sent

    def command(
        self,
        source: Source,
        *,
        duration: float,
        now_ns: int,
        learned: Callable[[], Learned] = Learned,
    ) -> Input | None:
        """Return the command of a source within every limit, which is then in force.

        None if the source sends nothing. It is expected to act for ``duration`` [s]. Fallbacks
        ask for what was ``learned``, and allow for it.
        """
        wanted = self._wanted(source, duration=duration, now_ns=now_ns, learned=learned)
        if wanted is None:
            return None
        allowed = self._ground.allowed
        if self._ground.state is GroundState.UNKNOWN and source is not Source.MPC:
            allowed = AllowedCommand.ALL  # it may be in the air, and may not be seen to fall
        wanted = self._allowed(wanted, allowed, source)
        if self._sent is not None:
            elapsed = max(now_ns - self._sent.sent_ns, 0) * 1e-9
            wanted = rate_limited(wanted, self._sent.command, self._config.slew, duration=elapsed)
        u = clamped(wanted, self._config)
        self._sent = _Sent(u, now_ns)
        commands, fallbacks, failures, misses, rejected = self.counts
        fallbacks += source is not Source.MPC
        self.counts = Counts(commands + 1, fallbacks, failures, misses, rejected)
        return u

    def note_sent(self, u: Input, *, now_ns: int) -> None:
        """Take note of the command in force."""
        self._sent = _Sent(u, now_ns)

    def _wanted(
        self, source: Source, *, duration: float, now_ns: int, learned: Callable[[], Learned]
    ) -> Input | None:
        """Return the command of a source, before any limit."""
        if source is not Source.HOVER:
            self._hover.release()
        odometry, blind_since_ns = self.inputs.odometry, self._ladder.blind_since_ns
        match source:
            case Source.MPC | Source.PLAN if self._plan is not None:
                elapsed = (now_ns - self._plan.planned_ns) * 1e-9
                return self._plan.plan.command_over(elapsed, duration)
            case Source.HOVER if odometry is not None:
                x = state_from_odometry(odometry)
                p_hold = self._flight_limits.inside(x.p_WB)
                if self._corridor is not None:
                    p_hold = stop_within(self._corridor, p_hold, v_WB_W=x.v_WB_W)
                return self._hover.command(x, p_hold=p_hold, learned=learned(), duration=duration)
            case Source.IDLE:
                return idle(self._config)
            case Source.BLIND if odometry is not None and blind_since_ns is not None:
                return self._blind.command(
                    state_from_odometry(odometry).R_WB,
                    elapsed=(now_ns - blind_since_ns) * 1e-9,
                    learned=learned(),
                )
            case _:
                return None

    def _allowed(self, wanted: Input, allowed: AllowedCommand, source: Source) -> Input:
        """Return what may go to the motors of the command that a source wants."""
        odometry = self.inputs.odometry
        match allowed:
            case AllowedCommand.IDLE:
                return idle(self._config)
            case AllowedCommand.LEVEL if odometry is not None and source in _STEERING:
                turn = levelling(state_from_odometry(odometry).R_WB)
                return Input(throttle=wanted.throttle, w_WB_B=turn)
            case _:
                return wanted

    def _count(self, name: str) -> None:
        self.counts = self.counts._replace(**{name: getattr(self.counts, name) + 1})
