"""The manifold formulation: SQP on SO(3) with actuators and disturbance.

The variables are deviations δ from the inputs that hold the reference, one a stage
(:mod:`quad_mpc_ros.ocp.target`). An iteration linearises along a plan,

    x_{i+1} = f(x_i, u_r,i + δ_i)           rolled out from the present state: without defects
    dx_{i+1} = A_i dx_i + B_i dδ_i          exact Jacobians, model/jacobians.py
    min  sum 1/2 dx_i' H_i dx_i + g_i' dx_i + sum 1/2 dδ_i' R dδ_i + δ_i' R dδ_i

and takes the step δ + α dδ with the longest α of a few that lowers the true cost
(:mod:`quad_mpc_ros.ocp.tracking_cost`), so a plan is never worse than the one it came from. As a
rule one iteration is enough: the real-time iteration of Diehl et al. (2005), warm started with the
last plan, shifted by the time that has passed. After a jump of the reference the plan that simply
holds the reference's inputs competes with the shifted one, and a few iterations follow.

The cost is the paper's: errors x_r ⊟ x weighted by Q, u_r - u by R, with the velocity in the world
frame, whose norm is the same, and the exact Jacobian of the attitude error. Where there are limits
(:mod:`quad_mpc_ros.ocp.limits`), breaking them costs, in the QP and in the line search.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.jacobians import (
    ATTITUDE,
    POSITION,
    RATE,
    STATE_SIZE,
    THROTTLE,
    VELOCITY,
    jacobians,
)
from quad_mpc_ros.model.parameters import parameters_in, rate_offset_at
from quad_mpc_ros.model.rollout import SUBSTEPS, body_in, roll_out
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.model.state import INPUT_SIZE
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.limits import (
    ALLOWED_SIZE,
    LimitLayout,
    damp,
    let_tilt,
    penalty,
    prepare,
    values_of,
    write_limits,
)
from quad_mpc_ros.ocp.plan import Plan
from quad_mpc_ros.ocp.problem import PredictedState
from quad_mpc_ros.ocp.stages import HorizonPattern, HorizonStages, Shape, stages_in
from quad_mpc_ros.ocp.target import TargetSampler, target_in
from quad_mpc_ros.ocp.tracking_cost import Weights, quadratic_cost, tracking_cost
from quad_mpc_ros.ocp.trajectory import apply_bounds, buffer_size, mark_free, shift, trajectory_in

_STATE_SIZES = np.concatenate((np.repeat([1.0, 3.0, 0.5, 5.0], 3), [0.3]))
_INPUT_SIZES = np.array([0.3, 5.0, 5.0, 5.0])

_COLD_ITERATIONS = 5
_JUMP_ITERATIONS = 3
# A shifted plan whose cost has grown by this much meets a reference that has jumped.
_JUMP_FACTOR, _JUMP_FLOOR = 4.0, 0.1
_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
_CONVERGED = 0.95
# For how long after a flip of the reference the vehicle may be behind.
_RECOVERING_NS = 500_000_000


class ManifoldProblem:
    """Tracks the reference along the predicted trajectory; keeps the last plan from tick to tick.

    Who writes its buffers:

    - ``_target``, the reference: :meth:`begin` alone.
    - ``_nominal``, the plan linearised along, and ``_stages``, the QP about it: :meth:`begin` for
      the warm start, then :meth:`linearise`.
    - ``_plan``, the last plan: :meth:`line_search` alone, with the new one. Where the solver fails
      it stays.
    """

    is_deviation = True

    def __init__(self, config: MpcConfig) -> None:
        self._steps, self._step = config.horizon_steps, config.horizon_step
        lags = *per_axis(config.rate_time_constant), config.thrust_time_constant
        lagging = max(lags) > 0.0
        self._uneven = not config.drags_alike
        self._rate_gain = np.array(per_axis(config.rate_gain))
        # Without lags rate and throttle are their commands and need no states of their own.
        self._size = STATE_SIZE if lagging else ATTITUDE.stop
        self._sampler = TargetSampler(steps=self._steps, step=self._step)
        self._target = self._sampler.buffer
        self._nominal, self._plan = np.zeros((2, buffer_size(self._steps)))
        self._planned = trajectory_in(self._plan)
        self._layout = layout = LimitLayout(config.limits)
        self._stages = HorizonStages.zeros(
            self._steps, self._size, INPUT_SIZE, rows=layout.rows, slacks=layout.slacks
        )
        # What limits allow along the target, no stages without limits; of the present iterate the
        # prices, and how close it is to a limit.
        self._limited = layout.rows > 0
        self._allowed = np.zeros((self._steps if self._limited else 0, ALLOWED_SIZE))
        self._prices, self._closeness = np.zeros(4), 0.0
        self._flips_until_ns, self._flipping = 0, False
        self._no_deviation = np.zeros((self._steps, INPUT_SIZE))
        self._last: tuple[int, float] | None = None  # stamp and cost of the last plan
        # Of the present iterate: its cost, how many iterations are left, and whether the stages
        # are those about it.
        self._cost, self._iterations, self._linearised = 0.0, 0, False
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over weights and bounds; the last plan stays."""
        self._settings = _settings_of(config)
        # A slew of commands is one of what the rates follow, of the axis that follows least.
        followed = np.array([1.0, 1.0, 1.0, min(per_axis(config.rate_gain))])
        self._limits = followed * values_of(config.limits)
        self._pull_distance = config.limits.pull_distance
        # The slope of the cost where the position is off by the distance at which the pull stays
        # the same, per 3 m/s.
        duration = config.horizon_steps * config.horizon_step
        heaviest = max(config.terminal_weight, 1.0) * max(*config.Q[:3], 1e-9)
        self._steep = 3.0 * duration * heaviest * self._pull_distance
        self._R = np.array(config.R)
        _, _, self._u_min, self._u_max = settings_in(self._settings)
        self._stages.R[:] = config.R

    def pattern(self) -> HorizonPattern:
        """Return the sparsity of the Jacobians and of the cost."""
        n, diagonal = self._size, np.eye(3, dtype=bool)
        A = np.zeros((STATE_SIZE, STATE_SIZE), dtype=bool)
        A[POSITION, POSITION] = A[POSITION, VELOCITY] = A[VELOCITY, VELOCITY] = diagonal
        A[:6, VELOCITY] |= self._uneven  # drag that differs between axes acts across
        A[:6, 6:] = True
        A[ATTITUDE, 6:12] = True
        A[RATE, RATE] = diagonal
        A[THROTTLE, THROTTLE] = True
        B = np.zeros((STATE_SIZE, INPUT_SIZE), dtype=bool)
        B[:6] = True
        B[ATTITUDE, 1:] = True
        B[RATE, 1:] = diagonal
        B[THROTTLE, 0] = True
        H = np.zeros((STATE_SIZE, STATE_SIZE), dtype=bool)
        H[:6, :6] = np.eye(6, dtype=bool)
        H[ATTITUDE, ATTITUDE] = True
        return HorizonPattern(
            steps=self._steps,
            A=A[:n, :n],
            B=B[:n],
            H=H[:n, :n],
            state_size=_STATE_SIZES[:n],
            input_size=_INPUT_SIZES,
            limits=self._layout.pattern(n),
        )

    def begin(self, state: PredictedState, window: ReferenceWindow) -> None:
        """Set the target, and warm start: shift the last plan, or hold the reference's inputs."""
        self._state = state
        self._sampler.sample(
            window,
            state.stamp_ns,
            parameters=state.parameters,
            u_min=self._u_min,
            u_max=self._u_max,
        )
        if self._limited:
            self._set_limits(state)
        self._cost, self._iterations = self._warm_start(state.stamp_ns)
        # What is rolled out for its cost has been linearised on the way.
        self._linearised = True

    def _set_limits(self, state: PredictedState) -> None:
        """Set what the limits allow along the target, and bring that near."""
        flips = prepare(
            limits=self._limits,
            step=self._step,
            distance=self._pull_distance,
            u_min=self._u_min,
            u_max=self._u_max,
            start=state.row,
            sent=state.sent,
            since=state.vector[-1],
            target=self._target,
            allowed=self._allowed,
        )
        if flips:
            self._flips_until_ns = state.stamp_ns + _RECOVERING_NS
        self._flipping = 0 <= self._flips_until_ns - state.stamp_ns <= _RECOVERING_NS
        if self._flipping:
            let_tilt(self._allowed)

    def _warm_start(self, stamp_ns: int) -> tuple[float, int]:
        """Linearise along the best start there is; return its cost and the iterations it needs."""
        if self._last is None:
            return self._linearise_along(self._no_deviation), _COLD_ITERATIONS
        last_ns, last_cost = self._last
        elapsed = (stamp_ns - last_ns) * 1e-9 / self._step
        shifted_cost = self._linearise_along(self._planned.deviation, elapsed)
        if shifted_cost <= _JUMP_FACTOR * last_cost + _JUMP_FLOOR:
            return shifted_cost, 1
        cost = self._linearise_along(self._no_deviation)
        if not cost < shifted_cost:
            cost = self._linearise_along(self._planned.deviation, elapsed)
        return cost, _JUMP_ITERATIONS

    def linearise(self) -> HorizonStages:
        """Return the QP in the change of the present iterate."""
        if not self._linearised:
            cost = self._linearise_along(self._planned.deviation)
            if self._limited:  # at other prices
                self._cost = cost
        self._linearised = False
        if self._limited:
            damp(
                R=self._R,
                prices=self._prices,
                closeness=self._closeness,
                steep=math.inf if self._flipping else self._steep,
                shape=self._stages.shape,
                stages=self._stages.buffer,
            )
        return self._stages

    def _linearise_along(self, deviation: Array, elapsed: float = 0.0) -> float:
        """Roll out deviations as they are ``elapsed`` stages later, and linearise; return cost."""
        stages = self._stages
        cost = _linearise(
            parameters=self._state.parameters,
            start=self._state.row,
            settings=self._settings,
            target=self._target,
            deviation=deviation,
            elapsed=elapsed,
            nominal=self._nominal,
            shape=stages.shape,
            stages=stages.buffer,
        )
        if self._limited:
            paid, self._closeness = write_limits(
                starts=self._layout.starts,
                target=self._target,
                nominal=self._nominal,
                allowed=self._allowed,
                prices=self._prices,
                shape=stages.shape,
                stages=stages.buffer,
            )
            cost += paid
        return cost

    def line_search(self, inputs: Array, states: Array) -> bool:
        """Take the longest step that lowers the true cost; return whether to leave it at that."""
        reached = _line_search(
            parameters=self._state.parameters,
            start=self._state.row,
            settings=self._settings,
            target=self._target,
            nominal=self._nominal,
            change=inputs,
            cost=self._cost,
            plan=self._plan,
            allowed=self._allowed,
            prices=self._prices,
        )
        converged = not reached < _CONVERGED * self._cost
        self._cost, self._iterations = reached, self._iterations - 1
        self._last = self._state.stamp_ns, reached
        return converged or self._iterations == 0

    def plan(self) -> Plan:
        """Return the plan of the last line search, in arrays of its own."""
        count = self._steps + 1
        inputs = np.empty((self._steps * SUBSTEPS, INPUT_SIZE))
        p_WB, R_WB = np.empty((count, 3)), np.empty((count, 3, 3))
        _copy_plan(
            self._plan,
            self._rate_gain,
            self._state.parameters,
            inputs=inputs,
            p_WB=p_WB,
            R_WB=R_WB,
        )
        return Plan(
            stamp_ns=self._state.stamp_ns,
            step=self._step,
            input_step=self._step / SUBSTEPS,
            inputs=inputs,
            p_WB=p_WB,
            R_WB=R_WB,
        )


class Settings(NamedTuple):
    """What is configured of the problem: the parts of one vector, see :func:`settings_in`.

    ``step`` [s] of a stage, ``u_min`` and ``u_max`` (4,) bound throttle and rates.
    """

    weights: Weights
    step: float
    u_min: Array
    u_max: Array


def _settings_of(config: MpcConfig) -> Array:
    """Return the vector of a configuration."""
    # Inputs of the problem are what the rates follow, commands times their gain.
    fastest = np.array(per_axis(config.rate_gain)) * config.omega_max
    u_min = config.throttle_min, *(-fastest)
    u_max = config.throttle_max, *fastest
    numbers = config.terminal_weight, config.horizon_step
    return np.array([*config.Q, *config.R, *numbers, *u_min, *u_max])


@compiled
def settings_in(vector: Array) -> Settings:
    """Return what is in the vector (23,)."""
    weights = Weights(vector[0:9], vector[9:13], vector[13])
    return Settings(weights, vector[14], vector[15:19], vector[19:23])


@compiled
def _linearise(
    parameters: Array,
    start: Array,
    settings: Array,
    target: Array,
    deviation: Array,
    elapsed: float,
    nominal: Array,
    shape: Shape,
    stages: Array,
) -> float:
    """Write the QP about a plan shifted by ``elapsed`` stages, and the plan; return its cost."""
    weights, step, u_min, u_max = settings_in(settings)
    tracked, plan, given = target_in(target), trajectory_in(nominal), stages_in(shape, stages)
    dynamics, state_cost, input_terms = given.dynamics, given.state_cost, given.input_terms
    nx = dynamics.shape[1]
    free, errors = np.empty_like(plan.inputs), np.empty((len(dynamics), 9))
    shift(deviation, elapsed, plan.deviation)
    apply_bounds(tracked, plan, u_min=u_min, u_max=u_max)
    mark_free(tracked, plan, free)
    jacobians(
        parameters_in(parameters),
        step,
        inputs=plan.inputs,
        free=free,
        start=start,
        states=plan.states,
        A=dynamics[:, :, :nx],
        B=dynamics[:, :, nx:-1],
    )
    cost = tracking_cost(weights, plan.states, tracked, plan.deviation, errors)
    quadratic_cost(weights, errors, state_cost[:, :, :nx], state_cost[:, :, nx])
    for i in range(len(input_terms)):
        for k in range(INPUT_SIZE):
            planned = tracked.mean_inputs[i, k] + plan.deviation[i, k]
            input_terms[i, 1, k] = weights.R[k] * plan.deviation[i, k]
            # Nothing changes is always allowed.
            input_terms[i, 2, k] = min(u_min[k] - planned, 0.0)
            input_terms[i, 3, k] = max(u_max[k] - planned, 0.0)
    return cost


@compiled
def _line_search(
    parameters: Array,
    start: Array,
    settings: Array,
    target: Array,
    nominal: Array,
    change: Array,
    cost: float,
    plan: Array,
    allowed: Array,
    prices: Array,
) -> float:
    """Write the plan after the longest of a few steps that lowers a cost; return the cost reached.

    Where none does, that is the nominal plan.
    """
    weights, step, u_min, u_max = settings_in(settings)
    model, tracked = parameters_in(parameters), target_in(target)
    before, tried = trajectory_in(nominal), trajectory_in(plan)
    errors, inputs = np.empty((len(change), 9)), np.empty_like(change)
    for length in _STEP_LENGTHS:
        for i in range(len(change)):
            for k in range(INPUT_SIZE):
                tried.deviation[i, k] = before.deviation[i, k] + length * change[i, k]
        apply_bounds(tracked, tried, u_min=u_min, u_max=u_max)
        roll_out(model, step, inputs=tried.inputs, start=start, states=tried.states)
        reached = tracking_cost(weights, tried.states, tracked, tried.deviation, errors)
        if len(allowed) > 0:
            inputs[:] = tracked.mean_inputs + tried.deviation
            reached += penalty(tried.states, inputs, allowed, prices)
        if reached < cost:
            return reached
    plan[:] = nominal
    return cost


@compiled
def _copy_plan(
    plan: Array, rate_gain: Array, parameters: Array, inputs: Array, p_WB: Array, R_WB: Array
) -> None:
    """Write the inputs (N M, 4) of a plan as commands, and its poses 0 to N.

    Inputs are what the rates follow: offset and gain are taken off.
    """
    planned = trajectory_in(plan)
    commands = planned.inputs.reshape((len(inputs), INPUT_SIZE))
    for i in range(len(inputs)):
        inputs[i, 0] = commands[i, 0]
        offset = rate_offset_at(parameters, commands[i, 0])
        for k in range(3):
            inputs[i, 1 + k] = (commands[i, 1 + k] - offset[k]) / rate_gain[k]
    for i in range(len(p_WB)):
        body = body_in(planned.states[i])
        kernels.store_vector(body.p, p_WB[i])
        kernels.store_matrix(body.R, R_WB[i])
