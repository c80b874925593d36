"""What is estimated of the vehicle: the parameters of the model that predicts it."""

from __future__ import annotations

from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.control.model import vehicle as vehicles
from quad_mpc_ros.control.model.vehicle import Vehicle


class ModelParameters(Record):
    """The numbers of the equations in :mod:`quad_mpc_ros.control.model.rollout`."""

    # Thrust over mass is thrust_scale ((a s + b) s + c) [m/s^2] at throttle s.
    a: float
    b: float
    c: float
    # Mean of the linear drag over the body axes [1/s], which is integrated exactly.
    drag: float
    gravity: float  # m/s^2
    # Of first-order lags [s], 0 without a lag; those of the rates for roll, pitch and yaw.
    thrust_time_constant: float
    rate_time_constants: Vector3
    a_W: Vector3  # m/s^2, the disturbance: an acceleration that nothing else explains
    thrust_scale: float
    uneven_drag: Vector3  # 1/s, by how much the drag of each body axis differs from the mean
    translational_lift: float  # 1/m, k_h
    # 1/s, the part of the drag along each axis that was estimated in flight: drag and uneven_drag
    # contain it, and the reference's attitudes know nothing of it.
    learned_drag: Vector3
    rotor_drag: Vector3  # 1/s, drag that grows with the rotors' speed, at that of hover
    # Beyond their commands rates have these [rad/s], [rad/s per m/s^2] of the modelled thrust at
    # the commanded throttle.
    rate_offset: Vector3
    rate_offset_by_thrust: Vector3


def parameters_of(
    vehicle: Vehicle, *, rate_time_constant: PerAxis, thrust_time_constant: float
) -> RecordArray[ModelParameters]:
    """Return those of an undisturbed vehicle whose actuators lag by time constants [s]."""
    drag = per_axis(vehicle.drag)
    # Equal numbers have no mean other than themselves, whatever rounding says.
    mean = drag[0] if min(drag) == max(drag) else sum(drag) / 3.0
    parameters = ModelParameters.zeros()
    model = parameters[()]
    model.a, model.b, model.c = (
        vehicle.motor_count * k / vehicle.mass for k in vehicle.thrust_curve
    )
    model.drag, model.gravity, model.thrust_scale = mean, vehicle.gravity, 1.0
    model.thrust_time_constant = thrust_time_constant
    model.rate_time_constants[:] = per_axis(rate_time_constant)
    model.uneven_drag[:] = [k - mean for k in drag]
    model.translational_lift = vehicle.translational_lift
    model.rotor_drag[:] = per_axis(vehicle.rotor_drag)
    return parameters


_throttle_curve = compiled(vehicles.throttle_curve)
_inverse_throttle_curve = compiled(vehicles.inverse_throttle_curve)
root_of_thrust = compiled(vehicles.root_of_thrust)


@compiled
def throttle_for(model: ModelParameters, thrust: float) -> float:
    """Return the throttle in [0, 1] whose thrust over mass is nearest to one wanted [m/s^2]."""
    return _inverse_throttle_curve(model.a, model.b, model.c, thrust / model.thrust_scale)


@compiled
def modelled_thrust(model: ModelParameters, throttle: float) -> float:
    """Return the thrust over mass that the modelled curve makes [m/s^2], unscaled."""
    return _throttle_curve(model.a, model.b, model.c, throttle)


@compiled
def rate_offset_at(model: ModelParameters, throttle: float) -> kernels.Vector:
    """Return what the rates have beyond their commands [rad/s]."""
    fixed, by_thrust = model.rate_offset, model.rate_offset_by_thrust
    thrust = modelled_thrust(model, throttle)
    return (
        fixed[0] + by_thrust[0] * thrust,
        fixed[1] + by_thrust[1] * thrust,
        fixed[2] + by_thrust[2] * thrust,
    )
