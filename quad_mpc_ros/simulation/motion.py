"""The motion of the package's own vehicle while neither command nor wind changes, compiled.

One call moves it over any number of steps of the integrator: actuators, equations of motion,
ground. A state is a row of 19 numbers and the vehicle a vector of 16, both named here.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.actuators import ActuatorState, TimeConstants, later, turn
from quad_mpc_ros.simulation.dynamics import Course, Drive, integrated

P_WB, V_WB_B, R_WB, THROTTLE, W_WB_B = slice(0, 3), slice(3, 6), slice(6, 15), 15, slice(16, 19)
"""Parts of a state's row: position, velocity, rotation row by row, true throttle, body rates."""

ROW_SIZE = 19

Lift = tuple[float, float, float]
"""Coefficients of thrust over mass as a polynomial of the throttle, highest power first."""


def constants(
    vehicle: Vehicle, *, dynamics: str, rate_time_constant: PerAxis, thrust_time_constant: float
) -> Array:
    """Return a vehicle as the compiled code takes it (16,).

    Its equations (1 for the true rigid body), gravity, the coefficients of thrust over mass
    [m/s^2], the time constants of throttle and body rates [s], drag, drag of the rotors and
    translational lift.
    """
    curve = vehicle.motor_count / vehicle.mass * np.array(vehicle.thrust_curve)
    return np.array(
        [
            float(dynamics == "rigid_body"),
            vehicle.gravity,
            *curve,
            thrust_time_constant,
            *per_axis(rate_time_constant),
            *per_axis(vehicle.drag),
            *per_axis(vehicle.rotor_drag),
            vehicle.translational_lift,
        ]
    )


@compiled
def advance(
    row: Array, command: Array, wind_W: Array, vehicle: Array, steps: int, duration: float
) -> None:
    """Move a state (19,) over steps of equal ``duration`` [s].

    The command (4,), throttle and body rates, and the wind (3,) are those in force; ``vehicle``
    is one of :func:`constants`.
    """
    is_rigid_body, gravity = vehicle[0] != 0.0, vehicle[1]
    lift = vehicle[2], vehicle[3], vehicle[4]
    lags = vehicle[5], (vehicle[6], vehicle[7], vehicle[8])
    drag = vehicle[9], vehicle[10], vehicle[11]
    rotor_drag = vehicle[12], vehicle[13], vehicle[14]
    world = is_rigid_body, gravity, drag, rotor_drag, vehicle[15], kernels.vector(wind_W)
    followed = command[0], (command[1], command[2], command[3])
    p, v = kernels.vector(row[0:3]), kernels.vector(row[3:6])
    R = kernels.matrix_in_row(row[6:15])
    u = row[15], kernels.vector(row[16:19])
    for _ in range(steps):
        before = u
        course, u = _driven(before, followed, lags=lags, lift=lift, duration=duration)
        if _on_ground(p, v) and _lift(max(before[0], u[0]), lift) <= gravity:
            u = _held(u, lags)  # the ground carries it: no command turns it there
            continue
        p, v, R = integrated(p, v, R, course=course, world=world, duration=duration)
        if not (p[2] > 0.0 or (p[2] == 0.0 and kernels.apply(R, v)[2] > 0.0)):
            p, v, R = _landed(p, R)
            u = _held(u, lags)
    kernels.store_vector(p, row[0:3])
    kernels.store_vector(v, row[3:6])
    kernels.store_matrix_row(R, row[6:15])
    row[15] = u[0]
    kernels.store_vector(u[1], row[16:19])


@compiled
def odometry(row: Array) -> Array:
    """Return what there is to be measured of a state (19,): a row (13,).

    Position in the world, attitude as a quaternion x, y, z, w, velocity and body rates in the
    body. On the ground nothing turns, whatever the command.
    """
    p, v = kernels.vector(row[0:3]), kernels.vector(row[3:6])
    seen = np.zeros(13)
    kernels.store_vector(p, seen[0:3])
    seen[3], seen[4], seen[5], seen[6] = kernels.quaternion(kernels.matrix_in_row(row[6:15]))
    kernels.store_vector(v, seen[7:10])
    if not _on_ground(p, v):
        kernels.store_vector(kernels.vector(row[16:19]), seen[10:13])
    return seen


@compiled
def _driven(
    u: ActuatorState, command: ActuatorState, lags: TimeConstants, lift: Lift, duration: float
) -> tuple[Course, ActuatorState]:
    """Return how actuators drive the vehicle over a step, and what they are at its end."""
    half = 0.5 * duration
    middle = later(u, command=command, lags=lags, duration=half)
    end = later(middle, command=command, lags=lags, duration=half)
    first = turn(u[1], command=command[1], time_constants=lags[1], duration=half)
    second = turn(middle[1], command=command[1], time_constants=lags[1], duration=half)
    return (_drive(u, lift), _drive(middle, lift), _drive(end, lift), first, second), end


@compiled
def _drive(u: ActuatorState, lift: Lift) -> Drive:
    return _lift(u[0], lift), u[1]


@compiled
def _lift(throttle: float, lift: Lift) -> float:
    """Return the thrust over mass [m/s^2]."""
    return (lift[0] * throttle + lift[1]) * throttle + lift[2]


@compiled
def _held(u: ActuatorState, lags: TimeConstants) -> ActuatorState:
    """Return actuators of a body that something holds: rates that lag start again from zero."""
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
    """Return what the ground makes of a vehicle: at rest, level, heading kept."""
    yaw = math.atan2(R_WB[3], R_WB[0])
    return (p_WB[0], p_WB[1], 0.0), (0.0, 0.0, 0.0), kernels.exp((0.0, 0.0, yaw))


@compiled
def _on_ground(p_WB: kernels.Vector, v_WB_B: kernels.Vector) -> bool:
    """Known here; the controller has to find it out (``control/estimation/contact.py``)."""
    return p_WB[2] <= 0.0 and v_WB_B[0] == 0.0 and v_WB_B[1] == 0.0 and v_WB_B[2] == 0.0
