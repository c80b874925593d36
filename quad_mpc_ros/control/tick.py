"""What came of one tick of the controller: a command, who gave it and why, and figures."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

from quad_mpc_ros.control.mpc import MpcStep
from quad_mpc_ros.control.stats import TickStats
from quad_mpc_ros.model.rollout import NO_DISTURBANCE
from quad_mpc_ros.model.samples import CommandSample
from quad_mpc_ros.ocp.formulation import Plan
from quad_mpc_ros.safety.ladder import Decision


class Tick:
    """Outcome of one tick; ``command`` is None when the ladder says to publish nothing.

    Its figures are worked out when they are asked for, which is after the command has gone out.
    """

    def __init__(
        self,
        *,
        command: CommandSample | None,
        decision: Decision,
        stamp_ns: int,
        figures: Callable[[], TickStats],
        plan: Plan | None,
    ) -> None:
        self.command = command
        self.decision = decision
        self.stamp_ns = stamp_ns
        self.plan = plan
        self._figures = figures

    @functools.cached_property
    def stats(self) -> TickStats:
        """The figures of the tick."""
        return self._figures()


class Counts(NamedTuple):
    """What has been counted so far; see :class:`TickStats`."""

    commands: int = 0
    fallbacks: int = 0
    solver_failures: int = 0
    deadline_misses: int = 0
    rejected_inputs: int = 0


def figures_of(
    decision: Decision,
    step: MpcStep | None,
    counts: Counts,
    *,
    stamp_ns: int,
    odom_age_ns: int,
    reference_age_ns: int,
) -> TickStats:
    """Return the figures of a tick; ``step`` is None when the MPC did not run."""
    solution = step.solution if step is not None else None
    d = step.situation.disturbance if step is not None else NO_DISTURBANCE
    model = step.situation.model if step is not None else None
    return TickStats(
        stamp_ns=stamp_ns,
        source=decision.source.name.lower(),
        reason=decision.reason,
        solver_status=solution.status if solution else "not run",
        iterations=step.iterations if step else 0,
        primal_residual=solution.primal_residual if solution else 0.0,
        dual_residual=solution.dual_residual if solution else 0.0,
        solve_time_us=1e6 * step.solve_time if step else 0.0,
        step_time_us=1e6 * step.step_time if step else 0.0,
        disturbance_x=float(d.a_W[0]),
        disturbance_y=float(d.a_W[1]),
        disturbance_z=float(d.a_W[2]),
        thrust_scale=d.thrust_scale,
        rate_time_constant_ms=1e3 * model.rate_time_constant if model else 0.0,
        thrust_time_constant_ms=1e3 * model.thrust_time_constant if model else 0.0,
        odom_age_ms=1e-6 * odom_age_ns,
        reference_age_ms=1e-6 * reference_age_ns,
        **counts._asdict(),
    )
