"""What is believed of the vehicle, as one vector: the parameters of the model of the future.

The vector crosses into compiled code, which takes an array in a seventh of the time of a named
tuple; there :func:`parameters_in` gives its numbers their names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model import vehicle as vehicles
from quad_mpc_ros.model.vehicle import Vehicle

# Places in the vector: three numbers of the thrust curve, drag, and
GRAVITY = 4
THRUST_TIME_CONSTANT, RATE_TIME_CONSTANT, YAW_TIME_CONSTANT = 5, 6, 7
DISTURBANCE = slice(8, 11)
THRUST_SCALE = 11


class ModelParameters(NamedTuple):
    """The numbers of the equations in :mod:`quad_mpc_ros.model.rollout`.

    Thrust over mass is ``thrust_scale`` ((a s + b) s + c) [m/s^2] at throttle s; ``drag`` [1/s],
    ``gravity`` [m/s^2]; time constants of the actuators [s], 0 without a lag, that of the rates
    for roll and pitch, as yaw has its own; ``a_W`` [m/s^2] is the disturbance, the acceleration
    that nothing else explains.
    """

    a: float
    b: float
    c: float
    drag: float
    gravity: float
    thrust_time_constant: float
    rate_time_constant: float
    yaw_time_constant: float
    a_W: kernels.Vector = (0.0, 0.0, 0.0)
    thrust_scale: float = 1.0


def parameters_of(
    vehicle: Vehicle, *, rate_time_constant: float, thrust_time_constant: float
) -> Array:
    """Return the vector of an undisturbed vehicle whose actuators lag by time constants [s].

    Yaw lags as roll and pitch do, as long as nothing else is known.
    """
    a, b, c = (vehicle.motor_count * k / vehicle.mass for k in vehicle.thrust_curve)
    return packed(
        ModelParameters(
            a=a,
            b=b,
            c=c,
            drag=vehicle.drag,
            gravity=vehicle.gravity,
            thrust_time_constant=thrust_time_constant,
            rate_time_constant=rate_time_constant,
            yaw_time_constant=rate_time_constant,
        )
    )


def packed(parameters: ModelParameters) -> Array:
    """Return the vector (12,)."""
    *numbers, a_W, thrust_scale = parameters
    return np.array([*numbers, *a_W, thrust_scale])


@compiled
def parameters_in(vector: Array) -> ModelParameters:
    """Return what is in the vector (12,)."""
    return ModelParameters(
        vector[0],
        vector[1],
        vector[2],
        vector[3],
        vector[4],
        vector[5],
        vector[6],
        vector[7],
        (vector[8], vector[9], vector[10]),
        vector[11],
    )


_inverse_throttle_curve = compiled(vehicles.inverse_throttle_curve)


@compiled
def throttle_for(model: ModelParameters, thrust: float) -> float:
    """Return the throttle in [0, 1] whose thrust over mass is nearest to one wanted [m/s^2]."""
    return _inverse_throttle_curve(model.a, model.b, model.c, thrust / model.thrust_scale)
