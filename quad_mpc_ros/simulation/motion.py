"""The motion of the internal plant at constant command and wind, compiled.

One call advances any number of steps: actuators, equations of motion, ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.actuators import ActuatorState, TimeConstants, later, thrust_at, turn
from quad_mpc_ros.simulation.dynamics import Drive, DrivenStep, integrated
from quad_mpc_ros.simulation.rate_loop import RateLoop, controlled_rates, turned
from quad_mpc_ros.simulation.records import Measured, PlantInputs, store_quaternion


class VehicleState(Record):
    """The state of the vehicle and its actuators."""

    p_WB: Vector3  # m
    v_WB_B: Vector3  # m/s
    R_WB: Matrix3
    throttle: float  # that makes the thrust
    w_WB_B: Vector3  # rad/s
    angular_acceleration: Vector3  # rad/s^2, with a rate loop of second order


class VehicleConstants(Record):
    """The numbers of the equations."""

    is_rigid_body: int  # 0 for the paper's Eq. (3)
    gravity: float  # m/s^2
    lift: Vector3  # thrust over mass, a polynomial of the throttle, highest power first [m/s^2]
    thrust_time_constant: float  # s
    thrust_time_constant_down: float  # s, while the throttle decreases
    rate_time_constant: Vector3  # s
    is_second_order: int  # the rate loop
    torque_time_constant: Vector3  # s
    angular_acceleration_max: Vector3  # rad/s^2
    drag: Vector3  # 1/s
    rotor_drag: Vector3  # 1/s
    translational_lift: float  # 1/m


@dataclass(frozen=True, kw_only=True)
class Lags:
    """How throttle and body rates follow their commands.

    Attributes:
        thrust: Time constant of the throttle while it increases [s].
        thrust_down: The same while it decreases [s].
        rate: Time constant of the body rates, which is one over the gain of their loop [s].
        torque: Time constant of the torque behind the loop [s].
        angular_acceleration_max: Largest angular acceleration of the loop [rad/s^2].
    """

    thrust: float
    thrust_down: float
    rate: PerAxis
    torque: PerAxis = 0.0
    angular_acceleration_max: PerAxis = math.inf


def constants(vehicle: Vehicle, lags: Lags, *, dynamics: str) -> RecordArray[VehicleConstants]:
    """Return a vehicle as the compiled code takes it."""
    numbers = VehicleConstants.zeros()
    own = numbers[()]
    own.is_rigid_body = int(dynamics == "rigid_body")
    own.gravity = vehicle.gravity
    own.lift[:] = vehicle.thrust_curve
    own.lift *= vehicle.motor_count / vehicle.mass
    own.thrust_time_constant, own.thrust_time_constant_down = lags.thrust, lags.thrust_down
    own.rate_time_constant[:] = per_axis(lags.rate)
    own.torque_time_constant[:] = per_axis(lags.torque)
    own.angular_acceleration_max[:] = per_axis(lags.angular_acceleration_max)
    bounded = np.isfinite(own.angular_acceleration_max).any()
    own.is_second_order = int(bounded or own.torque_time_constant.any())
    own.drag[:] = per_axis(vehicle.drag)
    own.rotor_drag[:] = per_axis(vehicle.rotor_drag)
    own.translational_lift = vehicle.translational_lift
    return numbers


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
    rate_lags = kernels.vector(numbers.rate_time_constant)
    loop = RateLoop(
        rate_lags,
        kernels.vector(numbers.torque_time_constant),
        kernels.vector(numbers.angular_acceleration_max),
    )
    world = (
        numbers.is_rigid_body != 0,
        gravity,
        kernels.vector(numbers.drag),
        kernels.vector(numbers.rotor_drag),
        numbers.translational_lift,
        kernels.vector(u_in.wind_W),
    )
    followed = u_in.throttle, kernels.vector(u_in.w_WB_B)
    p, v, R = kernels.vector(x.p_WB), kernels.vector(x.v_WB_B), kernels.matrix(x.R_WB)
    u, alpha = (x.throttle, kernels.vector(x.w_WB_B)), kernels.vector(x.angular_acceleration)
    for _ in range(steps):
        before, slows = u, followed[0] < u[0]
        lags = (
            numbers.thrust_time_constant_down if slows else numbers.thrust_time_constant,
            rate_lags,
        )
        if numbers.is_second_order:
            course, u, alpha = _controlled(before, alpha, followed, lags, loop, lift, duration)
        else:
            course, u = _driven(before, followed, lags=lags, lift=lift, duration=duration)
        if _on_ground(p, v) and thrust_at(max(before[0], u[0]), lift) <= gravity:
            u, alpha = _held(u, lags), (0.0, 0.0, 0.0)  # the ground prevents rotation
            continue
        p, v, R = integrated(p, v, R, course=course, world=world, duration=duration)
        if not (p[2] > 0.0 or (p[2] == 0.0 and kernels.apply(R, v)[2] > 0.0)):
            p, v, R = _landed(p, R)
            u, alpha = _held(u, lags), (0.0, 0.0, 0.0)
    kernels.store_vector(p, x.p_WB)
    kernels.store_vector(v, x.v_WB_B)
    kernels.store_matrix(R, x.R_WB)
    x.throttle = u[0]
    kernels.store_vector(u[1], x.w_WB_B)
    kernels.store_vector(alpha, x.angular_acceleration)


@compiled
def measure(state: RecordArray[VehicleState], out: RecordArray[Measured]) -> None:
    """Write the true motion, without rotation on the ground."""
    x, measured = state[()], out[()]
    p, v = kernels.vector(x.p_WB), kernels.vector(x.v_WB_B)
    kernels.store_vector(p, measured.p_WB)
    store_quaternion(kernels.quaternion(kernels.matrix(x.R_WB)), measured.q_WB_xyzw)
    kernels.store_vector(v, measured.v_WB_B)
    w = (0.0, 0.0, 0.0) if _on_ground(p, v) else kernels.vector(x.w_WB_B)
    kernels.store_vector(w, measured.w_WB_B)


@compiled
def _driven(
    u: ActuatorState,
    command: ActuatorState,
    lags: TimeConstants,
    lift: kernels.Vector,
    duration: float,
) -> tuple[DrivenStep, ActuatorState]:
    """Return the drive of a step, and the actuators at its end."""
    half = 0.5 * duration
    middle = later(u, command=command, lags=lags, duration=half)
    end = later(middle, command=command, lags=lags, duration=half)
    first = turn(u[1], command=command[1], time_constants=lags[1], duration=half)
    second = turn(middle[1], command=command[1], time_constants=lags[1], duration=half)
    return (_drive(u, lift), _drive(middle, lift), _drive(end, lift), first, second), end


@compiled
def _controlled(
    u: ActuatorState,
    alpha: kernels.Vector,
    command: ActuatorState,
    lags: TimeConstants,
    loop: RateLoop,
    lift: kernels.Vector,
    duration: float,
) -> tuple[DrivenStep, ActuatorState, kernels.Vector]:
    """Return the result of :func:`_driven` with a loop of second order, and alpha at the end."""
    half = 0.5 * duration
    w_middle, alpha_middle = controlled_rates(u[1], alpha, command[1], loop, half)
    w_end, alpha_end = controlled_rates(w_middle, alpha_middle, command[1], loop, half)
    middle = later(u, command=command, lags=lags, duration=half)[0], w_middle
    end = later(middle, command=command, lags=lags, duration=half)[0], w_end
    first = turned((u[1], w_middle), (alpha, alpha_middle), half)
    second = turned((w_middle, w_end), (alpha_middle, alpha_end), half)
    drives = _drive(u, lift), _drive(middle, lift), _drive(end, lift)
    return (*drives, first, second), end, alpha_end


@compiled
def _drive(u: ActuatorState, lift: kernels.Vector) -> Drive:
    return thrust_at(u[0], lift), u[1]


@compiled
def _held(u: ActuatorState, lags: TimeConstants) -> ActuatorState:
    """Return the actuators of a body on the ground, where rates with a lag are reset to zero."""
    x, y, z = u[1]
    return u[0], (
        0.0 if lags[1][0] > 0.0 else x,
        0.0 if lags[1][1] > 0.0 else y,
        0.0 if lags[1][2] > 0.0 else z,
    )


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
