# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Continuous dynamics of the plant ``internal``: paper and true rigid body, compiled.

The model of the controller (``control/model/rollout.py``) is implemented independently.

World ENU, body FLU: gravity is -g along world z and thrust is along +z of the body. The paper
writes NED/FRD, where both signs flip. Velocity is in body axes, as in the paper.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import kernels


class VehicleConstants(Record):
    """The numbers of the plant ``internal``."""

    is_rigid_body: int  # 0 for the paper's Eq. (3)
    gravity: float  # m/s^2
    lift: Vector3  # thrust over mass, a polynomial of the throttle, highest power first [m/s^2]
    thrust_time_constant: float  # s
    thrust_time_constant_down: float  # s, while the throttle decreases
    rate_time_constant: Vector3  # s
    torque_time_constant: Vector3  # s
    angular_acceleration_max: Vector3  # rad/s^2
    drag: Vector3  # 1/s
    rotor_drag: Vector3  # 1/s
    translational_lift: float  # 1/m


Drive = tuple[float, kernels.Vector]
"""Specific thrust along body z [m/s^2], and body rates [rad/s]."""

DrivenStep = tuple[Drive, Drive, Drive, kernels.Matrix, kernels.Matrix]
"""Drive at start, middle and end of a step, and rotations over its first and second half."""


@compiled
def paper_dynamics(
    v_WB_B: kernels.Vector,
    R_WB: kernels.Matrix,
    drive: Drive,
    vehicle: VehicleConstants,
    wind_W: kernels.Vector,
) -> kernels.Vector:
    """Return dv/dt of Eq. (3) literally, without the transport term of rotating axes.

    Drag and translational lift depend on the velocity relative to the air. Rotor drag is
    proportional to the rotors' speed, which is proportional to the root of the thrust.
    """
    lift, _ = drive
    gravity, drag, rotor_drag = vehicle.gravity, vehicle.drag, vehicle.rotor_drag
    rotor_speed = math.sqrt(max(lift, 0.0) / gravity)
    wind_B = kernels.apply_transposed(R_WB, wind_W)
    u, v, w = v_WB_B[0] - wind_B[0], v_WB_B[1] - wind_B[1], v_WB_B[2] - wind_B[2]
    up_B = kernels.column(kernels.transposed(R_WB), 2)
    translational_lift = vehicle.translational_lift * (u * u + v * v)
    return (
        -gravity * up_B[0] - (drag[0] + rotor_speed * rotor_drag[0]) * u,
        -gravity * up_B[1] - (drag[1] + rotor_speed * rotor_drag[1]) * v,
        lift
        + translational_lift
        - gravity * up_B[2]
        - (drag[2] + rotor_speed * rotor_drag[2]) * w,
    )


@compiled
def dynamics(
    v_WB_B: kernels.Vector,
    R_WB: kernels.Matrix,
    drive: Drive,
    vehicle: VehicleConstants,
    wind_W: kernels.Vector,
) -> tuple[kernels.Vector, kernels.Vector]:
    """Return dp/dt in the world and dv/dt in the body, with the selected dynamics.

    The rigid body adds the transport term -omega x v to Eq. (3).
    """
    rate = paper_dynamics(v_WB_B, R_WB, drive, vehicle, wind_W)
    if vehicle.is_rigid_body != 0:
        rate = kernels.plus(rate, kernels.cross(v_WB_B, drive[1]))
    return kernels.apply(R_WB, v_WB_B), rate


@compiled
def integrated(
    p_WB: kernels.Vector,
    v_WB_B: kernels.Vector,
    R_WB: kernels.Matrix,
    course: DrivenStep,
    vehicle: VehicleConstants,
    wind_W: kernels.Vector,
    duration: float,
) -> tuple[kernels.Vector, kernels.Vector, kernels.Matrix]:
    """Return position, velocity and rotation after one Runge-Kutta step of order 4 [s].

    The attitude follows the rotations of the ``course``, which are exact at constant body rates.
    """
    start, middle, end, first_turn, second_turn = course
    R_half = kernels.multiply(R_WB, first_turn)
    R_full = kernels.multiply(R_half, second_turn)
    half = 0.5 * duration
    p1, v1 = dynamics(v_WB_B, R_WB, start, vehicle, wind_W)
    p2, v2 = dynamics(_moved(v_WB_B, v1, half), R_half, middle, vehicle, wind_W)
    p3, v3 = dynamics(_moved(v_WB_B, v2, half), R_half, middle, vehicle, wind_W)
    p4, v4 = dynamics(_moved(v_WB_B, v3, duration), R_full, end, vehicle, wind_W)
    return (
        _moved(p_WB, _weighted(p1, p2, p3, p4), duration),
        _moved(v_WB_B, _weighted(v1, v2, v3, v4), duration),
        R_full,
    )


@compiled
def _moved(x: kernels.Vector, rate: kernels.Vector, duration: float) -> kernels.Vector:
    return kernels.plus(x, kernels.scaled(duration, rate))


@compiled
def _weighted(
    k1: kernels.Vector, k2: kernels.Vector, k3: kernels.Vector, k4: kernels.Vector
) -> kernels.Vector:
    """Return the mean of a step's four rates, weighted by 1:2:2:1."""
    outer, inner = kernels.plus(k1, k4), kernels.plus(k2, k3)
    return kernels.scaled(1.0 / 6.0, kernels.plus(outer, kernels.scaled(2.0, inner)))
