"""What is believed of the vehicle, as one vector: the parameters of the model of the future.

The vector crosses into compiled code, which takes an array in a seventh of the time of a named
tuple; there :func:`parameters_in` gives its numbers their names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model import vehicle as vehicles
from quad_mpc_ros.control.model.vehicle import Vehicle

# Places in the vector: three numbers of the thrust curve, drag, and
DRAG, GRAVITY, THRUST_TIME_CONSTANT = 3, 4, 5
RATE_TIME_CONSTANTS = slice(6, 9)
DISTURBANCE = slice(9, 12)
THRUST_SCALE = 12
UNEVEN_DRAG, LEARNED_DRAG = slice(13, 16), slice(17, 20)
RATE_OFFSET, RATE_OFFSET_BY_THRUST = slice(23, 26), slice(26, 29)
VECTOR_SIZE = 29


class ModelParameters(NamedTuple):
    """The numbers of the equations in :mod:`quad_mpc_ros.control.model.rollout`.

    Thrust over mass is ``thrust_scale`` ((a s + b) s + c) [m/s^2] at throttle s; ``gravity``
    [m/s^2]; time constants of the actuators [s], 0 without a lag, those of the rates for roll,
    pitch and yaw; ``a_W`` [m/s^2] is the disturbance, the acceleration that nothing else explains.

    Of the linear drag [1/s] ``drag`` is the mean over the body axes, alike in all directions and
    integrated exactly, and ``uneven_drag`` what each axis has more or less than that;
    ``translational_lift`` [1/m] is k_h. ``learned_drag`` [1/s] is what of the drag along each axis
    was learned in flight: both contain it, and the reference's attitudes know nothing of it.
    ``rotor_drag`` [1/s] is the drag along each axis that grows with the rotors' speed, at that of
    hover. Beyond their commands rates have ``rate_offset`` [rad/s] and ``rate_offset_by_thrust``
    [rad/s per m/s^2] of the modelled thrust at the commanded throttle.
    """

    a: float
    b: float
    c: float
    drag: float
    gravity: float
    thrust_time_constant: float
    rate_time_constants: kernels.Vector
    a_W: kernels.Vector = (0.0, 0.0, 0.0)
    thrust_scale: float = 1.0
    uneven_drag: kernels.Vector = (0.0, 0.0, 0.0)
    translational_lift: float = 0.0
    learned_drag: kernels.Vector = (0.0, 0.0, 0.0)
    rotor_drag: kernels.Vector = (0.0, 0.0, 0.0)
    rate_offset: kernels.Vector = (0.0, 0.0, 0.0)
    rate_offset_by_thrust: kernels.Vector = (0.0, 0.0, 0.0)


def parameters_of(
    vehicle: Vehicle, *, rate_time_constant: PerAxis, thrust_time_constant: float
) -> Array:
    """Return the vector of an undisturbed vehicle whose actuators lag by time constants [s]."""
    drag = per_axis(vehicle.drag)
    # Equal numbers have no mean other than themselves, whatever rounding says.
    mean = drag[0] if min(drag) == max(drag) else sum(drag) / 3.0
    a, b, c = (vehicle.motor_count * k / vehicle.mass for k in vehicle.thrust_curve)
    return packed(
        ModelParameters(
            a=a,
            b=b,
            c=c,
            drag=mean,
            gravity=vehicle.gravity,
            thrust_time_constant=thrust_time_constant,
            rate_time_constants=per_axis(rate_time_constant),
            uneven_drag=(drag[0] - mean, drag[1] - mean, drag[2] - mean),
            translational_lift=vehicle.translational_lift,
            rotor_drag=per_axis(vehicle.rotor_drag),
        )
    )


def packed(parameters: ModelParameters) -> Array:
    """Return the vector (29,)."""
    return np.hstack(parameters)


@compiled
def parameters_in(vector: Array) -> ModelParameters:
    """Return what is in the vector (29,)."""
    return ModelParameters(
        vector[0],
        vector[1],
        vector[2],
        vector[3],
        vector[4],
        vector[5],
        (vector[6], vector[7], vector[8]),
        (vector[9], vector[10], vector[11]),
        vector[12],
        (vector[13], vector[14], vector[15]),
        vector[16],
        (vector[17], vector[18], vector[19]),
        (vector[20], vector[21], vector[22]),
        (vector[23], vector[24], vector[25]),
        (vector[26], vector[27], vector[28]),
    )


_inverse_throttle_curve = compiled(vehicles.inverse_throttle_curve)
root_of_thrust = compiled(vehicles.root_of_thrust)


@compiled
def throttle_for(model: ModelParameters, thrust: float) -> float:
    """Return the throttle in [0, 1] whose thrust over mass is nearest to one wanted [m/s^2]."""
    return _inverse_throttle_curve(model.a, model.b, model.c, thrust / model.thrust_scale)


@compiled
def modelled_thrust(vector: Array, throttle: float) -> float:
    """Return the thrust over mass that the modelled curve in a vector (29,) makes [m/s^2]."""
    thrust: float = (vector[0] * throttle + vector[1]) * throttle + vector[2]
    return thrust


@compiled
def rate_offset_at(vector: Array, throttle: float) -> kernels.Vector:
    """Return what the rates have beyond their commands [rad/s], by a vector (29,)."""
    fixed, by_thrust = vector[RATE_OFFSET], vector[RATE_OFFSET_BY_THRUST]
    thrust = modelled_thrust(vector, throttle)
    return (
        fixed[0] + by_thrust[0] * thrust,
        fixed[1] + by_thrust[1] * thrust,
        fixed[2] + by_thrust[2] * thrust,
    )
