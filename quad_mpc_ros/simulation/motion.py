"""The motion of the internal plant at constant command and wind, compiled.

One call advances any number of steps: actuators, equations of motion, ground.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.simulation.actuators import BodyRates, later_rates, later_throttle, thrust_at
from quad_mpc_ros.simulation.dynamics import integrated
from quad_mpc_ros.simulation.records import Measured, PlantInputs, VehicleConstants


class VehicleState(Record):
    """The state of the vehicle and its actuators."""

    p_WB: Vector3  # m
    v_WB_B: Vector3  # m/s
    R_WB: Matrix3
    throttle: float  # that makes the thrust
    w_WB_B: Vector3  # rad/s
    angular_acceleration: Vector3  # rad/s^2, with a rate loop of second order


@compiled
def advance(
    state: RecordArray[VehicleState],
    inputs: RecordArray[PlantInputs],
    vehicle: RecordArray[VehicleConstants],
    steps: int,
    duration: float,
) -> None:
    """Advance a state by steps of equal ``duration`` [s] under constant inputs."""
    x, u_in, numbers = state[()], inputs[()], vehicle[()]
    gravity, lift = numbers.gravity, kernels.vector(numbers.lift)
    wind_W, command, half = (
        kernels.vector(u_in.wind_W),
        kernels.vector(u_in.w_WB_B),
        0.5 * duration,
    )
    p, v, R = kernels.vector(x.p_WB), kernels.vector(x.v_WB_B), kernels.matrix(x.R_WB)
    rates = BodyRates(kernels.vector(x.w_WB_B), kernels.vector(x.angular_acceleration))
    throttle = x.throttle
    lag = numbers.thrust_time_constant
    if u_in.throttle < throttle:
        lag = numbers.thrust_time_constant_down
    for _ in range(steps):
        start = thrust_at(throttle, lift), rates.w
        throttle = later_throttle(throttle, u_in.throttle, lag, half)
        rates, first_turn = later_rates(rates, command, numbers, half)
        middle = thrust_at(throttle, lift), rates.w
        throttle = later_throttle(throttle, u_in.throttle, lag, half)
        rates, second_turn = later_rates(rates, command, numbers, half)
        end = thrust_at(throttle, lift), rates.w
        if _on_ground(p, v) and max(start[0], end[0]) <= gravity:
            rates = _held(rates, numbers)  # the ground prevents rotation
            continue
        course = start, middle, end, first_turn, second_turn
        p, v, R = integrated(
            p, v, R, course=course, vehicle=numbers, wind_W=wind_W, duration=duration
        )
        if not (p[2] > 0.0 or (p[2] == 0.0 and kernels.apply(R, v)[2] > 0.0)):
            p, v, R = _landed(p, R)
            rates = _held(rates, numbers)
    kernels.store_vector(p, x.p_WB)
    kernels.store_vector(v, x.v_WB_B)
    kernels.store_matrix(R, x.R_WB)
    x.throttle = throttle
    kernels.store_vector(rates.w, x.w_WB_B)
    kernels.store_vector(rates.acceleration, x.angular_acceleration)


@compiled
def measure(state: RecordArray[VehicleState], out: RecordArray[Measured]) -> None:
    """Write the true motion, without rotation on the ground."""
    x, measured = state[()], out[()]
    p, v = kernels.vector(x.p_WB), kernels.vector(x.v_WB_B)
    kernels.store_vector(p, measured.p_WB)
    kernels.store_quaternion(kernels.quaternion(kernels.matrix(x.R_WB)), measured.q_WB_xyzw)
    kernels.store_vector(v, measured.v_WB_B)
    w = (0.0, 0.0, 0.0) if _on_ground(p, v) else kernels.vector(x.w_WB_B)
    kernels.store_vector(w, measured.w_WB_B)


@compiled
def _held(rates: BodyRates, vehicle: VehicleConstants) -> BodyRates:
    """Return the rates of a body on the ground, where rates with a lag are reset to zero."""
    (x, y, z), lags = rates.w, vehicle.rate_time_constant
    held = 0.0 if lags[0] > 0.0 else x, 0.0 if lags[1] > 0.0 else y, 0.0 if lags[2] > 0.0 else z
    return BodyRates(held, (0.0, 0.0, 0.0))


@compiled
def _landed(
    p_WB: kernels.Vector, R_WB: kernels.Matrix
) -> tuple[kernels.Vector, kernels.Vector, kernels.Matrix]:
    """Return the state after a touchdown: at rest, level, same heading."""
    cosine, sine, _ = kernels.column(R_WB, 0)
    return (
        (p_WB[0], p_WB[1], 0.0),
        (0.0, 0.0, 0.0),
        kernels.exp((0.0, 0.0, math.atan2(sine, cosine))),
    )


@compiled
def _on_ground(p_WB: kernels.Vector, v_WB_B: kernels.Vector) -> bool:
    """Whether the vehicle is at rest on the ground."""
    return p_WB[2] <= 0.0 and v_WB_B[0] == 0.0 and v_WB_B[1] == 0.0 and v_WB_B[2] == 0.0
