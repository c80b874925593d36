"""Error-state dynamics of the paper (Eq. 4) as the matrices A and B."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.state import (
    ATTITUDE,
    BODY_RATE,
    INPUT_SIZE,
    POSITION,
    TANGENT_SIZE,
    VELOCITY,
    State,
)
from quad_mpc_ros.model.vehicle import Vehicle


def error_dynamics(
    x: State, vehicle: Vehicle, *, throttle: float, throttle_error: float
) -> tuple[Array, Array]:
    """Return A (9, 9) and B (9, 4) of d x̃/dt = A x̃ + B ũ, x̃ = x_r ⊟ x (paper, after Eq. 4).

    ``throttle`` is s, the throttle in force, and ``throttle_error`` is s̃ = s_r - s. The paper
    drops second-order terms and also -[omega] q̃, which is of first order while the body turns.
    """
    A = np.zeros((TANGENT_SIZE, TANGENT_SIZE))
    A[POSITION, VELOCITY] = x.R_WB
    A[POSITION, ATTITUDE] = -x.R_WB @ so3.hat(x.v_WB_B)
    A[VELOCITY, VELOCITY] = -vehicle.drag * np.eye(3)
    A[VELOCITY, ATTITUDE] = so3.hat(-vehicle.gravity * x.R_WB[2])

    a, b, _ = vehicle.thrust_curve
    slope = vehicle.motor_count * (2.0 * a * throttle_error + 2.0 * a * throttle + b)
    B = np.zeros((TANGENT_SIZE, INPUT_SIZE))
    B[VELOCITY.stop - 1, 0] = slope / vehicle.mass
    B[ATTITUDE, BODY_RATE] = np.eye(3)
    return A, B
