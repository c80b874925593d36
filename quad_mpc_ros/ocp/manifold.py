"""The manifold formulation: real-time iteration on SO(3) with actuators and disturbance.

The plan is made of deviations from the inputs that hold the reference, one a stage. The last plan
is shifted by the time that has passed and rolled out from the present state; every stage is
linearised along that trajectory (:mod:`quad_mpc_ros.model.rollout`) and one QP in the change
of the plan is solved. The step is taken as far as it lowers the true cost, so a plan is never
worse than the one it came from; after a jump of the reference the plan that simply holds the
reference's inputs competes with the shifted one, and a few iterations follow.

The cost is the paper's: errors x_r ⊟ x weighted by Q, u_r - u by R, with the velocity in the world
frame, whose norm is the same, and the exact Jacobian of the attitude error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.rollout import (
    ATTITUDE,
    INPUT_SIZE,
    POSITION,
    RATE,
    STATE_SIZE,
    SUBSTEPS,
    THROTTLE,
    VELOCITY,
    Model,
    Motion,
    jacobians,
    motion,
    roll_out,
)
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.formulation import Horizon, Plan
from quad_mpc_ros.ocp.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.ocp.situation import Situation
from quad_mpc_ros.ocp.target import Target, TargetSampler
from quad_mpc_ros.ocp.tracking_cost import Weights, quadratic_cost, tracking_cost

_STATE_SIZES = np.concatenate((np.repeat([1.0, 3.0, 0.5, 5.0], 3), [0.3]))
_INPUT_SIZES = np.array([0.3, 5.0, 5.0, 5.0])

_COLD_ITERATIONS = 5
_JUMP_ITERATIONS = 3
# A shifted plan whose cost has grown by this much meets a reference that has jumped.
_JUMP_FACTOR, _JUMP_FLOOR = 4.0, 0.1
_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
_CONVERGED = 0.95


class _Candidate(NamedTuple):
    """A plan and where it leads.

    ``deviation`` (N, 4) from the reference's inputs, ``inputs`` (N, M, 4) inside the bounds,
    ``free`` (N, M, 4) zero where a bound holds them, the states 0 to N, ``errors`` (N, 9).
    """

    deviation: Array
    inputs: Array
    free: Array
    p_WB: Array
    v_WB_W: Array
    R_WB: Array
    actuators: Array
    errors: Array


def _candidate(steps: int) -> _Candidate:
    """Return room for a plan that does nothing."""
    return _Candidate(
        deviation=np.zeros((steps, INPUT_SIZE)),
        inputs=np.zeros((steps, SUBSTEPS, INPUT_SIZE)),
        free=np.zeros((steps, SUBSTEPS, INPUT_SIZE)),
        **motion(steps + 1)._asdict(),
        errors=np.zeros((steps, ATTITUDE.stop)),
    )


class ManifoldFormulation:
    """Plans along the predicted trajectory; keeps the last plan from tick to tick."""

    def __init__(self, config: MpcConfig) -> None:
        self._steps, self._step = config.horizon_steps, config.horizon_step
        self._sampler = TargetSampler(steps=self._steps, substeps=SUBSTEPS, step=self._step)
        lagging = config.rate_time_constant > 0.0 or config.thrust_time_constant > 0.0
        # Without lags rate and throttle are their commands and need no states of their own.
        self._size = STATE_SIZE if lagging else ATTITUDE.stop
        self._stages = HorizonStages.zeros(self._steps, self._size, INPUT_SIZE)
        stages = self._stages
        self._written = (
            stages.A,
            stages.B,
            stages.H,
            stages.g,
            stages.r,
            stages.lower,
            stages.upper,
        )
        self._nothing = np.zeros((self._steps, INPUT_SIZE))
        # The last plan, the one linearised along, and the one tried; they change places.
        self._chosen = _candidate(self._steps)
        self._nominal = _candidate(self._steps)
        self._tried = _candidate(self._steps)
        self._last: tuple[int, float] | None = None  # stamp and cost of the last plan
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over weights and bounds; the last plan stays."""
        self._u_min = np.array([config.throttle_min, *(-w for w in config.omega_max)])
        self._u_max = np.array([config.throttle_max, *config.omega_max])
        stage_weight = np.ones(self._steps)
        stage_weight[-1] = config.terminal_weight
        self._weights = Weights(Q=np.array(config.Q), R=np.array(config.R), stage=stage_weight)
        self._stages.R[:] = config.R

    def pattern(self) -> HorizonPattern:
        """Return the sparsity of the Jacobians and of the cost."""
        n = self._size
        A = np.zeros((STATE_SIZE, STATE_SIZE), dtype=bool)
        A[POSITION, POSITION] = A[POSITION, VELOCITY] = A[VELOCITY, VELOCITY] = _DIAGONAL
        A[:6, 6:] = True
        A[ATTITUDE, 6:12] = True
        A[RATE, RATE] = _DIAGONAL
        A[THROTTLE, THROTTLE] = True
        B = np.zeros((STATE_SIZE, INPUT_SIZE), dtype=bool)
        B[:6] = True
        B[ATTITUDE, 1:] = True
        B[RATE, 1:] = _DIAGONAL
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
        )

    def linearise(self, situation: Situation, window: ReferenceWindow) -> Horizon:
        """Return the horizon along the shifted plan, or along the best start there is."""
        target = self._sampler.sample(
            window,
            situation.stamp_ns,
            model=situation.model,
            disturbance=situation.disturbance,
            u_min=self._u_min,
            u_max=self._u_max,
        )
        problem = self._problem(situation, target)
        cost, iterations = self._start(situation.stamp_ns, problem)
        return self._horizon(situation.stamp_ns, problem, cost, iterations)

    def _horizon(self, stamp_ns: int, problem: _Problem, cost: float, iterations: int) -> Horizon:
        """Return the QP in the change of the nominal plan, whose cost is given."""

        def advance(change: Array, _: Array) -> tuple[Plan, Horizon | None]:
            """Take the step as far as it helps; go on while there is something to gain."""
            better = self._improved(problem, change, cost)
            if better < cost:
                self._chosen, self._tried = self._tried, self._chosen
            else:
                self._chosen, self._nominal = self._nominal, self._chosen
            self._last = (stamp_ns, better)
            again = None
            if iterations > 1 and better < _CONVERGED * cost:
                self._linearise(problem, self._chosen.deviation)
                again = self._horizon(stamp_ns, problem, better, iterations - 1)
            return self._plan(stamp_ns), again

        return Horizon(stages=self._stages, advance=advance, is_deviation=True)

    def _start(self, stamp_ns: int, problem: _Problem) -> tuple[float, int]:
        """Linearise along the best start there is; return its cost and the iterations it needs."""
        if self._last is None:
            return self._linearise(problem, self._nothing), _COLD_ITERATIONS
        last_ns, last_cost = self._last
        elapsed = (stamp_ns - last_ns) * 1e-9 / self._step
        cost = self._linearise(problem, self._chosen.deviation, elapsed)
        if cost <= _JUMP_FACTOR * last_cost + _JUMP_FLOOR:
            return cost, 1
        held_cost = self._linearise(problem, self._nothing)
        if not held_cost < cost:
            self._linearise(problem, self._chosen.deviation, elapsed)
        return min(held_cost, cost), _JUMP_ITERATIONS

    def _linearise(self, problem: _Problem, deviation: Array, elapsed: float = 0.0) -> float:
        """Roll out deviations as they are ``elapsed`` stages later, linearise along; return cost.

        What is rolled out is the nominal plan, and has no defects.
        """
        return _linearise(*problem, deviation, elapsed, *self._nominal, *self._written)

    def _improved(self, problem: _Problem, change: Array, cost: float) -> float:
        """Try the longest of a few steps that lowers the true cost; return what is reached."""
        return _improve(*problem, self._nominal.deviation, change, cost, *self._tried)

    def _problem(self, situation: Situation, target: Target) -> _Problem:
        """Return what plans are judged by.

        One after another: compiled code takes an array in 70 ns, a field of a tuple with names
        in 500.
        """
        return (
            *situation.model,
            *situation.disturbance,
            *situation.motion,
            self._step,
            *target,
            *self._weights,
            self._u_min,
            self._u_max,
        )

    def _plan(self, stamp_ns: int) -> Plan:
        chosen = self._chosen
        return Plan(
            stamp_ns=stamp_ns,
            step=self._step,
            input_step=self._step / SUBSTEPS,
            # Copies: what the plan is made in is used again.
            inputs=chosen.inputs.copy().reshape(-1, INPUT_SIZE),
            p_WB=chosen.p_WB.copy(),
            R_WB=chosen.R_WB.copy(),
        )


_DIAGONAL = np.eye(3, dtype=bool)

_Problem = tuple[
    float, float, float, float, float, float, float,  # Model
    Array, float,  # Disturbance
    Array, Array, Array, Array,  # Motion
    float,
    Array, Array, Array, Array, Array,  # Target
    Array, Array, Array,  # Weights
    Array, Array,
]  # fmt: skip

# How far a command may pass a bound by rounding.
_ROUNDING = 1e-9


@compiled
def _linearise(
    # the model
    a: float,
    b: float,
    c: float,
    drag: float,
    gravity: float,
    thrust_time_constant: float,
    rate_time_constant: float,
    a_W: Array,
    thrust_scale: float,
    # where it begins
    p_WB: Array,
    v_WB_W: Array,
    R_WB: Array,
    actuators: Array,
    step: float,
    # what is to be tracked, and how
    p_target: Array,
    v_target: Array,
    R_target: Array,
    target_inputs: Array,
    mean_inputs: Array,
    Q: Array,
    R: Array,
    stage: Array,
    u_min: Array,
    u_max: Array,
    deviation: Array,
    elapsed: float,
    # the plan made of them
    planned_deviation: Array,
    inputs: Array,
    free: Array,
    p_planned: Array,
    v_planned: Array,
    R_planned: Array,
    actuators_planned: Array,
    errors: Array,
    # its stages
    A: Array,
    B: Array,
    H: Array,
    g: Array,
    r: Array,
    lower: Array,
    upper: Array,
) -> float:
    """Write the QP in the change of a plan shifted by ``elapsed`` stages, and return its cost."""
    model = Model(a, b, c, drag, gravity, thrust_time_constant, rate_time_constant)
    start = Motion(p_WB, v_WB_W, R_WB, actuators)
    target = Target(p_target, v_target, R_target, target_inputs, mean_inputs)
    weights = Weights(Q, R, stage)
    states = Motion(p_planned, v_planned, R_planned, actuators_planned)
    _shift(deviation, elapsed, planned_deviation)
    _bound(target, u_min, u_max, planned_deviation, inputs, free)
    jacobians(model, step, a_W, thrust_scale, inputs, free, start, states, A, B)
    cost = tracking_cost(weights, states, target, planned_deviation, errors)
    quadratic_cost(weights, errors, H, g)
    for i in range(len(r)):
        for k in range(4):
            planned = mean_inputs[i, k] + planned_deviation[i, k]
            r[i, k] = R[k] * planned_deviation[i, k]
            # Nothing changes is always allowed.
            lower[i, k] = min(u_min[k] - planned, 0.0)
            upper[i, k] = max(u_max[k] - planned, 0.0)
    return cost


@compiled
def _improve(
    # the model
    a: float,
    b: float,
    c: float,
    drag: float,
    gravity: float,
    thrust_time_constant: float,
    rate_time_constant: float,
    a_W: Array,
    thrust_scale: float,
    # where it begins
    p_WB: Array,
    v_WB_W: Array,
    R_WB: Array,
    actuators: Array,
    step: float,
    # what is to be tracked, and how
    p_target: Array,
    v_target: Array,
    R_target: Array,
    target_inputs: Array,
    mean_inputs: Array,
    Q: Array,
    R: Array,
    stage: Array,
    u_min: Array,
    u_max: Array,
    deviation: Array,
    change: Array,
    cost: float,
    # the plan made of them
    planned_deviation: Array,
    inputs: Array,
    free: Array,
    p_planned: Array,
    v_planned: Array,
    R_planned: Array,
    actuators_planned: Array,
    errors: Array,
) -> float:
    """Roll out the longest of a few steps that lowers a cost; return the cost reached."""
    model = Model(a, b, c, drag, gravity, thrust_time_constant, rate_time_constant)
    start = Motion(p_WB, v_WB_W, R_WB, actuators)
    target = Target(p_target, v_target, R_target, target_inputs, mean_inputs)
    weights = Weights(Q, R, stage)
    states = Motion(p_planned, v_planned, R_planned, actuators_planned)
    for length in _STEP_LENGTHS:
        for i in range(len(deviation)):
            for k in range(4):
                planned_deviation[i, k] = deviation[i, k] + length * change[i, k]
        _bound(target, u_min, u_max, planned_deviation, inputs, free)
        roll_out(model, step, a_W, thrust_scale, inputs, start, states)
        reached = tracking_cost(weights, states, target, planned_deviation, errors)
        if reached < cost:
            return reached
    return cost


@compiled
def _bound(
    target: Target, u_min: Array, u_max: Array, deviation: Array, inputs: Array, free: Array
) -> None:
    """Bring a plan inside the bounds, and write its inputs.

    A stage's mean input is brought there first, so that some of it is always free.
    """
    steps, substeps = inputs.shape[:2]
    for i in range(steps):
        for k in range(4):
            mean = target.mean_inputs[i, k]
            deviation[i, k] = kernels.clamp(mean + deviation[i, k], u_min[k], u_max[k]) - mean
            for j in range(substeps):
                wanted = target.inputs[i, j, k] + deviation[i, k]
                inputs[i, j, k] = kernels.clamp(wanted, u_min[k], u_max[k])
                free[i, j, k] = 1.0 if abs(inputs[i, j, k] - wanted) < _ROUNDING else 0.0


@compiled
def _shift(inputs: Array, elapsed: float, shifted: Array) -> None:
    """Write inputs (N, 4) as they are ``elapsed`` stages later, the last one held."""
    last = len(inputs) - 1
    elapsed = kernels.clamp(elapsed, 0.0, float(len(inputs)))
    whole = int(elapsed)
    share = elapsed - whole
    for i in range(len(inputs)):
        now, then = min(i + whole, last), min(i + whole + 1, last)
        for k in range(4):
            shifted[i, k] = (1.0 - share) * inputs[now, k] + share * inputs[then, k]
