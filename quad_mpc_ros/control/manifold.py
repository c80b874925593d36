"""The manifold formulation: real-time iteration on SO(3) with actuators and disturbance.

The plan is made of deviations from the inputs that hold the reference, one a stage. The last plan
is shifted by the time that has passed and rolled out from the present state; every stage is
linearised along that trajectory (:mod:`quad_mpc_ros.control.prediction`) and one QP in the change
of the plan is solved. The step is taken as far as it lowers the true cost, so a plan is never
worse than the one it came from; after a jump of the reference the plan that simply holds the
reference's inputs competes with the shifted one, and a few iterations follow.

The cost is the paper's: errors x_r ⊟ x weighted by Q, u_r - u by R, with the velocity in the world
frame, whose norm is the same, and the exact Jacobian of the attitude error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.formulation import Horizon, Plan
from quad_mpc_ros.control.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.control.prediction import (
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
from quad_mpc_ros.control.situation import Situation
from quad_mpc_ros.control.target import Target, TargetSampler
from quad_mpc_ros.control.tracking_cost import Weights, quadratic_cost, tracking_cost
from quad_mpc_ros.core.compiled import compiled
from quad_mpc_ros.core.messages import Array, ReferenceWindow

_STATE_SIZES = np.concatenate((np.repeat([1.0, 3.0, 0.5, 5.0], 3), [0.3]))
_INPUT_SIZES = np.array([0.3, 5.0, 5.0, 5.0])

_COLD_ITERATIONS = 5
_JUMP_ITERATIONS = 3
# A shifted plan whose cost has grown by this much meets a reference that has jumped.
_JUMP_FACTOR, _JUMP_FLOOR = 4.0, 0.1
_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
_CONVERGED = 0.95


class _Candidate(NamedTuple):
    """A plan, where it leads, and what that costs.

    ``deviation`` (N, 4) from the reference's inputs, ``inputs`` (N, M, 4) inside the bounds,
    ``free`` (N, M, 4) zero where a bound holds them, ``states`` 0 to N, ``errors`` (N, 9).
    """

    deviation: Array
    inputs: Array
    free: Array
    states: Motion
    errors: Array
    cost: float


class ManifoldFormulation:
    """Plans along the predicted trajectory; keeps the last plan from tick to tick."""

    def __init__(self, config: MpcConfig) -> None:
        self._steps, self._step = config.horizon_steps, config.horizon_step
        self._sampler = TargetSampler(steps=self._steps, substeps=SUBSTEPS, step=self._step)
        lagging = config.rate_time_constant > 0.0 or config.thrust_time_constant > 0.0
        # Without lags rate and throttle are their commands and need no states of their own.
        self._size = STATE_SIZE if lagging else ATTITUDE.stop
        self._stages = HorizonStages.zeros(self._steps, self._size, INPUT_SIZE)
        self._last: tuple[int, _Candidate] | None = None
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
        start, iterations = self._start(situation, target)
        return self._horizon(situation, target, start, iterations)

    def _horizon(
        self, situation: Situation, target: Target, nominal: _Candidate, iterations: int
    ) -> Horizon:
        def advance(change: Array, _: Array) -> tuple[Plan, Horizon | None]:
            """Take the step as far as it helps; go on while there is something to gain."""
            better = self._improved(situation, target, nominal, change)
            chosen = nominal if better is None else better
            self._last = (situation.stamp_ns, chosen)
            again = None
            if better is not None and iterations > 1 and better.cost < _CONVERGED * nominal.cost:
                again = self._horizon(situation, target, better, iterations - 1)
            return self._plan(situation, chosen), again

        return Horizon(
            stages=self._linearised(situation, target, nominal),
            advance=advance,
            is_deviation=True,
        )

    def _start(self, situation: Situation, target: Target) -> tuple[_Candidate, int]:
        """Return the plan to linearise along, and how many iterations it is worth."""
        nothing = np.zeros((self._steps, INPUT_SIZE))
        if self._last is None:
            return self._candidate(situation, target, nothing), _COLD_ITERATIONS
        last_ns, last = self._last
        elapsed = (situation.stamp_ns - last_ns) * 1e-9 / self._step
        shifted = self._candidate(situation, target, _shifted(last.deviation, elapsed))
        if shifted.cost <= _JUMP_FACTOR * last.cost + _JUMP_FLOOR:
            return shifted, 1
        held = self._candidate(situation, target, nothing)
        return (held if held.cost < shifted.cost else shifted), _JUMP_ITERATIONS

    def _improved(
        self, situation: Situation, target: Target, nominal: _Candidate, change: Array
    ) -> _Candidate | None:
        """Return the longest of a few steps that lowers the true cost, if one does."""
        for length in _STEP_LENGTHS:
            candidate = self._candidate(situation, target, nominal.deviation + length * change)
            if candidate.cost < nominal.cost:
                return candidate
        return None

    def _candidate(self, situation: Situation, target: Target, deviation: Array) -> _Candidate:
        inputs, free = np.empty_like(target.inputs), np.empty_like(target.inputs)
        states, errors = motion(self._steps + 1), np.empty((self._steps, ATTITUDE.stop))
        cost = _evaluate(
            situation.model,
            self._step,
            situation.disturbance.a_W,
            situation.disturbance.thrust_scale,
            situation.motion,
            target,
            self._weights,
            self._u_min,
            self._u_max,
            deviation,
            inputs,
            free,
            states,
            errors,
        )
        return _Candidate(
            deviation=deviation,
            inputs=inputs,
            free=free,
            states=states,
            errors=errors,
            cost=cost,
        )

    def _linearised(
        self, situation: Situation, target: Target, nominal: _Candidate
    ) -> HorizonStages:
        """Return the QP in the change of a rolled-out plan, which has no defects."""
        stages = self._stages
        _linearise(
            situation.model,
            self._step,
            situation.disturbance.a_W,
            situation.disturbance.thrust_scale,
            nominal.inputs,
            nominal.free,
            nominal.states,
            nominal.errors,
            nominal.deviation,
            target,
            self._weights,
            self._u_min,
            self._u_max,
            stages.A,
            stages.B,
            stages.H,
            stages.g,
            stages.r,
            stages.lower,
            stages.upper,
        )
        return stages

    def _plan(self, situation: Situation, chosen: _Candidate) -> Plan:
        return Plan(
            stamp_ns=situation.stamp_ns,
            step=self._step,
            input_step=self._step / SUBSTEPS,
            inputs=chosen.inputs.reshape(-1, INPUT_SIZE),
            p_WB=chosen.states.p_WB,
            R_WB=chosen.states.R_WB,
        )


_DIAGONAL = np.eye(3, dtype=bool)


# How far a command may pass a bound by rounding.
_ROUNDING = 1e-9


@compiled
def _evaluate(
    model: Model,
    step: float,
    a_W: Array,
    thrust_scale: float,
    start: Motion,
    target: Target,
    weights: Weights,
    u_min: Array,
    u_max: Array,
    deviation: Array,
    inputs: Array,
    free: Array,
    states: Motion,
    errors: Array,
) -> float:
    """Roll a plan out inside the bounds and return its cost.

    A stage's mean input is brought inside the bounds first, so that some of it is always free.
    """
    steps, substeps = inputs.shape[:2]
    for i in range(steps):
        for k in range(4):
            mean = target.mean_inputs[i, k]
            deviation[i, k] = min(max(mean + deviation[i, k], u_min[k]), u_max[k]) - mean
            for j in range(substeps):
                wanted = target.inputs[i, j, k] + deviation[i, k]
                inputs[i, j, k] = min(max(wanted, u_min[k]), u_max[k])
                free[i, j, k] = 1.0 if abs(inputs[i, j, k] - wanted) < _ROUNDING else 0.0
    roll_out(model, step, a_W, thrust_scale, inputs, start, states)
    return tracking_cost(weights, states, target, deviation, errors)


@compiled
def _linearise(
    model: Model,
    step: float,
    a_W: Array,
    thrust_scale: float,
    inputs: Array,
    free: Array,
    states: Motion,
    errors: Array,
    deviation: Array,
    target: Target,
    weights: Weights,
    u_min: Array,
    u_max: Array,
    A: Array,
    B: Array,
    H: Array,
    g: Array,
    r: Array,
    lower: Array,
    upper: Array,
) -> None:
    """Write the QP in the change of a plan; nothing changes is always allowed."""
    jacobians(model, step, a_W, thrust_scale, inputs, free, states, A, B)
    quadratic_cost(weights, errors, H, g)
    for i in range(len(deviation)):
        for k in range(4):
            planned = target.mean_inputs[i, k] + deviation[i, k]
            r[i, k] = weights.R[k] * deviation[i, k]
            lower[i, k] = min(u_min[k] - planned, 0.0)
            upper[i, k] = max(u_max[k] - planned, 0.0)


@compiled
def _shifted(inputs: Array, elapsed: float) -> Array:
    """Return inputs (N, 4) as they are ``elapsed`` stages later, the last one held.

    A time before the plan, of a clock that was set back, is its beginning: there is no other.
    """
    last = len(inputs) - 1
    elapsed = min(max(elapsed, 0.0), float(len(inputs)))
    whole = int(elapsed)
    share = elapsed - whole
    shifted = np.empty_like(inputs)
    for i in range(len(inputs)):
        now, then = min(i + whole, last), min(i + whole + 1, last)
        for k in range(4):
            shifted[i, k] = (1.0 - share) * inputs[now, k] + share * inputs[then, k]
    return shifted
