"""The manifold formulation's model of the future: rollout and exact discrete Jacobians.

State: position and velocity in the world, attitude R_WB, body rate, throttle; tangent order the
same, 13 in all. Input: commanded throttle and body rate, held over a stage. Rates and throttle
follow their commands with a first-order lag,

    dp/dt = v,  dv/dt = g + (T(s)/m) R_WB e3 - mu v + d,  dR/dt = R [w],
    dw/dt = (w_c - w) / tau_w,  ds/dt = (s_c - s) / tau_s.

A stage is cut into a few substeps. Over a substep the turn is the exact integral of the lagging
rate, and the thrust is that of its mean throttle along the attitude half way. Rate, throttle,
velocity and position are linear in their inputs, so their sums over all substeps are matrices
computed once; only the attitude is a product taken step by step. The Jacobians are those of this
discretisation, exact, with the right Jacobians of SO(3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.core.vehicle import Vehicle

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
RATE = slice(9, 12)
THROTTLE = 12
STATE_SIZE = 13
INPUT_SIZE = 4

SUBSTEPS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedState:
    """Where a horizon starts: world frame but for ``w_WB_B``; shapes (3,), (3, 3), scalar."""

    p_WB: Array
    v_WB_W: Array
    R_WB: Array
    w_WB_B: Array
    throttle: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbance:
    """What the model does not explain: an acceleration (3,) [m/s^2], and the thrust's scale."""

    a_W: Array
    thrust_scale: float


NO_DISTURBANCE = Disturbance(a_W=np.zeros(3), thrust_scale=1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """States 0 to N of a rolled-out plan, and what its Jacobians need of the substeps (N, M).

    ``p_WB``, ``v_WB_W``, ``w_WB_B`` (N+1, 3), ``R_WB`` (N+1, 3, 3), ``throttle`` (N+1,).
    """

    p_WB: Array
    v_WB_W: Array
    R_WB: Array
    w_WB_B: Array
    throttle: Array
    turn: Array
    step_turn: Array
    half_turn: Array
    R_mid: Array
    acceleration_per_thrust: float
    thrust: Array
    thrust_slope: Array


class PredictionModel:
    """Predicts N stages of ``step`` seconds with M substeps each."""

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        steps: int,
        step: float,
        rate_time_constant: float,
        thrust_time_constant: float,
    ) -> None:
        self._vehicle = vehicle
        self._steps, self._step = steps, step
        self._dt = step / SUBSTEPS
        self._rate = _Lag(steps, self._dt, rate_time_constant)
        self._throttle = _Lag(steps, self._dt, thrust_time_constant)
        self._motion = _Motion(steps, self._dt, vehicle.drag)
        self._gravity_W = np.array([0.0, 0.0, -vehicle.gravity])

    def roll_out(self, x: PredictedState, inputs: Array, disturbance: Disturbance) -> Rollout:
        """Return the states that ``inputs`` (N, 4) lead to."""
        n, m = self._steps, SUBSTEPS
        turn = self._dt * self._rate.means(x.w_WB_B, inputs[:, 1:]).reshape(n, m, 3)
        step_turn, half_turn = so3.exp(turn), so3.exp(0.5 * turn)
        R = _cumulative(x.R_WB, step_turn.reshape(n * m, 3, 3))
        R_mid = R[:-1].reshape(n, m, 3, 3) @ half_turn

        mean_throttle = self._throttle.means(x.throttle, inputs[:, 0]).reshape(n, m)
        per_thrust = disturbance.thrust_scale / self._vehicle.mass
        a, b, c = self._vehicle.thrust_curve
        motors = self._vehicle.motor_count
        thrust = motors * ((a * mean_throttle + b) * mean_throttle + c)
        acceleration = (per_thrust * thrust)[..., None] * R_mid[..., 2]
        acceleration += self._gravity_W + disturbance.a_W
        p, v = self._motion.integrate(x.p_WB, x.v_WB_W, acceleration.reshape(n * m, 3))
        return Rollout(
            p_WB=p,
            v_WB_W=v,
            R_WB=R[::m],
            w_WB_B=self._rate.ends(x.w_WB_B, inputs[:, 1:]),
            throttle=self._throttle.ends(x.throttle, inputs[:, 0]),
            turn=turn,
            step_turn=step_turn,
            half_turn=half_turn,
            R_mid=R_mid,
            acceleration_per_thrust=per_thrust,
            thrust=thrust,
            thrust_slope=motors * (2.0 * a * mean_throttle + b),
        )

    def jacobians(self, rollout: Rollout) -> tuple[Array, Array]:
        """Return A (N, 13, 13) and B (N, 13, 4) of every stage along a rollout."""
        n = self._steps
        A, B = np.zeros((n, STATE_SIZE, STATE_SIZE)), np.zeros((n, STATE_SIZE, INPUT_SIZE))
        A[:, POSITION, POSITION] = _EYE
        A[:, POSITION, VELOCITY] = self._motion.position_per_velocity * _EYE
        A[:, VELOCITY, VELOCITY] = self._motion.velocity_per_velocity * _EYE
        A[:, RATE, RATE] = self._rate.decay * _EYE
        A[:, THROTTLE, THROTTLE] = self._throttle.decay
        B[:, RATE, 1:] = (1.0 - self._rate.decay) * _EYE
        B[:, THROTTLE, 0] = 1.0 - self._throttle.decay

        # Sensitivity of the attitude to (attitude, rate, commanded rate) at the stage's start.
        S = np.zeros((n, 3, 9))
        S[:, :, 0:3] = _EYE
        step_back = np.swapaxes(rollout.step_turn, -1, -2)
        half_back = np.swapaxes(rollout.half_turn, -1, -2)
        J_step = so3.right_jacobian(rollout.turn)
        J_half = 0.5 * so3.right_jacobian(0.5 * rollout.turn)
        # d (thrust direction) for a turn of the half-way attitude: -R [e3].
        tilt = -rollout.acceleration_per_thrust * (
            rollout.thrust[..., None, None] * (rollout.R_mid @ _HAT_E3)
        )
        push = (
            rollout.acceleration_per_thrust
            * rollout.thrust_slope[..., None]
            * rollout.R_mid[..., 2]
        )
        for j in range(SUBSTEPS):
            per_rate = self._dt * self._rate.mean_per_start[j]
            per_command = self._dt * self._rate.mean_per_command[j]
            S_mid = half_back[:, j] @ S
            S_mid[:, :, 3:6] += per_rate * J_half[:, j]
            S_mid[:, :, 6:9] += per_command * J_half[:, j]
            d_acceleration = tilt[:, j] @ S_mid
            for rows, weight in (
                (POSITION, self._motion.position_per_acceleration[j]),
                (VELOCITY, self._motion.velocity_per_acceleration[j]),
            ):
                A[:, rows, 6:12] += weight * d_acceleration[:, :, 0:6]
                B[:, rows, 1:] += weight * d_acceleration[:, :, 6:9]
                A[:, rows, THROTTLE] += weight * self._throttle.mean_per_start[j] * push[:, j]
                B[:, rows, 0] += weight * self._throttle.mean_per_command[j] * push[:, j]
            S = step_back[:, j] @ S
            S[:, :, 3:6] += per_rate * J_step[:, j]
            S[:, :, 6:9] += per_command * J_step[:, j]
        A[:, ATTITUDE, 6:12] = S[:, :, 0:6]
        B[:, ATTITUDE, 1:] = S[:, :, 6:9]
        return A, B


_EYE = np.eye(3)
_HAT_E3 = so3.hat([0.0, 0.0, 1.0])


class _Lag:
    """A first-order lag with held inputs: means over substeps and values at stage ends.

    Everything is linear in the value at the start and the commands; a time constant of zero means
    that the command acts at once.
    """

    def __init__(self, steps: int, dt: float, time_constant: float) -> None:
        substep_decay = math.exp(-dt / time_constant) if time_constant > 0.0 else 0.0
        # Mean over a substep of exp(-t / tau).
        share = time_constant * (1.0 - substep_decay) / dt
        self.decay = substep_decay**SUBSTEPS
        self.mean_per_start = share * substep_decay ** np.arange(SUBSTEPS)
        self.mean_per_command = 1.0 - self.mean_per_start

        powers = self.decay ** np.arange(steps + 1)
        self._ends_start = powers
        self._ends_commands = np.zeros((steps + 1, steps))
        for i in range(steps):
            self._ends_commands[i + 1 :, i] = (1.0 - self.decay) * powers[: steps - i]
        starts = self._ends_commands[:-1]
        self._means_start = np.outer(powers[:-1], self.mean_per_start).ravel()
        means = starts[:, None, :] * self.mean_per_start[None, :, None]
        means += np.eye(steps)[:, None, :] * self.mean_per_command[None, :, None]
        self._means_commands = means.reshape(steps * SUBSTEPS, steps)

    def means(self, start: Array | float, commands: Array) -> Array:
        """Return the mean over every substep (N M, ...)."""
        return _outer(self._means_start, start) + self._means_commands @ commands

    def ends(self, start: Array | float, commands: Array) -> Array:
        """Return the values at the stages 0 to N."""
        return _outer(self._ends_start, start) + self._ends_commands @ commands


class _Motion:
    """Position and velocity under linear drag and an acceleration held over each substep."""

    def __init__(self, steps: int, dt: float, drag: float) -> None:
        count = steps * SUBSTEPS
        decay = math.exp(-drag * dt)
        # Integrals over a substep of the velocity's response, by series where drag is small.
        x = drag * dt
        phi1 = dt * (1.0 - x / 2.0 + x * x / 6.0 - x**3 / 24.0 + x**4 / 120.0)
        phi2 = dt * dt * (0.5 - x / 6.0 + x * x / 24.0 - x**3 / 120.0 + x**4 / 720.0)
        V = np.zeros((count + 1, count))
        P = np.zeros((count + 1, count))
        Pv = np.zeros(count + 1)
        for k in range(count):
            V[k + 1] = decay * V[k]
            V[k + 1, k] += phi1
            P[k + 1] = P[k] + phi1 * V[k]
            P[k + 1, k] += phi2
            Pv[k + 1] = Pv[k] + phi1 * decay**k
        self.velocity_per_velocity = decay**SUBSTEPS
        self.position_per_velocity = float(Pv[SUBSTEPS])
        self.velocity_per_acceleration = V[SUBSTEPS, :SUBSTEPS]
        self.position_per_acceleration = P[SUBSTEPS, :SUBSTEPS]
        stages = slice(0, count + 1, SUBSTEPS)
        self._Vv = decay ** np.arange(count + 1)[stages]
        self._Pv, self._V, self._P = Pv[stages], V[stages].copy(), P[stages].copy()

    def integrate(self, p: Array, v: Array, acceleration: Array) -> tuple[Array, Array]:
        """Return positions and velocities (N+1, 3) at the stages."""
        return (
            p + np.outer(self._Pv, v) + self._P @ acceleration,
            np.outer(self._Vv, v) + self._V @ acceleration,
        )


def _outer(factors: NDArray[np.floating], value: Array | float) -> Array:
    return np.asarray(np.multiply.outer(factors, value))


def _cumulative(R: Array, turns: Array) -> Array:
    """Return R, R turns[0], R turns[0] turns[1], … (count + 1, 3, 3)."""
    products = np.empty((len(turns) + 1, 3, 3))
    products[0] = R
    for k, turn in enumerate(turns):
        np.matmul(products[k], turn, out=products[k + 1])
    return products
