# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The target of a horizon: the reference, and the inputs that hold the reference.

The throttle of these inputs generates the specific force a + R D R' v + g e3 minus lift and
disturbance, against which the attitude tilts. Throttle and rates compensate the actuator lags. The
inputs vary within a stage as the reference does, so that a vehicle on a feasible reference needs
no correction.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3, Vector4
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import inverse_lag
from quad_mpc_ros.control.model.parameters import (
    ModelParameters,
    root_of_thrust,
    throttle_for,
)
from quad_mpc_ros.control.model.reference_window import (
    PointRecord,
    ReferencePoints,
    SampleRecord,
    sample_into,
)
from quad_mpc_ros.control.model.rollout import SUBSTEPS, anisotropic_air, is_anisotropic
from quad_mpc_ros.control.model.state import INPUT_SIZE, U_RATE, U_THROTTLE, Input
from quad_mpc_ros.control.model.vehicle import Vehicle

_TILT_JUMP = 0.05  # rad, in a substep: a larger change of the tilt adds no rates


class TargetStage(Record):
    """The reference over a stage of M substeps."""

    # At its end.
    p_WB: Vector3
    v_WB_W: Vector3
    R_WB: Matrix3
    inputs: Annotated[Array, (SUBSTEPS, INPUT_SIZE)]  # held over the substeps
    mean_input: Vector4


_POINT = PointRecord.dtype


@compiled
def sample_target(
    elapsed_ns: int,
    samples: RecordArray[SampleRecord],
    model: ModelParameters,
    step: float,
    u_min: Array,
    u_max: Array,
    speeds: Array,
    target: RecordArray[TargetStage],
) -> kernels.Matrix:
    """Write the target of stages of ``step`` seconds from ``elapsed_ns`` after a window's stamp.

    ``samples`` are the window's samples, ``u_min`` and ``u_max`` (4,) bound throttle and rates,
    ``speeds`` (N,) are the speeds of the reference's time in each stage, (0,) for real time.
    Returns the attitude at the start of the first stage.
    """
    dt, count = step / SUBSTEPS, len(target) * SUBSTEPS + 1
    times_ns = np.empty(count, np.int64)
    points: Any = np.empty(count, _POINT)
    for k in range(count):
        times_ns[k] = elapsed_ns + np.int64(np.rint(dt * 1e9 * k))
    if len(speeds) > 0:
        path_times(speeds, dt, elapsed_ns, times_ns)
    sample_into(times_ns, samples, points)
    held, tilts = np.empty((count, INPUT_SIZE)), np.empty((count, 3))
    R_start = kernels.matrix(points[0].R_WB)
    for k in range(count):
        point = points[k]
        slowed = (0.0, 0.0, 0.0)
        if len(speeds) > 0:
            slowed = _slow_down(model, speed_at(speeds, k), point)
        R_held, throttle, tilt = _hold(
            model,
            kernels.matrix(point.R_WB),
            kernels.vector(point.v_WB_W),
            kernels.vector(point.a_WB_W),
        )
        tilt = kernels.plus(tilt, slowed)
        if k == 0:
            R_start = R_held
        held[k, U_THROTTLE] = throttle
        kernels.store_vector(tilt, tilts[k])
        for n in range(3):
            held[k, U_RATE + n] = point.w_WB_B[n]
        if k > 0:
            _add_tilt_rates(tilts, R_held, dt, held, k)
        if k > 0 and k % SUBSTEPS == 0:
            stage = target[k // SUBSTEPS - 1]
            kernels.store_vector(kernels.vector(point.p_WB), stage.p_WB)
            kernels.store_vector(kernels.vector(point.v_WB_W), stage.v_WB_W)
            kernels.store_matrix(R_held, stage.R_WB)
    _write_commands(model, dt, held, target, u_min=u_min, u_max=u_max)
    return R_start


@compiled
def path_times(speeds: Array, dt: float, elapsed_ns: int, times_ns: NDArray[np.int64]) -> None:
    """Write the reference's times (n,) at steps of ``dt`` [s], at the speeds of the stages."""
    passed, substeps = 0.0, (len(times_ns) - 1) // len(speeds)
    times_ns[0] = elapsed_ns
    for k in range(1, len(times_ns)):
        passed += dt * 1e9 * speeds[(k - 1) // substeps]
        times_ns[k] = elapsed_ns + np.int64(np.rint(passed))


@compiled
def speed_at(speeds: Array, k: int) -> float:
    """Return the reference's time speed at a substep, interpolated between stage midpoints."""
    place = k / SUBSTEPS - 0.5
    last = len(speeds) - 1
    before = min(max(math.floor(place), 0), last)
    after = min(max(math.floor(place) + 1, 0), last)
    share = place - math.floor(place)
    return float(speeds[before] + share * (speeds[after] - speeds[before]))


@compiled
def _slow_down(model: ModelParameters, speed: float, point: PointRecord) -> kernels.Vector:
    """Scale a point to another speed on its path; return the change of the tilt, in W.

    Velocity and rates scale with the speed, the acceleration with its square.
    """
    if speed == 1.0:
        return 0.0, 0.0, 0.0
    up = 0.0, 0.0, model.gravity
    v, a = kernels.vector(point.v_WB_W), kernels.vector(point.a_WB_W)
    before = kernels.plus(kernels.plus(a, kernels.scaled(model.drag, v)), up)
    v, a = kernels.scaled(speed, v), kernels.scaled(speed * speed, a)
    after = kernels.plus(kernels.plus(a, kernels.scaled(model.drag, v)), up)
    Q = _tilt(before, after)
    kernels.store_vector(v, point.v_WB_W)
    kernels.store_vector(a, point.a_WB_W)
    kernels.store_vector(kernels.scaled(speed, kernels.vector(point.w_WB_B)), point.w_WB_B)
    kernels.store_matrix(kernels.multiply(Q, kernels.matrix(point.R_WB)), point.R_WB)
    return kernels.log(Q)


@compiled
def _write_commands(
    model: ModelParameters,
    dt: float,
    held: Array,
    target: RecordArray[TargetStage],
    u_min: Array,
    u_max: Array,
) -> None:
    """Write the commands that make actuators follow inputs (N M + 1, 4), and their means."""
    rates, torques = model.rate_time_constants, model.torque_time_constants
    lags = model.thrust_time_constant, rates[0], rates[1], rates[2]
    products = 0.0, rates[0] * torques[0], rates[1] * torques[1], rates[2] * torques[2]
    last = len(held) - 2
    for n in range(INPUT_SIZE):
        for i in range(len(target)):
            stage, total = target[i], 0.0
            for j in range(SUBSTEPS):
                k = i * SUBSTEPS + j
                lag = lags[n]
                if n == U_THROTTLE and held[k + 1, n] < held[k, n]:
                    lag = model.thrust_time_constant_down
                command = inverse_lag(lag, dt, held[k, n], held[k + 1, n])
                if products[n] > 0.0:
                    before, after = max(k - 1, 0), min(k + 1, last)
                    change = held[after + 1, n] - held[after, n]
                    change -= held[before + 1, n] - held[before, n]
                    command += products[n] * change / ((after - before) * dt * dt)
                stage.inputs[j, n] = kernels.clamp(command, u_min[n], u_max[n])
                total += stage.inputs[j, n]
            stage.mean_input[n] = total / SUBSTEPS


@compiled
def _hold(
    model: ModelParameters,
    R_WB: kernels.Matrix,
    v_WB_W: kernels.Vector,
    a_WB_W: kernels.Vector,
) -> tuple[kernels.Matrix, float, kernels.Vector]:
    """Return attitude, throttle and tilt in the world that hold a reference.

    The attitude is tilted against the disturbance and the learned drag.
    """
    d_W = kernels.vector(model.a_W)
    x, y, z = kernels.plus(a_WB_W, kernels.scaled(model.drag, v_WB_W))
    force = x, y, z + model.gravity
    if is_anisotropic(model):
        force = kernels.plus(force, kernels.scaled(-1.0, _air(model, R_WB, v_WB_W, force)))
    against = kernels.plus(force, kernels.scaled(-1.0, d_W))
    learned, tilt = kernels.vector(model.learned_drag), (0.0, 0.0, 0.0)
    if learned != (0.0, 0.0, 0.0):
        u = kernels.apply_transposed(R_WB, v_WB_W)
        drag = kernels.apply(R_WB, (learned[0] * u[0], learned[1] * u[1], learned[2] * u[2]))
        force = force[0] - drag[0], force[1] - drag[1], force[2] - drag[2]
    if d_W != (0.0, 0.0, 0.0) or learned != (0.0, 0.0, 0.0):
        Q = _tilt(force, against)
        R_WB, tilt = kernels.multiply(Q, R_WB), kernels.log(Q)
    return R_WB, throttle_for(model, kernels.dot(kernels.column(R_WB, 2), against)), tilt


@compiled
def _air(
    model: ModelParameters, R_WB: kernels.Matrix, v_WB_W: kernels.Vector, force: kernels.Vector
) -> kernels.Vector:
    """Return the anisotropic drag and lift, in the world, that the thrust has to compensate.

    ``force`` is the required thrust without drag and lift, which affect the rotor speed.
    """
    u, speed = kernels.apply_transposed(R_WB, v_WB_W), 0.0
    if not kernels.is_zero(model.rotor_drag):
        along = kernels.dot(kernels.column(R_WB, 2), force)
        still = along - anisotropic_air(model, u, 0.0)[2]
        if still > 0.0:
            root = math.sqrt(model.gravity)
            speed = root_of_thrust(still, 0.5 * model.rotor_drag[2] * u[2] / root) / root
    return kernels.apply(R_WB, anisotropic_air(model, u, speed))


@compiled
def _tilt(before: kernels.Vector, after: kernels.Vector) -> kernels.Matrix:
    """Return the shortest rotation between two directions."""
    none = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    lengths = math.sqrt(kernels.dot(before, before) * kernels.dot(after, after))
    if lengths < 1e-6:
        return none  # no direction
    if kernels.dot(before, after) / lengths < -0.9:
        return none  # the shortest rotation is not unique
    return kernels.shortest_rotation(before, after)


@compiled
def _add_tilt_rates(tilts: Array, R_WB: kernels.Matrix, dt: float, held: Array, k: int) -> None:
    """Add the rate of the tilt to the rates of a substep, and of the first substep."""
    change = kernels.plus(
        kernels.vector(tilts[k]), kernels.scaled(-1.0, kernels.vector(tilts[k - 1]))
    )
    if kernels.dot(change, change) > _TILT_JUMP**2:
        return
    turn = kernels.apply_transposed(R_WB, kernels.scaled(1.0 / dt, change))
    for n in range(3):
        held[k, U_RATE + n] += turn[n]
        if k == 1:
            held[0, U_RATE + n] += turn[n]


def reference_input(reference: ReferencePoints, vehicle: Vehicle) -> Input:
    """Return the input that holds a reference, the paper's u_r, from its acceleration and drag.

    The throttle generates the part of m (a + R D R' v + g) along the reference's thrust axis,
    within the limits of the motors.
    """
    one = ReferencePoints(**{name: each[None] for name, each in vars(reference).items()})
    throttle = float(reference_throttles(one, vehicle)[0])
    return Input(throttle=throttle, w_WB_B=reference.w_WB_B)


def reference_throttles(references: ReferencePoints, vehicle: Vehicle) -> Array:
    """Return the throttles (n,) of :func:`reference_input` at n points."""
    thrust = vehicle.mass * vehicle.specific_thrust(
        a_WB_W=references.a_WB_W, v_WB_W=references.v_WB_W, R_WB=references.R_WB
    )
    return np.array([vehicle.nearest_throttle(each) for each in thrust.tolist()])
