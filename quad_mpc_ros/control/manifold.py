"""The manifold formulation: real-time iteration on SO(3) with actuators and disturbance.

The last plan is shifted by the time that has passed and rolled out from the present state; every
stage is linearised along that trajectory (:mod:`quad_mpc_ros.control.prediction`) and one QP in
the deviations from it is solved. The step is taken as far as it lowers the true cost, so a plan is
never worse than the one it came from; after a jump of the reference the plan that simply holds the
reference's inputs competes with the shifted one, and a few iterations follow.

The cost is the paper's: errors x_r ⊟ x weighted by Q, u_r - u by R, with the velocity in the world
frame, whose norm is the same, and the exact Jacobian of the attitude error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.fallback import tilt_to
from quad_mpc_ros.control.formulation import Horizon, Plan
from quad_mpc_ros.control.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.control.prediction import (
    ATTITUDE,
    INPUT_SIZE,
    POSITION,
    RATE,
    STATE_SIZE,
    THROTTLE,
    VELOCITY,
    Disturbance,
    PredictedState,
    PredictionModel,
    Rollout,
)
from quad_mpc_ros.control.situation import Situation
from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import Array, ReferenceWindow
from quad_mpc_ros.core.reference import ReferencePoints, sample

_STATE_SIZES = np.concatenate((np.repeat([1.0, 3.0, 0.5, 5.0], 3), [0.3]))
_INPUT_SIZES = np.array([0.3, 5.0, 5.0, 5.0])

_COLD_ITERATIONS = 10
_JUMP_ITERATIONS = 4
# A shifted plan whose cost has grown by this much meets a reference that has jumped.
_JUMP_FACTOR, _JUMP_FLOOR = 4.0, 0.1
_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
_CONVERGED = 0.95


@dataclass(frozen=True, kw_only=True, eq=False)
class _Target:
    """The reference along the horizon: states 1 to N, inputs 0 to N-1."""

    points: ReferencePoints
    inputs: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidate:
    """Inputs (N, 4), where they lead, and what that costs; errors are (N, 3) each."""

    inputs: Array
    rollout: Rollout
    cost: float
    position: Array
    velocity: Array
    attitude: Array


class ManifoldFormulation:
    """Plans along the predicted trajectory; keeps the last plan from tick to tick."""

    def __init__(self, config: MpcConfig) -> None:
        self._vehicle = config.vehicle()
        self._steps, self._step = config.horizon_steps, config.horizon_step
        self._model = PredictionModel(
            self._vehicle,
            steps=self._steps,
            step=self._step,
            rate_time_constant=config.rate_time_constant,
            thrust_time_constant=config.thrust_time_constant,
        )
        lagging = config.rate_time_constant > 0.0 or config.thrust_time_constant > 0.0
        # Without lags rate and throttle are their commands and need no states of their own.
        self._size = STATE_SIZE if lagging else ATTITUDE.stop
        self._last: tuple[int, _Candidate] | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over weights and bounds; the last plan stays."""
        self._u_min = np.array([config.throttle_min, *(-w for w in config.omega_max)])
        self._u_max = np.array([config.throttle_max, *config.omega_max])
        self._Q, self._R = np.array(config.Q), np.array(config.R)
        self._stage_weight = np.ones(self._steps)
        self._stage_weight[-1] = config.terminal_weight

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
        x = _predicted_state(situation)
        target = self._target(situation, window)
        start, iterations = self._start(situation, x, target)
        return self._horizon(situation, x, target, start, iterations)

    def _horizon(
        self,
        situation: Situation,
        x: PredictedState,
        target: _Target,
        nominal: _Candidate,
        iterations: int,
    ) -> Horizon:
        def advance(inputs: Array, _: Array) -> tuple[Plan, Horizon | None]:
            """Take the step as far as it helps; go on while there is something to gain."""
            better = self._improved(situation, x, target, nominal, inputs)
            chosen = nominal if better is None else better
            self._last = (situation.stamp_ns, chosen)
            again = None
            if better is not None and iterations > 1 and better.cost < _CONVERGED * nominal.cost:
                again = self._horizon(situation, x, target, better, iterations - 1)
            return self._plan(situation, chosen), again

        return Horizon(stages=self._stages(nominal, target), advance=advance, is_deviation=True)

    def _start(
        self, situation: Situation, x: PredictedState, target: _Target
    ) -> tuple[_Candidate, int]:
        """Return the trajectory to linearise along, and how many iterations it is worth."""
        if self._last is None:
            return self._candidate(situation, x, target, target.inputs), _COLD_ITERATIONS
        last_ns, last = self._last
        elapsed = (situation.stamp_ns - last_ns) * 1e-9 / self._step
        shifted = self._candidate(situation, x, target, _shifted(last.inputs, elapsed))
        if shifted.cost <= _JUMP_FACTOR * last.cost + _JUMP_FLOOR:
            return shifted, 1
        held = self._candidate(situation, x, target, target.inputs)
        return (held if held.cost < shifted.cost else shifted), _JUMP_ITERATIONS

    def _improved(
        self,
        situation: Situation,
        x: PredictedState,
        target: _Target,
        nominal: _Candidate,
        deviation: Array,
    ) -> _Candidate | None:
        """Return the longest of a few steps that lowers the true cost, if one does."""
        for length in _STEP_LENGTHS:
            inputs = np.clip(nominal.inputs + length * deviation, self._u_min, self._u_max)
            candidate = self._candidate(situation, x, target, inputs)
            if candidate.cost < nominal.cost:
                return candidate
        return None

    def _candidate(
        self, situation: Situation, x: PredictedState, target: _Target, inputs: Array
    ) -> _Candidate:
        rollout = self._model.roll_out(x, inputs, situation.disturbance)
        position = rollout.p_WB[1:] - target.points.p_WB
        velocity = rollout.v_WB_W[1:] - target.points.v_WB_W
        R_error = np.swapaxes(target.points.R_WB, -1, -2) @ rollout.R_WB[1:]
        attitude = so3.log(R_error)
        errors = np.hstack((position, velocity, attitude))
        deviation = inputs - target.inputs
        cost = self._stage_weight @ (errors * errors @ self._Q) + np.sum(
            deviation * deviation @ self._R
        )
        return _Candidate(
            inputs=inputs,
            rollout=rollout,
            cost=float(cost),
            position=position,
            velocity=velocity,
            attitude=attitude,
        )

    def _stages(self, nominal: _Candidate, target: _Target) -> HorizonStages:
        """Return the QP in the deviations from a rolled-out plan, which has no defects."""
        n, steps = self._size, self._steps
        A, B = self._model.jacobians(nominal.rollout)
        J = so3.right_jacobian_inverse(nominal.attitude)
        J_weighted = np.swapaxes(J, -1, -2) * self._Q[None, None, ATTITUDE]
        H = np.zeros((steps, STATE_SIZE, STATE_SIZE))
        H[:, range(6), range(6)] = self._Q[:6]
        H[:, ATTITUDE, ATTITUDE] = J_weighted @ J
        g = np.zeros((steps, STATE_SIZE))
        g[:, POSITION] = self._Q[POSITION] * nominal.position
        g[:, VELOCITY] = self._Q[VELOCITY] * nominal.velocity
        g[:, ATTITUDE] = (J_weighted @ nominal.attitude[..., None])[..., 0]
        weight = self._stage_weight
        return HorizonStages(
            x0=np.zeros(n),
            A=A[:, :n, :n],
            B=B[:, :n],
            c=np.zeros((steps, n)),
            H=weight[:, None, None] * H[:, :n, :n],
            g=weight[:, None] * g[:, :n],
            R=self._R,
            r=self._R * (nominal.inputs - target.inputs),
            lower=self._u_min - nominal.inputs,
            upper=self._u_max - nominal.inputs,
        )

    def _target(self, situation: Situation, window: ReferenceWindow) -> _Target:
        """Return reference states at the stages' ends, reference inputs at their middles.

        Attitude and throttle are those that hold the reference against the disturbance.
        """
        ends = situation.stamp_ns + np.rint(
            self._step * 1e9 * np.arange(0.5, self._steps + 0.25, 0.5)
        ).astype(np.int64)
        points = sample(window, ends)
        d = situation.disturbance
        force = points.a_WB_W + self._vehicle.drag * points.v_WB_W
        force[:, 2] += self._vehicle.gravity
        R_WB = _tilted(points.R_WB, force, d)
        force = force - d.a_W
        thrust = self._vehicle.mass * np.einsum("ni,ni->n", R_WB[..., 2], force) / d.thrust_scale
        middles, stages = slice(0, None, 2), slice(1, None, 2)
        inputs = np.column_stack(
            (self._throttles(thrust[middles]), points.w_WB_B[middles]),
        )
        return _Target(
            points=ReferencePoints(
                p_WB=points.p_WB[stages],
                R_WB=R_WB[stages],
                v_WB_W=points.v_WB_W[stages],
                a_WB_W=points.a_WB_W[stages],
                w_WB_B=points.w_WB_B[stages],
            ),
            inputs=np.clip(inputs, self._u_min, self._u_max),
        )

    def _throttles(self, thrusts: Array) -> list[float]:
        vehicle = self._vehicle
        lowest, highest = vehicle.thrust(0.0), vehicle.thrust(1.0)
        return [vehicle.throttle_for(min(max(t, lowest), highest)) for t in thrusts.tolist()]

    def _plan(self, situation: Situation, chosen: _Candidate) -> Plan:
        return Plan(
            stamp_ns=situation.stamp_ns,
            step=self._step,
            inputs=chosen.inputs,
            p_WB=chosen.rollout.p_WB,
            R_WB=chosen.rollout.R_WB,
        )


_DIAGONAL = np.eye(3, dtype=bool)


def _predicted_state(situation: Situation) -> PredictedState:
    x = situation.x
    return PredictedState(
        p_WB=x.p_WB,
        v_WB_W=x.v_WB_W,
        R_WB=x.R_WB,
        w_WB_B=situation.w_WB_B,
        throttle=situation.throttle,
    )


def _shifted(inputs: Array, elapsed: float) -> Array:
    """Return inputs (N, 4) as they are ``elapsed`` stages later, the last one held."""
    count = len(inputs)
    whole = min(int(elapsed), count)
    share = elapsed - int(elapsed) if whole < count else 0.0
    extended = np.vstack((inputs[whole:], np.repeat(inputs[-1:], whole + 1, axis=0)))
    return np.asarray((1.0 - share) * extended[:count] + share * extended[1 : count + 1])


def _tilted(R_WB: Array, force: Array, disturbance: Disturbance) -> Array:
    """Return attitudes tilted so that their thrust, with the disturbance, gives the same force."""
    if not disturbance.a_W.any():
        return R_WB
    return np.stack(
        [
            R @ so3.exp(tilt_to(f - disturbance.a_W, R) - tilt_to(f, R))
            for R, f in zip(R_WB, force, strict=True)
        ]
    )
