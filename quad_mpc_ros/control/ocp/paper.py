# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's formulation, exactly: 9 errors, 4 inputs, A and B frozen over the horizon.

    min   sum_{i=0..N} x̃[i]' Q x̃[i] + sum_{i=0..N-1} ũ[i]' R ũ[i]            (section 2.3)
    s.t.  x̃[i+1] = x̃[i] + dt (A x̃[i] + B ũ[i]),   x̃ = x_r ⊟ x,   ũ = u_r - u

with A and B of the error dynamics (Eq. 4), and the reference constant over the horizon.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.model.state import (
    ATTITUDE,
    BODY_RATE,
    INPUT_SIZE,
    POSITION,
    TANGENT_SIZE,
    U_THROTTLE,
    VELOCITY,
    State,
    boxminus,
)
from quad_mpc_ros.control.model.target import reference_input
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.ocp.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.control.ocp.plan import Plan

# Typical errors of position, velocity and attitude, and of throttle and rates.
_STATE_SIZE = np.repeat([1.0, 3.0, 0.5], 3)
_INPUT_SIZE = np.array([0.3, 5.0, 5.0, 5.0])

_EYE, _EYE_3 = np.eye(TANGENT_SIZE), np.eye(3)


class PaperProblem:
    """Error-state linear MPC as printed: one iteration of the SQP loop, and a full step."""

    is_deviation = False
    has_progress_state = False

    def __init__(self, config: MpcConfig) -> None:
        self._vehicle = config.vehicle()
        self._steps, self._step = config.horizon_steps, config.horizon_step
        self._stages = HorizonStages.zeros(self._steps, TANGENT_SIZE, INPUT_SIZE)
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply weights and bounds."""
        self._u_min = np.array([config.throttle_min, *(-w for w in config.omega_max)])
        self._u_max = np.array([config.throttle_max, *config.omega_max])
        self._stages.H[:] = np.diag(config.Q)
        self._stages.H[-1] *= config.terminal_weight
        self._stages.R[:] = config.R

    def pattern(self, *, constrained: bool = False) -> HorizonPattern:
        """Return the sparsity of I + dt A, dt B and the weights."""
        block = np.ones((3, 3), dtype=bool)
        eye, none = np.eye(3, dtype=bool), np.zeros((3, 3), dtype=bool)
        pushed = np.zeros((6, 4), dtype=bool)
        pushed[VELOCITY.stop - 1, U_THROTTLE] = True
        return HorizonPattern(
            steps=self._steps,
            A=np.block([[eye, block, block], [none, eye, block], [none, none, eye]]),
            B=np.vstack((pushed, np.eye(3, 4, 1, dtype=bool))),
            H=np.eye(TANGENT_SIZE, dtype=bool),
            state_size=_STATE_SIZE,
            input_size=_INPUT_SIZE,
        )

    def begin(
        self, state: PredictedState, window: ReferenceWindow, corridor: Corridor | None = None
    ) -> None:
        """Take the current reference, held over the horizon: no warm start is needed."""
        self._stamp_ns = state.stamp_ns
        self._x, self._throttle = state.x, float(state.sent[U_THROTTLE])
        points = sample(window, state.stamp_ns)
        self._x_reference = State(p_WB=points.p_WB, v_WB_B=points.v_WB_B, R_WB=points.R_WB)
        self._u_reference = reference_input(points, self._vehicle).vector()

    def linearise(self) -> HorizonStages:
        """Return the paper's problem, with A and B at the current state and input."""
        x, throttle, u_reference = self._x, self._throttle, self._u_reference
        A, B = error_dynamics(
            x, self._vehicle, throttle=throttle, throttle_error=u_reference[U_THROTTLE] - throttle
        )
        dt, stages = self._step, self._stages
        stages.x0[:] = boxminus(self._x_reference, x)
        stages.A[:] = _EYE + dt * A
        stages.B[:] = dt * B
        # The bounds hold on u = u_r - ũ; the paper prints them on ũ, which cannot climb.
        stages.lower[:] = u_reference - self._u_max
        stages.upper[:] = u_reference - self._u_min
        return stages

    def line_search(self, inputs: Array, states: Array) -> tuple[Plan, bool]:
        """Return the reference minus the errors, and True: no further step.

        ``inputs`` (N, 4) and ``states`` 1 to N (N, 9) are the QP's solution.
        """
        reference, errors = self._x_reference, np.vstack((self._stages.x0, states))
        plan = Plan(
            stamp_ns=self._stamp_ns,
            step=self._step,
            input_step=self._step,
            inputs=np.clip(self._u_reference - inputs, self._u_min, self._u_max),
            p_WB=reference.p_WB - errors[:, POSITION],
            R_WB=reference.R_WB @ so3.exp(-errors[:, ATTITUDE]),
        )
        return plan, True


def error_dynamics(
    x: State, vehicle: Vehicle, *, throttle: float, throttle_error: float
) -> tuple[Array, Array]:
    """Return A (9, 9) and B (9, 4) of d x̃/dt = A x̃ + B ũ, x̃ = x_r ⊟ x (paper, after Eq. 4).

    ``throttle`` is s, the current throttle, and ``throttle_error`` is s̃ = s_r - s. The paper
    drops second-order terms and also -[omega] q̃, which is of first order while the body turns.
    """
    A = np.zeros((TANGENT_SIZE, TANGENT_SIZE))
    A[POSITION, VELOCITY] = x.R_WB
    A[POSITION, ATTITUDE] = -x.R_WB @ so3.hat(x.v_WB_B)
    A[VELOCITY, VELOCITY] = -np.diag(per_axis(vehicle.drag))
    A[VELOCITY, ATTITUDE] = so3.hat(-vehicle.gravity * x.R_WB[2])

    a, b, _ = vehicle.thrust_curve
    slope = vehicle.motor_count * (2.0 * a * throttle_error + 2.0 * a * throttle + b)
    B = np.zeros((TANGENT_SIZE, INPUT_SIZE))
    B[VELOCITY.stop - 1, U_THROTTLE] = slope / vehicle.mass
    B[ATTITUDE, BODY_RATE] = _EYE_3
    return A, B
