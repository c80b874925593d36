# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Result of one tick of the controller: command, decision and figures."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from quad_mpc_ros.control.model.samples import CommandSample

if TYPE_CHECKING:  # reading the figures of a recording requires no solver
    from quad_mpc_ros.control.estimation.delay_compensation import EstimateStatus
    from quad_mpc_ros.control.estimation.ground_state import GroundState
    from quad_mpc_ros.control.guide import Guided
    from quad_mpc_ros.control.mpc import MpcStep
    from quad_mpc_ros.control.ocp.plan import Plan
    from quad_mpc_ros.control.safety.ladder import Decision


@dataclass(kw_only=True, eq=False)
class Tick:
    """Result of one tick; ``command`` is None if the ladder publishes nothing.

    Attributes:
        command: The command to send.
        decision: The active source and its reason.
        stamp_ns: Stamp of the odometry, or the time of a tick without odometry [ns].
        plan: The active plan, None without a plan.
        guided: Result of the guide, None without a guide.
        behind: Delay behind the reference's clock, formulation ``contouring`` [s].
        step: The step of the MPC, None without a step.
        counts: Counts of the flight so far, by name.
        ages_ns: Age of the odometry by its stamp, 0 without odometry, and of the reference since
            its arrival, the time itself without reference [ns].
        reference_stamp_ns: Stamp of the reference [ns], 0 without a reference.
        ground: The ground state.
        estimate: Status of the estimate.
    """

    command: CommandSample | None
    decision: Decision
    stamp_ns: int
    plan: Plan | None
    guided: Guided | None
    behind: float
    step: MpcStep | None
    counts: dict[str, Any]
    ages_ns: tuple[int, int]
    reference_stamp_ns: int
    ground: GroundState
    estimate: EstimateStatus

    @functools.cached_property
    def stats(self) -> TickStats:
        """The figures of the tick, computed on first access: after the command is sent."""
        odom_age_ns, reference_age_ns = self.ages_ns
        figures: dict[str, Any] = {}
        if self.guided is not None:
            names = "avoidance", "avoidance_reason", "clearance_m"
            figures = dict(zip(names, self.guided.avoidance, strict=True))
        return TickStats(
            stamp_ns=self.stamp_ns,
            source=self.decision.source.name.lower(),
            reason=self.decision.reason,
            odom_age_ms=1e-6 * odom_age_ns,
            reference_age_ms=1e-6 * reference_age_ns,
            reference_stamp_ns=self.reference_stamp_ns,
            ground=self.ground.value,
            progress_delay_s=self.behind,
            estimate_resets=self.estimate.resets,
            **figures,
            **self.counts,
            **_solver_figures(self.step, self.estimate),
        )


@dataclass(kw_only=True, slots=True)
class TickStats:
    """Figures of one tick, published as ``mpc/stats``."""

    stamp_ns: int  # stamp of the odometry answered, or the time of a tick without one [ns]
    source: str  # failsafe level: mpc, plan, hover, idle, blind, silent
    reason: str  # of the failsafe level, empty in normal operation
    solver_status: str  # as OSQP names it, or "not run"
    iterations: int  # of OSQP
    primal_residual: float  # of the scaled problem
    dual_residual: float  # of the scaled problem
    solve_time_us: float  # OSQP's own run time [us]
    step_time_us: float  # from the start of the control step to the plan [us]
    ground: str = "unknown"  # or on_ground, lifting_off, flying, touching_down, crashed
    avoidance: str = "off"  # of obstacles: off, free (the reference), around, stopped, failed
    avoidance_reason: str = ""  # why not free
    clearance_m: float = math.inf  # from the vehicle's surface to the nearest known obstacle [m]
    progress_delay_s: float = 0.0  # delay behind the reference's clock, formulation contouring [s]
    disturbance_x: float = 0.0  # estimated disturbance acceleration, world [m/s^2]
    disturbance_y: float = 0.0  # as disturbance_x
    disturbance_z: float = 0.0  # as disturbance_x
    thrust_scale: float = 1.0  # estimated true over modelled thrust
    rate_time_constant_ms: float = 0.0  # estimated, mean of roll and pitch [ms]
    yaw_time_constant_ms: float = 0.0  # estimated, of yaw [ms]
    torque_time_constant_ms: float = (
        0.0  # estimated, of the rate loops, mean of roll and pitch [ms]
    )
    thrust_time_constant_ms: float = 0.0  # estimated, of the throttle [ms]
    rate_weight_scale: float = 1.0  # factor on the weights of the rates
    drag: float = 0.0  # estimated, mean over the axes [1/s]
    rate_offset_x: float = 0.0  # estimated offset of the roll rate from its command [rad/s]
    rate_offset_y: float = 0.0  # estimated offset of the pitch rate from its command [rad/s]
    # Status of the estimate: hold, velocity only, learn, reject, at bounds, reset.
    estimate: str = "hold"
    estimate_resets: int = 0  # resets of the estimate so far
    # Use of the accelerometer since the last odometry: off, missing, paused, used or refused.
    accelerometer: str = "off"
    odom_age_ms: float  # age of the odometry by its stamp at the start of the tick [ms]
    reference_age_ms: float  # age of the reference since its arrival [ms]
    reference_stamp_ns: int = 0  # stamp of the reference [ns], 0 without a reference
    imu_stamp_ns: int = 0  # stamp of the newest accelerometer sample [ns], 0 without a sample
    commands: int  # commands sent so far
    fallbacks: int  # commands sent so far by other sources than the MPC
    solver_failures: int  # solves so far without plan
    deadline_misses: int = 0  # late plans dropped so far
    rejected_inputs: int  # unusable odometry, reference and imu messages so far
    # Errors so far in ground detector, estimator, delayed reference or guide.
    stage_errors: int = 0

    def items(self) -> list[tuple[str, str]]:
        """Return the figures as text, numbers with all digits."""
        return [(field.name, str(getattr(self, field.name))) for field in dataclasses.fields(self)]


def _solver_figures(step: MpcStep | None, estimate: EstimateStatus) -> dict[str, Any]:
    if step is None:
        none = ("primal_residual", "dual_residual", "solve_time_us", "step_time_us")
        return {"solver_status": "not run", "iterations": 0, **dict.fromkeys(none, 0.0)}
    # Fields of an array, because attributes of a record are ten times slower.
    model = step.state.parameters
    disturbance = model["a_W"].tolist()
    roll_lag, pitch_lag, yaw_lag = model["rate_time_constants"].tolist()
    roll_offset, pitch_offset, _ = step.state.rate_offset
    return {
        "solver_status": step.solution.status,
        "iterations": step.iterations,
        "primal_residual": step.solution.primal_residual,
        "dual_residual": step.solution.dual_residual,
        "solve_time_us": 1e6 * step.solve_time,
        "step_time_us": 1e6 * step.step_time,
        "disturbance_x": disturbance[0],
        "disturbance_y": disturbance[1],
        "disturbance_z": disturbance[2],
        "thrust_scale": float(model["thrust_scale"]),
        "rate_time_constant_ms": 5e2 * (roll_lag + pitch_lag),
        "yaw_time_constant_ms": 1e3 * yaw_lag,
        "torque_time_constant_ms": 5e2 * sum(model["torque_time_constants"].tolist()[:2]),
        "thrust_time_constant_ms": 1e3 * float(model["thrust_time_constant"]),
        "rate_weight_scale": step.state.prediction["rate_weight_scale"].item(),
        "drag": float(model["drag"]),
        "rate_offset_x": roll_offset,
        "rate_offset_y": pitch_offset,
        "estimate": estimate.text,
        "accelerometer": estimate.accelerometer,
        "imu_stamp_ns": estimate.imu_stamp_ns,
    }
