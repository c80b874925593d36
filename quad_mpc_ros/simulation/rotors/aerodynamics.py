"""The forces of the air on rotors and body, compiled."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.simulation.rotors.craft import Craft


@compiled
def rotor_force(
    speed: float,
    axis: kernels.Vector,
    v_air_B: kernels.Vector,
    gain: float,
    craft: Craft,
) -> kernels.Vector:
    """Return the force of a rotor in the body [N].

    ``speed`` [rad/s]; ``v_air_B`` is the velocity of its hub through the air [m/s], of which u is
    the part along the axis and w the part across it:

        (gain c_t s^2 + k_h |w|^2 - k_z s u) axis - k_d s w

    with thrust, of which ``gain`` is what ground effect multiplies it by, induced lift, inflow
    loss and rotor drag.
    """
    along = kernels.dot(axis, v_air_B)
    across = kernels.plus(v_air_B, kernels.scaled(-along, axis))
    thrust = (
        gain * craft.thrust_coefficient * speed * speed
        + craft.translational_lift * kernels.dot(across, across)
        - craft.inflow_loss * speed * along
    )
    return kernels.plus(
        kernels.scaled(thrust, axis), kernels.scaled(-craft.rotor_drag * speed, across)
    )


@compiled
def body_drag(v_air_B: kernels.Vector, craft: Craft) -> kernels.Vector:
    """Return the drag of the body in the body [N]: -(d_1 + d_2 |v|) v along each axis."""
    x, y, z = v_air_B
    speed = math.sqrt(kernels.dot(v_air_B, v_air_B))
    linear, quadratic = craft.drag_linear, craft.drag_quadratic
    return (
        -(linear[0] + quadratic[0] * speed) * x,
        -(linear[1] + quadratic[1] * speed) * y,
        -(linear[2] + quadratic[2] * speed) * z,
    )


@compiled
def ground_gain(height: float, upright: float, craft: Craft) -> float:
    """Return what the ground multiplies the thrust of a rotor by.

    1 / (1 - k (r / 4 z)^2) at a height z of the rotor above the ground [m] (I. C. Cheeseman,
    W. E. Bennett, "The effect of the ground on a helicopter rotor in forward flight", 1955), but
    at most a bound. ``upright``, the cosine of the tilt, fades it; upside down there is none.
    """
    if craft.ground_effect == 0.0 or upright <= 0.0:
        return 1.0
    most = 1.0 - 1.0 / craft.ground_effect_max
    if height <= 0.0:
        return 1.0 / (1.0 - most)
    ratio = 0.25 * craft.radius / height
    return 1.0 / (1.0 - min(craft.ground_effect * upright * ratio * ratio, most))
