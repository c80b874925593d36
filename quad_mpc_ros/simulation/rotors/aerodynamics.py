"""The aerodynamic forces on rotors and body, compiled."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.simulation.rotors.craft import Craft

_GROUND_EFFECT_MAX = 1.5  # of the thrust


@compiled
def rotor_force(
    speed: float,
    v_air_B: kernels.Vector,
    gain: float,
    craft: Craft,
) -> kernels.Vector:
    """Return the force of a rotor in the body [N].

    With speed s [rad/s] and airspeed of the hub [m/s], u along z and w across z, the force is

        (gain c_t s^2 + k_h |w|^2 - k_z s u) e_z - k_d s w:

    thrust, multiplied by the ``gain`` of the ground effect, translational lift, inflow loss and
    rotor drag.
    """
    x, y, along = v_air_B
    thrust = (
        gain * craft.thrust_coefficient * speed * speed
        + craft.translational_lift * (x * x + y * y)
        - craft.inflow_loss * speed * along
    )
    drag = -craft.rotor_drag * speed
    return drag * x, drag * y, thrust


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
    """Return the factor of a rotor's thrust in ground effect.

    The factor is 1 / (1 - k (r / 4 z)^2) at a height z of the rotor above the ground [m] (I. C.
    Cheeseman, W. E. Bennett, "The effect of the ground on a helicopter rotor in forward flight",
    1955), but at most 1.5. ``upright``, the cosine of the tilt, reduces it; 1 upside down.
    """
    if craft.ground_effect == 0.0 or upright <= 0.0:
        return 1.0
    most = 1.0 - 1.0 / _GROUND_EFFECT_MAX
    if height <= 0.0:
        return 1.0 / (1.0 - most)
    ratio = 0.25 * craft.radius / height
    return 1.0 / (1.0 - min(craft.ground_effect * upright * ratio * ratio, most))
