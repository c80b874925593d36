"""The paper's formulation, exactly: 9 errors, 4 inputs, A and B frozen over the horizon.

Section 2.3: x̃[i+1] = x̃[i] + dt (A x̃[i] + B ũ[i]) with x̃ = x_r ⊟ x and ũ = u_r - u. The reference
is constant over the horizon.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.reference_window import ReferencePoints, sample
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.model.state import (
    ATTITUDE,
    INPUT_SIZE,
    POSITION,
    TANGENT_SIZE,
    Input,
    State,
    boxminus,
)
from quad_mpc_ros.model.vehicle import Vehicle
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.error_dynamics import error_dynamics
from quad_mpc_ros.ocp.formulation import Horizon, Plan
from quad_mpc_ros.ocp.horizon_qp import HorizonPattern, HorizonStages
from quad_mpc_ros.ocp.situation import Situation

# What a position, velocity, attitude, throttle and rate error of this vehicle typically is.
_STATE_SIZE = np.repeat([1.0, 3.0, 0.5], 3)
_INPUT_SIZE = np.array([0.3, 5.0, 5.0, 5.0])

_EYE = np.eye(TANGENT_SIZE)


class PaperFormulation:
    """Error-state linear MPC as printed; see the module for its one equation."""

    def __init__(self, config: MpcConfig) -> None:
        self._vehicle = config.vehicle()
        self._steps, self._step = config.horizon_steps, config.horizon_step
        self._stages = HorizonStages.zeros(self._steps, TANGENT_SIZE, INPUT_SIZE)
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over weights and bounds."""
        self._u_min = np.array([config.throttle_min, *(-w for w in config.omega_max)])
        self._u_max = np.array([config.throttle_max, *config.omega_max])
        self._stages.H[:] = _stage_weights(config)
        self._stages.R[:] = config.R

    def pattern(self) -> HorizonPattern:
        """Return the sparsity of I + dt A, dt B and the weights."""
        block = np.ones((3, 3), dtype=bool)
        eye, none = np.eye(3, dtype=bool), np.zeros((3, 3), dtype=bool)
        return HorizonPattern(
            steps=self._steps,
            A=np.block([[eye, block, block], [none, eye, block], [none, none, eye]]),
            B=np.vstack((np.zeros((5, 4), dtype=bool), np.eye(4, dtype=bool))),
            H=np.eye(TANGENT_SIZE, dtype=bool),
            state_size=_STATE_SIZE,
            input_size=_INPUT_SIZE,
        )

    def linearise(self, situation: Situation, window: ReferenceWindow) -> Horizon:
        """Return the paper's problem for the reference of now, held over the horizon."""
        x, throttle = situation.x, situation.throttle_sent
        reference = sample(window, situation.stamp_ns)
        u_reference = reference_input(reference, self._vehicle).vector()
        A, B = error_dynamics(
            x, self._vehicle, throttle=throttle, throttle_error=u_reference[0] - throttle
        )
        dt, stages = self._step, self._stages
        stages.x0[:] = boxminus(_state_of(reference), x)
        stages.A[:] = _EYE + dt * A
        stages.B[:] = dt * B
        # The bounds hold on u = u_r - ũ; the paper prints them on ũ, which cannot climb.
        stages.lower[:] = u_reference - self._u_max
        stages.upper[:] = u_reference - self._u_min

        def advance(inputs: Array, states: Array) -> tuple[Plan, None]:
            """Take the errors off the reference; the paper solves once."""
            errors = np.vstack((stages.x0, states))
            plan = Plan(
                stamp_ns=situation.stamp_ns,
                step=dt,
                input_step=dt,
                inputs=np.clip(u_reference - inputs, self._u_min, self._u_max),
                p_WB=reference.p_WB - errors[:, POSITION],
                R_WB=reference.R_WB @ so3.exp(-errors[:, ATTITUDE]),
            )
            return plan, None

        return Horizon(stages=stages, advance=advance)


def reference_input(reference: ReferencePoints, vehicle: Vehicle) -> Input:
    """Return the input that holds the reference (paper, u_r), from its acceleration and drag.

    The throttle carries the part of m (a + mu v + g) along the reference's thrust axis, as far as
    the motors can.
    """
    specific_force = reference.a_WB_W + vehicle.drag * reference.v_WB_W
    specific_force[2] += vehicle.gravity
    thrust = vehicle.mass * float(reference.R_WB[:, 2] @ specific_force)
    return Input(throttle=vehicle.nearest_throttle(thrust), w_WB_B=reference.w_WB_B)


def _state_of(reference: ReferencePoints) -> State:
    return State(p_WB=reference.p_WB, v_WB_B=reference.v_WB_B, R_WB=reference.R_WB)


def _stage_weights(config: MpcConfig) -> Array:
    """Return Q for the states 1 to N, (N, 9, 9), the last one times the terminal weight."""
    weights = np.repeat(np.diag(config.Q)[None], config.horizon_steps, axis=0)
    weights[-1] *= config.terminal_weight
    return weights
