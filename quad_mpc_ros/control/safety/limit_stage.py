# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The limit stage: the command of the active source, within all limits."""

from __future__ import annotations

from collections import deque

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimate_stage import EstimateStage
from quad_mpc_ros.control.estimation.delay_compensation import LearnedModel
from quad_mpc_ros.control.estimation.ground_state import AllowedCommand, GroundState
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, state_from_odometry
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.safety.command_limits import clamped
from quad_mpc_ros.control.safety.decide_stage import Decided, DecideStage
from quad_mpc_ros.control.safety.fallbacks import (
    BlindFallback,
    HoverFallback,
    idle,
    levelling,
    stop_within,
)
from quad_mpc_ros.control.safety.input_monitor import InputMonitor
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.control.stage import Due, Stage, StageLog

# Sources that track a position; their tilt is replaced near the ground.
_POSITION_SOURCES = (Source.MPC, Source.PLAN, Source.HOVER)

# Largest thrust over weight before lift-off: enough for a vehicle with half of the modelled
# thrust, and slow enough to stop a take-off when odometry and commands disagree.
_MAX_TAKEOFF_LIFT = 2.2
# The estimate is kept once a second, so that the oldest is from before a contradiction was found.
_ESTIMATE_PERIOD_NS, _KEPT_ESTIMATES = 1_000_000_000, 3


class LimitStage(Stage):
    """Owns the held plan, the fallbacks, and the active command."""

    def __init__(
        self,
        config: MpcConfig,
        inputs: InputMonitor,
        estimation: EstimateStage,
        deciding: DecideStage,
        log: StageLog,
    ) -> None:
        self._config, self._inputs, self._log = config, inputs, log
        self._estimation, self._ground = estimation, estimation.ground
        self._limits, self._consistency = deciding.limits, deciding.consistency
        vehicle = config.vehicle()
        weight = vehicle.mass * vehicle.gravity
        self._throttle_near_ground = vehicle.nearest_throttle(_MAX_TAKEOFF_LIFT * weight)
        self._hover = HoverFallback(config)
        self._blind = BlindFallback(config)
        self._plan: Plan | None = None
        self._planned_ns = self._sent_ns = 0
        self.acting: Input | None = None
        """The active command, None before the first command."""
        # Only vertical parts are used, which no reset of the estimate changes.
        self._kept: deque[LearnedModel] = deque(maxlen=_KEPT_ESTIMATES)
        self._kept_ns: int | None = None

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed limits."""
        self._config = config

    def replace(self, u: Input, *, now_ns: int) -> None:
        """Replace the active command."""
        self.acting, self._sent_ns = u, now_ns

    def step(self, due: Due, decided: Decided, *, corridor: Corridor | None) -> Input | None:
        """Return the limited command, which becomes active; None to publish nothing.

        Args:
            due: The control step.
            decided: The active source, and the plan that can be flown.
            corridor: The free region, None for no constraint.
        """
        if due.odometry is not None:
            self._blind.release()
        else:
            self._dead_reckon(due.now_ns)
        if decided.plan is not None:
            self._plan, self._planned_ns = decided.plan, due.now_ns
        wanted = self._wanted(due, decided, corridor)
        if wanted is None:
            return None
        source = decided.decision.source
        allowed = self._ground.allowed
        if self._ground.state is GroundState.UNKNOWN and source is not Source.MPC:
            allowed = AllowedCommand.ALL  # the vehicle may be in the air
        u = clamped(self._allowed(wanted, allowed, source), self._config)
        self.acting, self._sent_ns = u, due.now_ns
        self._log.command(by_fallback=source is not Source.MPC)
        return u

    def _dead_reckon(self, now_ns: int) -> None:
        """Update dead reckoning in a step without odometry."""
        newest = self._inputs.odometry
        if newest is not None and self.acting is not None:
            self._blind.dead_reckon(
                state_from_odometry(newest).R_WB,
                self.acting.w_WB_B,
                duration=(now_ns - self._sent_ns) * 1e-9,
            )

    def _wanted(self, due: Due, decided: Decided, corridor: Corridor | None) -> Input | None:
        """Return the command of the active source, before any limit."""
        source, newest = decided.decision.source, self._inputs.odometry
        if source is not Source.HOVER:
            self._hover.release()
        match source:
            case Source.MPC | Source.PLAN if self._plan is not None:
                kept_ns = self._kept_ns
                if kept_ns is None or not 0 <= due.now_ns - kept_ns < _ESTIMATE_PERIOD_NS:
                    self._kept_ns = due.now_ns
                    self._kept.append(self._estimation.estimator.learned())
                elapsed = (due.now_ns - self._planned_ns) * 1e-9
                return self._plan.command_over(elapsed, due.duration)
            case Source.HOVER if newest is not None:
                x = state_from_odometry(newest)
                p_hold = self._limits.inside(x.p_WB)
                if corridor is not None:
                    p_hold = stop_within(corridor, p_hold, v_WB_W=x.v_WB_W)
                learned = self._estimation.estimator.learned()
                return self._hover.command(
                    x, p_hold=p_hold, learned=learned, duration=due.duration
                )
            case Source.IDLE:
                return idle(self._config)
            case Source.BLIND if newest is not None and decided.blind_ns is not None:
                elapsed = decided.blind_ns * 1e-9
                if self._consistency.breach is not None:
                    return self._descend(newest, elapsed=elapsed)
                R_WB = state_from_odometry(newest).R_WB
                learned = self._estimation.estimator.learned()
                return self._blind.command(R_WB, elapsed=elapsed, learned=learned)
            case _:
                return None

    def _descend(self, odometry: OdometrySample, *, elapsed: float) -> Input:
        """Return the command that descends while odometry and commands disagree."""
        at = self._consistency.descent_state(odometry)
        if at is None:
            return idle(self._config)
        R_WB, v_WB_W = at
        return self._blind.command(
            R_WB,
            v_WB_W=v_WB_W,
            elapsed=elapsed,
            learned=self._kept[0] if self._kept else LearnedModel(),
        )

    def _allowed(self, wanted: Input, allowed: AllowedCommand, source: Source) -> Input:
        """Return the part of a source's command that may be sent to the motors."""
        newest = self._inputs.odometry
        match allowed:
            case AllowedCommand.IDLE:
                return idle(self._config)
            case AllowedCommand.LEVEL if newest is not None and source in _POSITION_SOURCES:
                turn = levelling(state_from_odometry(newest).R_WB)
                throttle = min(wanted.throttle, self._throttle_near_ground)
                return Input(throttle=throttle, w_WB_B=turn)
            case _:
                return wanted
