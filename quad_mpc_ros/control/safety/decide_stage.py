# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The decision stage: limits, contradictions and the safety ladder."""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.mpc import Planned
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.safety import ladder
from quad_mpc_ros.control.safety.consistency import ConsistencyMonitor
from quad_mpc_ros.control.safety.flight_limits import FlightLimits
from quad_mpc_ros.control.safety.input_monitor import InputMonitor
from quad_mpc_ros.control.safety.ladder import Action, Breach, Decision, LadderState, Source
from quad_mpc_ros.control.safety.oscillation import OscillationMonitor
from quad_mpc_ros.control.stage import Due, Stage, StageLog

_CRASHED = (
    "crashed: the vehicle is upside down, or does not rise with thrust; put it upright, then "
    "deactivate and activate the MPC, or disengage and engage"
)


class Decided(NamedTuple):
    """The active source, and the plan that can be flown.

    Attributes:
        decision: The source of the command and its reason.
        plan: The new plan, None without a plan to fly.
        blind_ns: Duration of the dead reckoned flight [ns], else None.
    """

    decision: Decision
    plan: Plan | None
    blind_ns: int | None


class DecideStage(Stage):
    """Owns the monitors of the flight and the state of the ladder."""

    def __init__(
        self, config: MpcConfig, inputs: InputMonitor, ground: GroundDetector, log: StageLog
    ) -> None:
        self._inputs, self._ground, self._log = inputs, ground, log
        self.limits = FlightLimits(config)
        self._oscillation = OscillationMonitor(config)
        self.consistency = ConsistencyMonitor(config, ground)
        self._ladder = LadderState()
        self._source = Source.WAITING
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed timeouts."""
        self._timeouts = ladder.timeouts_of(config)

    def may_predict_without_odometry(self, *, now_ns: int) -> bool:
        """Whether the MPC may plan from a state predicted without odometry.

        In flight, for at most ``odom_gap``, and only while the MPC is the active source.
        """
        odometry_ns = self._inputs.odometry_ns or 0
        return (
            self._source is Source.MPC
            and not self._ground.state.is_on_ground
            and self._ground.state is not GroundState.CRASHED
            and 0 <= now_ns - odometry_ns <= self._timeouts.gap
        )

    def step(
        self, due: Due, planned: Planned, *, flown: ReferenceWindow | None, acting: Input | None
    ) -> Decided:
        """Return the decision.

        Args:
            due: The control step.
            planned: The plan, or the reason why no plan exists.
            flown: The window flown instead of the reference, None for the reference itself.
            acting: The active command, None before the first command.
        """
        fault = "" if planned.failure is None else planned.failure.reason
        if due.odometry is not None:
            breach = self._breach(due.odometry, flown, acting, now_ns=due.now_ns)
        else:
            breach = self.consistency.breach
            if not fault and planned.step is not None:
                fault = self.predicted_breach(planned.step.state)
        plan = None if fault or planned.step is None else planned.step.plan
        crashed = self._ground.state is GroundState.CRASHED
        decision, self._ladder = ladder.decide(
            ladder.LadderInputs(
                now_ns=due.now_ns,
                odometry_ns=self._inputs.odometry_ns,
                plan_fault=_CRASHED if crashed else fault,
                breach=breach,
                on_ground=crashed or self._ground.state.is_on_ground,
                is_predicted=due.odometry is None and plan is not None,
                jumped=self._inputs.jumps.fault,
            ),
            self._ladder,
            self._timeouts,
        )
        self._source = decision.source
        since_ns = self._ladder.blind_since_ns
        return Decided(decision, plan, None if since_ns is None else due.now_ns - since_ns)

    def _breach(
        self,
        odometry: OdometrySample,
        flown: ReferenceWindow | None,
        acting: Input | None,
        *,
        now_ns: int,
    ) -> Breach | None:
        """Return the most severe breach, None without a breach."""
        window = self._inputs.reference
        reference = None if window is None else window.pose_at(odometry.stamp_ns)
        followed = reference if flown is None else flown.pose_at(odometry.stamp_ns)
        p_reference = None if reference is None else reference[0]
        known = self.consistency.breach
        breaches = (
            self.limits.check(odometry, p_reference=p_reference, now_ns=now_ns),
            self._oscillation.check(odometry, followed, now_ns=now_ns),
            self.consistency.check(
                odometry,
                self._inputs.reported or odometry,
                acting,
                p_reference=followed[0] if followed and self._source is Source.MPC else None,
            ),
        )
        found = self.consistency.breach
        if found is not None and known is None:
            self._log.warn(found.reason)
        return max(filter(None, breaches), key=lambda each: each.action, default=None)

    def predicted_breach(self, state: PredictedState) -> str:
        """Return the limit that the predicted vehicle breaches, else an empty string."""
        x = state.x
        ahead = OdometrySample(
            stamp_ns=state.stamp_ns,
            p_WB=x.p_WB,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(x.R_WB),
            v_WB_B=x.v_WB_B,
            w_WB_B=state.w_WB_B,
        )
        breach = self.limits.breach_at(ahead)
        return breach.reason if breach is not None and breach.action > Action.WARN else ""
