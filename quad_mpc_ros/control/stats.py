"""What one tick of the controller tells about itself; published as ``mpc/stats``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass


@dataclass(kw_only=True, slots=True)
class TickStats:
    """Figures of one tick; the documentation of each key is the comment beside it."""

    stamp_ns: int  # stamp of the odometry answered, or the time of a tick without one [ns]
    source: str  # rung of the safety ladder that commanded: mpc, plan, hover, idle, blind, silent
    reason: str  # why that rung, empty when all is well
    solver_status: str  # as OSQP names it, or "not run"
    iterations: int  # of OSQP
    primal_residual: float  # of the scaled problem
    dual_residual: float  # of the scaled problem
    solve_time_us: float  # OSQP's own run time [us]
    step_time_us: float  # state in to plan out [us]
    disturbance_x: float = 0.0  # estimated acceleration of the disturbance, world [m/s^2]
    disturbance_y: float = 0.0  # the same
    disturbance_z: float = 0.0  # the same
    thrust_scale: float = 1.0  # estimated true thrust over the modelled
    rate_time_constant_ms: float = 0.0  # in the model by now, estimated where there is one [ms]
    thrust_time_constant_ms: float = 0.0  # the same
    odom_age_ms: float  # age of the odometry by its stamp when the tick began [ms]
    reference_age_ms: float  # age of the reference since it arrived [ms]
    commands: int  # commands sent so far
    fallbacks: int  # of those, not from the MPC
    solver_failures: int  # solves so far that gave no plan
    deadline_misses: int = 0  # plans so far that came too late and were dropped
    rejected_inputs: int  # odometry and reference messages ignored so far as unusable

    def items(self) -> list[tuple[str, str]]:
        """Return the figures as text, numbers with every digit."""
        return [(field.name, str(getattr(self, field.name))) for field in dataclasses.fields(self)]
