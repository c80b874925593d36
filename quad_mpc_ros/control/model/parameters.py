# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the prediction model, configured or estimated."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.control.model import vehicle as vehicles
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle


class ModelParameters(Record):
    """The numbers of the equations in :mod:`quad_mpc_ros.control.model.rollout`."""

    # Thrust over mass is thrust_scale ((a s + b) s + c) [m/s^2] at throttle s.
    a: float
    b: float
    c: float
    # Mean of the linear drag over the body axes [1/s], which is integrated exactly.
    drag: float
    gravity: float  # m/s^2
    # Time constants of lags [s], 0 without a lag; rising and falling throttle may differ.
    thrust_time_constant: float
    thrust_time_constant_down: float
    rate_time_constants: Vector3
    torque_time_constants: Vector3
    angular_acceleration_max: Vector3  # rad/s^2, infinite without a bound
    a_W: Vector3  # m/s^2, disturbance acceleration
    thrust_scale: float
    anisotropic_drag: Vector3  # 1/s, drag of each body axis less the mean
    translational_lift: float  # 1/m, k_h
    learned_drag: Vector3  # 1/s, estimated part of the drag; the reference's attitudes lack it
    rotor_drag: Vector3  # 1/s, drag proportional to the rotors' speed, at the speed of hover
    # Offsets of the rates from their commands: constant [rad/s] and per modelled specific thrust.
    rate_offset: Vector3
    rate_offset_by_thrust: Vector3


def parameters_of(vehicle: Vehicle, lags: ActuatorLags) -> RecordArray[ModelParameters]:
    """Return the parameters of an undisturbed vehicle."""
    drag = per_axis(vehicle.drag)
    # The mean of equal numbers must not differ by rounding.
    mean = drag[0] if min(drag) == max(drag) else sum(drag) / 3.0
    parameters = ModelParameters.zeros()
    model = parameters[()]
    model.a, model.b, model.c = (
        vehicle.motor_count * k / vehicle.mass for k in vehicle.thrust_curve
    )
    model.drag, model.gravity, model.thrust_scale = mean, vehicle.gravity, 1.0
    model.thrust_time_constant = lags.thrust
    model.thrust_time_constant_down = lags.thrust_down or lags.thrust
    model.rate_time_constants[:] = per_axis(lags.rate)
    model.torque_time_constants[:] = per_axis(lags.torque)
    model.angular_acceleration_max[:] = [
        most or math.inf for most in per_axis(lags.angular_acceleration_max)
    ]
    model.anisotropic_drag[:] = [k - mean for k in drag]
    model.translational_lift = vehicle.translational_lift
    model.rotor_drag[:] = per_axis(vehicle.rotor_drag)
    return parameters


_throttle_curve = compiled(vehicles.throttle_curve)
_inverse_throttle_curve = compiled(vehicles.inverse_throttle_curve)
root_of_thrust = compiled(vehicles.root_of_thrust)


@compiled
def throttle_for(model: ModelParameters, thrust: float) -> float:
    """Return the throttle in [0, 1] with the specific thrust nearest to ``thrust`` [m/s^2]."""
    return _inverse_throttle_curve(model.a, model.b, model.c, thrust / model.thrust_scale)


@compiled
def modelled_thrust(model: ModelParameters, throttle: float) -> float:
    """Return the specific thrust of the modelled curve [m/s^2], unscaled."""
    return _throttle_curve(model.a, model.b, model.c, throttle)


@compiled
def rate_offset_at(model: ModelParameters, throttle: float) -> kernels.Vector:
    """Return the offset of the rates from their commands [rad/s]."""
    fixed, by_thrust = model.rate_offset, model.rate_offset_by_thrust
    thrust = modelled_thrust(model, throttle)
    return (
        fixed[0] + by_thrust[0] * thrust,
        fixed[1] + by_thrust[1] * thrust,
        fixed[2] + by_thrust[2] * thrust,
    )
