"""The controller as the node and the simulation use it: inputs in, at most one command out.

It validates what comes in, decimates odometry to the control rate, runs the MPC and, through the
safety ladder, always knows who commands. It reads no ROS and no wall clock: ``now_ns`` is given.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections import deque

import numpy as np

from quad_mpc_ros.control.decimation import Decimation
from quad_mpc_ros.control.mpc import Mpc, MpcStep
from quad_mpc_ros.control.tick import Counts, Tick, figures_of
from quad_mpc_ros.estimation.contact import GroundContact
from quad_mpc_ros.estimation.twist_frame import TwistFrameCheck
from quad_mpc_ros.lie import Array
from quad_mpc_ros.lie.kernels import infinity_norm
from quad_mpc_ros.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.model.state import Input, State, state_from_odometry, with_body_twist
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.formulation import Plan
from quad_mpc_ros.safety import ladder
from quad_mpc_ros.safety.command_limits import clamped, rate_limited
from quad_mpc_ros.safety.fallbacks import (
    BlindFallback,
    HoverFallback,
    dead_reckoned,
    idle,
)
from quad_mpc_ros.safety.flight_limits import FlightLimits
from quad_mpc_ros.safety.ladder import Breach, Decision, Source
from quad_mpc_ros.safety.odometry_gate import OdometryGate
from quad_mpc_ros.safety.validation import coverage_fault, reference_fault

_SECOND = 1_000_000_000
_UNCHECKED = 100


class Controller:
    """MPC with input validation and safety ladder.

    Odometry triggers the ticks. In lockstep an odometry waits for the reference of its own stamp
    and a repeated odometry gets the same answer again, so that lost messages can be sent again.
    """

    def __init__(self, config: MpcConfig, *, deadline: float = math.inf) -> None:
        """``deadline`` [s] is how long a plan may take to be flown, where time does not wait."""
        self._config = config
        self._deadline = deadline
        self._mpc = Mpc(config, deadline=deadline)
        self._gate = OdometryGate(config)
        self._limits = FlightLimits(config)
        self._ground = GroundContact()
        self._hover = HoverFallback(config)
        self._blind = BlindFallback(config)
        self._twist_check = TwistFrameCheck(twist_frame=config.odometry.twist_frame)
        self._vehicle = config.vehicle()
        self._weight = self._vehicle.mass * self._vehicle.gravity
        self._timeouts = ladder.timeouts_of(config)
        self._ladder_memory = ladder.LadderState()
        self._period_ns = round(_SECOND / config.control_rate)
        self._decimation = Decimation(self._period_ns)

        self._odometry: OdometrySample | None = None
        self._odometry_received_ns = 0
        self._window: ReferenceWindow | None = None
        self._window_received_ns = 0
        self._held = self._period_ns * 1e-9  # how long a command is expected to act [s]

        self._plan: Plan | None = None
        self._planned_ns = 0
        self._blind_since_ns: int | None = None
        self._R_WB: Array | None = None  # dead reckoned, while there is no odometry
        self._standing = False
        self._input = Input(throttle=0.0, w_WB_B=np.zeros(3))
        self._sent_ns: int | None = None
        self._last_tick: Tick | None = None

        self._commands = self._fallbacks = self._solver_failures = self._rejected = 0
        self._deadline_misses = 0
        self._warnings: list[str] = []
        # Odometries that nobody takes the warnings of are let go.
        self._unchecked: deque[OdometrySample] = deque(maxlen=_UNCHECKED)

    @property
    def config(self) -> MpcConfig:
        """The configuration in force."""
        return self._config

    def renewed(self) -> Controller:
        """Return a controller like this one that has seen nothing yet."""
        return Controller(self._config, deadline=self._deadline)

    def take_warnings(self) -> list[str]:
        """Return what there is to tell the log since the last call."""
        self._check_twists()
        warnings, self._warnings = self._warnings, []
        return warnings

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed live parameters between two ticks; the warm start stays."""
        self._config = config
        self._timeouts = ladder.timeouts_of(config)
        self._mpc.reconfigure(config)
        self._gate.reconfigure(config)
        self._limits.reconfigure(config)
        self._hover.reconfigure(config)
        self._blind = BlindFallback(config)

    def receive_reference(self, window: ReferenceWindow, *, now_ns: int) -> Tick | None:
        """Take a reference window; in lockstep it may answer the odometry that waits for it."""
        fault = reference_fault(window, frame_id=self._config.odometry.frame_id)
        if fault is not None:
            self._reject(fault)
            return None
        self._window, self._window_received_ns = window, now_ns
        if self._config.lockstep and self._odometry is not None and not self._is_answered():
            return self._answer_in_lockstep(self._odometry)
        return None

    def receive_odometry(self, odometry: OdometrySample, *, now_ns: int) -> Tick | None:
        """Take an odometry and return the tick it triggers, if it is usable and one is due."""
        if self._config.lockstep:
            now_ns = odometry.stamp_ns
        refusal = self._gate.refusal(odometry, now_ns=now_ns)
        if refusal is not None:
            self._reject(refusal)
            return None
        self._unchecked.append(odometry)
        if self._config.odometry.twist_frame == "world":
            odometry = with_body_twist(odometry)
        self._odometry, self._odometry_received_ns = odometry, self._gate.news_ns
        if self._config.lockstep:
            return self._answer_in_lockstep(odometry)
        due = self._decimation.is_due(odometry.stamp_ns)
        return self._tick(odometry, now_ns) if due else None

    def watch(self, *, now_ns: int) -> Tick | None:
        """Act when no odometry does: to be called every control period by a timer."""
        if self._config.lockstep or self._odometry is None or self._sent_ns is None:
            return None
        if abs(now_ns - self._odometry_received_ns) <= self._timeouts.odometry:
            return None
        elapsed = (now_ns - self._sent_ns) * 1e-9
        R_WB = self._state(self._odometry).R_WB
        self._R_WB = dead_reckoned(R_WB, self._input.w_WB_B, duration=elapsed)
        decision = self._decide(now_ns, plan_fault="not run without odometry")
        return self._finish(decision, now_ns, now_ns=now_ns)

    def replace_last_command(self, command: CommandSample, *, now_ns: int) -> None:
        """Take note that this command was sent in place of that of the last tick."""
        self._input = Input(throttle=command.throttle, w_WB_B=command.w_WB_B)
        self._sent_ns = now_ns
        self._mpc.sent(self._input, stamp_ns=command.stamp_ns)

    def engage(self, engaged: bool) -> None:
        """Tell whether commands act on the vehicle: armed, and in the mode that takes them."""
        self._mpc.engage(engaged)

    def _is_answered(self) -> bool:
        """Whether the last tick belongs to the newest odometry."""
        if self._last_tick is None or self._odometry is None:
            return False
        return self._last_tick.stamp_ns == self._odometry.stamp_ns

    def _answer_in_lockstep(self, odometry: OdometrySample) -> Tick | None:
        if self._is_answered():
            return self._last_tick
        if self._window is None or self._window.stamp_ns != odometry.stamp_ns:
            return None
        self._window_received_ns = odometry.stamp_ns
        if self._last_tick is not None:
            # Each odometry is answered, at whatever rate they come.
            elapsed_ns = odometry.stamp_ns - self._last_tick.stamp_ns
            self._held = min(elapsed_ns, self._period_ns) * 1e-9
        return self._tick(odometry, odometry.stamp_ns)

    def _tick(self, odometry: OdometrySample, now_ns: int) -> Tick:
        self._R_WB = None
        step, plan_fault = self._step(odometry, now_ns)
        if step is not None and not plan_fault:
            self._plan, self._planned_ns = step.plan, now_ns
        breach = self._look(odometry, now_ns)
        decision = self._decide(now_ns, plan_fault=plan_fault, breach=breach)
        plan = None if plan_fault else self._plan
        return self._finish(decision, odometry.stamp_ns, now_ns=now_ns, step=step, plan=plan)

    def _step(self, odometry: OdometrySample, now_ns: int) -> tuple[MpcStep | None, str]:
        """Run the MPC; return its outcome, and if it gives no plan to fly, why."""
        window = self._window
        if window is None or now_ns - self._window_received_ns > self._timeouts.reference:
            return None, "no usable reference"
        fault = coverage_fault(window, odometry.stamp_ns, tolerance_ns=self._timeouts.reference)
        if fault is not None:
            return None, fault
        try:
            step = self._mpc.step(odometry, window)
        except Exception as error:  # whatever it is, something has to fly the vehicle
            self._solver_failures += 1
            self._mpc = Mpc(self._config, deadline=self._deadline)
            return None, f"error in the control step: {error!r}"
        if step.plan is None:
            self._solver_failures += 1
            return step, f"solver: {step.solution.status}"
        if not math.isfinite(infinity_norm(step.plan.inputs.ravel())):
            self._solver_failures += 1
            return step, "the plan is not finite"
        if step.step_time > self._deadline:
            self._deadline_misses += 1
            return step, f"late: the plan took {1e3 * step.step_time:.1f} ms"
        return step, ""

    def _look(self, odometry: OdometrySample, now_ns: int) -> Breach | None:
        """Find out from a new odometry whether the vehicle stands, and what limit it breaks."""
        if self._sent_ns is not None:  # before that others may keep it in the air
            lift = self._vehicle.thrust(self._input.throttle) * odometry.up / self._weight
            self._standing = self._ground.update(speed=odometry.speed, lift=lift, now_ns=now_ns)
        return self._limits.check(odometry, p_reference=self._reference_position(), now_ns=now_ns)

    def _reference_position(self) -> Array | None:
        """Return the position (3,) that the reference wants about now."""
        return self._window.p_WB[0] if self._window is not None else None

    def _decide(self, now_ns: int, *, plan_fault: str, breach: Breach | None = None) -> Decision:
        decision, self._ladder_memory = ladder.decide(
            ladder.Inputs(
                now_ns=now_ns,
                odometry_ns=self._odometry_received_ns if self._odometry is not None else None,
                reference_ns=self._window_received_ns if self._window is not None else None,
                plan_fault=plan_fault,
                breach=breach,
                standing=self._standing,
            ),
            self._ladder_memory,
            self._timeouts,
        )
        return decision

    def _finish(
        self,
        decision: Decision,
        stamp_ns: int,
        *,
        now_ns: int,
        step: MpcStep | None = None,
        plan: Plan | None = None,
    ) -> Tick:
        u = self._input_of(decision.source, now_ns)
        command = None
        if u is not None:
            u = self._limited(u, now_ns)
            self._mpc.sent(u, stamp_ns=stamp_ns)
            self._input, self._sent_ns = u, now_ns
            self._commands += 1
            self._fallbacks += decision.source is not Source.MPC
            command = CommandSample(stamp_ns=stamp_ns, throttle=u.throttle, w_WB_B=u.w_WB_B)
        self._last_tick = Tick(
            command=command,
            decision=decision,
            stamp_ns=stamp_ns,
            figures=functools.partial(
                figures_of,
                decision,
                step,
                self._counts(),
                stamp_ns=stamp_ns,
                odom_age_ns=now_ns - (self._odometry.stamp_ns if self._odometry else now_ns),
                reference_age_ns=now_ns - self._window_received_ns,
            ),
            plan=plan,
        )
        return self._last_tick

    def _input_of(self, source: Source, now_ns: int) -> Input | None:
        """Return the command of a rung of the ladder."""
        if source is not Source.HOVER:
            self._hover.release()
        if source is not Source.BLIND:
            self._blind_since_ns = None
        match source:
            case Source.MPC | Source.PLAN if self._plan is not None:
                elapsed = (now_ns - self._planned_ns) * 1e-9
                return self._plan.command_over(elapsed, self._held)
            case Source.HOVER if self._odometry is not None:
                x = self._state(self._odometry)
                return self._hover.command(x, p_hold=self._limits.inside(x.p_WB))
            case Source.IDLE:
                return idle(self._config)
            case Source.BLIND if self._odometry is not None:
                self._blind_since_ns = self._blind_since_ns or now_ns
                elapsed = (now_ns - self._blind_since_ns) * 1e-9
                R_WB = self._state(self._odometry).R_WB
                return self._blind.command(R_WB, elapsed=elapsed)
            case _:
                return None

    def _limited(self, u: Input, now_ns: int) -> Input:
        """Return the command nearest to one that bounds and slew limits allow."""
        if self._sent_ns is not None:
            elapsed = max(now_ns - self._sent_ns, 0) * 1e-9
            u = rate_limited(u, self._input, self._config.slew, duration=elapsed)
        return clamped(u, self._config)

    def _state(self, odometry: OdometrySample) -> State:
        """Return the last known state, with the attitude as it is by dead reckoning."""
        x = state_from_odometry(odometry)
        return x if self._R_WB is None else dataclasses.replace(x, R_WB=self._R_WB)

    def _counts(self) -> Counts:
        return Counts(
            self._commands,
            self._fallbacks,
            self._solver_failures,
            self._deadline_misses,
            self._rejected,
        )

    def _check_twists(self) -> None:
        """Look for a twist in the wrong frame, which has time until the command is out."""
        for odometry in self._unchecked:
            suspected = self._twist_check.suspect(odometry)
            if suspected is not None:
                self._warnings.append(
                    f"the odometry's twist does not match its positions; it seems to be in the "
                    f"{suspected} frame: set odometry.twist_frame to {suspected}"
                )
        self._unchecked.clear()

    def _reject(self, fault: str) -> None:
        self._rejected += 1
        self._warnings.append(fault)
