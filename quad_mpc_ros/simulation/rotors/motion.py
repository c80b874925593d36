# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The motion of the plant ``rotors`` at constant command and wind, compiled.

Runge-Kutta steps of order 4 integrate the equations between two runs of the rate loop. The ground
is at height 0.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.plant import Measured, PlantInputs
from quad_mpc_ros.simulation.rotors.craft import (
    BodyState,
    Craft,
    Rotor,
    add,
    on_ground,
    origin_height,
    put,
    rotation_of,
)
from quad_mpc_ros.simulation.rotors.equations import Outside, derivative

_BODY = BodyState.dtype


class RotorInputs(PlantInputs):
    """Constant inputs of the vehicle."""

    external_force_W: Vector3  # force at the centre of mass [N]


@compiled
def is_on_ground(body: RecordArray[BodyState], craft: RecordArray[Craft]) -> bool:
    """Whether the body is at rest on the ground."""
    return on_ground(body[()], kernels.vector(craft[()].center_B))


@compiled
def coast(
    body: RecordArray[BodyState],
    speeds: Array,
    wanted: Array,
    inputs: RecordArray[RotorInputs],
    craft: RecordArray[Craft],
    rotors: RecordArray[Rotor],
    duration_ns: int,
) -> None:
    """Advance body and speeds (n,) at constant commanded speeds (n,), above the ground."""
    outside = kernels.vector(inputs[()].wind_W), kernels.vector(inputs[()].external_force_W)
    x, center_B = body[()], kernels.vector(craft[()].center_B)
    steps = -(-duration_ns // craft[()].longest_step_ns)
    duration = duration_ns * 1e-9 / steps
    before = np.empty((), _BODY)
    for _ in range(steps):
        was_on_ground = on_ground(x, center_B)
        before[()] = x
        runge_kutta(body, speeds, wanted, outside, craft=craft, rotors=rotors, duration=duration)
        above = origin_height(x, center_B) > 0.0
        if was_on_ground and not (above and x.v_WC_W[2] > 0.0):  # not lifted off
            used = x.charge_used
            body[()] = before[()]
            x.charge_used = used
        elif not above:
            _land(x, center_B)


@compiled
def runge_kutta(
    body: RecordArray[BodyState],
    speeds: Array,
    wanted: Array,
    outside: Outside,
    craft: RecordArray[Craft],
    rotors: RecordArray[Rotor],
    duration: float,
) -> None:
    """Advance body and speeds (n,) in free flight by one Runge-Kutta step of order 4 [s]."""
    bodies, rows = np.zeros(3, _BODY), np.zeros((3, speeds.shape[0]))
    rate, at, mean = bodies[0], bodies[1], bodies[2]
    accelerations, at_speeds, mean_accelerations = rows[0], rows[1], rows[2]
    bodies[1], at_speeds[:] = body[()], speeds
    for stage in range(4):
        derivative(
            at,
            at_speeds,
            wanted,
            outside,
            craft=craft[()],
            rotors=rotors,
            rate=rate,
            accelerations=accelerations,
        )
        weight = (1.0 if stage in (0, 3) else 2.0) / 6.0
        ahead = 0.5 * duration if stage < 2 else duration
        add(mean, mean_accelerations, weight, rate, accelerations)
        bodies[1], at_speeds[:] = body[()], speeds
        add(at, at_speeds, ahead, rate, accelerations)
    x = body[()]
    add(x, speeds, duration, mean, mean_accelerations)
    square = 0.0
    for k in range(4):
        square += x.q_WB_xyzw[k] * x.q_WB_xyzw[k]
    length = math.sqrt(square)
    for k in range(4):
        x.q_WB_xyzw[k] /= length


@compiled
def measure(
    body: RecordArray[BodyState], craft: RecordArray[Craft], out: RecordArray[Measured]
) -> None:
    """Write the true motion of the body's origin."""
    x, measured = body[()], out[()]
    R_WB, w = rotation_of(x), kernels.vector(x.w_WB_B)
    to_origin = kernels.scaled(-1.0, kernels.vector(craft[()].center_B))
    p = kernels.plus(kernels.vector(x.p_WC), kernels.apply(R_WB, to_origin))
    v = kernels.apply_transposed(R_WB, kernels.vector(x.v_WC_W))
    kernels.store_vector(p, measured.p_WB)
    kernels.store_quaternion(kernels.quaternion(R_WB), measured.q_WB_xyzw)
    kernels.store_vector(kernels.plus(v, kernels.cross(w, to_origin)), measured.v_WB_B)
    kernels.store_vector(w, measured.w_WB_B)


@compiled
def _land(x: BodyState, center_B: kernels.Vector) -> None:
    """Set the state after a touchdown: at rest, level, same heading."""
    R_WB = rotation_of(x)
    cosine, sine, _ = kernels.column(R_WB, 0)
    half_yaw = 0.5 * math.atan2(sine, cosine)
    origin = kernels.minus(kernels.vector(x.p_WC), kernels.apply(R_WB, center_B))
    kernels.store_quaternion((0.0, 0.0, math.sin(half_yaw), math.cos(half_yaw)), x.q_WB_xyzw)
    x.v_WC_W[:] = 0.0
    x.w_WB_B[:] = 0.0
    put(x, (origin[0], origin[1], 0.0), center_B)
