# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The equations of motion of the plant ``rotors``, compiled.

World ENU, body FLU. C is the centre of mass, J the inertia about C. Rotor i has the position r_i
from C, spin direction o_i, speed s_i and force f_i; e is the body's z axis:

    m dv/dt = R (sum f_i + drag) - m g e_z + push
    J dw/dt = sum (r_i x f_i - o_i (c_q s_i^2 + I_r ds_i/dt) e) - w x (J w + sum I_r o_i s_i e)
    ds/dt = (s_wanted - s) / tau

The motors transfer the drag torque of the rotors and the torque of their acceleration to the body;
the last term is gyroscopic.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.rotors.craft import BodyState, Craft, Rotor, rotation_of

_GROUND_EFFECT_MAX = 1.5  # of the thrust

Outside = tuple[kernels.Vector, kernels.Vector]
"""Velocity of the air [m/s] and an external force at C [N], both in the world."""


@compiled
def derivative(
    body: BodyState,
    speeds: Array,
    wanted: Array,
    outside: Outside,
    craft: Craft,
    rotors: RecordArray[Rotor],
    rate: BodyState,
    accelerations: Array,
) -> None:
    """Write the time derivative of body and speeds (n,) into ``rate`` and ``accelerations`` (n,).

    ``wanted`` (n,) are the speeds commanded by the autopilot [rad/s], at a full battery.
    """
    wind_W, external_force_W = outside
    voltage, current = battery(_power(speeds, craft), used=body.charge_used, craft=craft)
    rate.charge_used = current
    _follow(speeds, wanted=wanted, charge=voltage, craft=craft, accelerations=accelerations)
    R_WB, v_W, w = rotation_of(body), kernels.vector(body.v_WC_W), kernels.vector(body.w_WB_B)
    through_W = kernels.minus(v_W, wind_W)
    v_air_B = kernels.apply_transposed(R_WB, through_W)
    force, torque, rotor_momentum = _wrench(
        body,
        speeds=speeds,
        v_air_B=v_air_B,
        craft=craft,
        rotors=rotors,
        accelerations=accelerations,
    )
    total_W = kernels.plus(kernels.apply(R_WB, force), external_force_W)
    a_W = kernels.scaled(1.0 / craft.mass, total_W)
    momentum = kernels.apply(kernels.matrix(craft.inertia), w)
    momentum = momentum[0], momentum[1], rotor_momentum + momentum[2]
    torque = kernels.plus(torque, kernels.cross(momentum, w))
    kernels.store_vector(v_W, rate.p_WC)
    kernels.store_vector((a_W[0], a_W[1], a_W[2] - craft.gravity), rate.v_WC_W)
    kernels.store_quaternion(_turn(kernels.quaternion_in(body.q_WB_xyzw), w), rate.q_WB_xyzw)
    alpha = kernels.apply(kernels.matrix(craft.inverse_inertia), torque)
    kernels.store_vector(alpha, rate.w_WB_B)


@compiled
def charge(body: RecordArray[BodyState], speeds: Array, craft: RecordArray[Craft]) -> float:
    """Return the voltage of a state relative to a full battery."""
    numbers = craft[()]
    return battery(_power(speeds, numbers), used=body[()].charge_used, craft=numbers)[0]


@compiled
def _power(speeds: Array, craft: Craft) -> float:
    """Return the aerodynamic power of the rotors [W]."""
    power = 0.0
    for speed in speeds:
        power += craft.torque_coefficient * speed * speed * speed
    return power


@compiled
def _follow(
    speeds: Array, wanted: Array, charge: float, craft: Craft, accelerations: Array
) -> None:
    """Write the accelerations of the rotors; ``charge`` is the relative battery voltage."""
    highest = max(charge * craft.speed_max, craft.speed_min)
    gain = 1.0 if craft.compensated != 0 else charge
    for rotor in range(wanted.shape[0]):
        target = kernels.clamp(gain * wanted[rotor], craft.speed_min, highest)
        accelerations[rotor] = (target - speeds[rotor]) / craft.time_constant


@compiled
def _wrench(
    body: BodyState,
    speeds: Array,
    v_air_B: kernels.Vector,
    craft: Craft,
    rotors: RecordArray[Rotor],
    accelerations: Array,
) -> tuple[kernels.Vector, kernels.Vector, float]:
    """Return force and torque about C in the body, and the rotors' angular momentum along z."""
    R_WB, w = rotation_of(body), kernels.vector(body.w_WB_B)
    upright = kernels.column(R_WB, 2)[2]
    force, torque, momentum = body_drag(v_air_B, craft), (0.0, 0.0, 0.0), 0.0
    for k in range(rotors.shape[0]):
        rotor, speed = rotors[k], speeds[k]
        place = kernels.vector(rotor.place)
        height = body.p_WC[2] + kernels.apply(R_WB, place)[2] + craft.clearance
        rotor_B = rotor_force(
            speed,
            v_air_B=kernels.plus(v_air_B, kernels.cross(w, place)),
            gain=ground_gain(height, upright=upright, craft=craft),
            craft=craft,
        )
        motor_torque = craft.torque_coefficient * speed * speed
        motor_torque += craft.rotor_inertia * accelerations[k]
        force = kernels.plus(force, rotor_B)
        torque = kernels.plus(torque, kernels.cross(place, rotor_B))
        torque = kernels.plus(torque, (0.0, 0.0, -rotor.spin * motor_torque))
        momentum += rotor.spin * craft.rotor_inertia * speed
    return force, torque, momentum


@compiled
def _turn(q_xyzw: kernels.Quaternion, w: kernels.Vector) -> kernels.Quaternion:
    """Return the derivative of the quaternion, q times (w, 0) / 2."""
    x, y, z, real = q_xyzw
    i, j, k, real = 0.5 * x, 0.5 * y, 0.5 * z, 0.5 * real
    return (
        real * w[0] + j * w[2] - k * w[1],
        real * w[1] + k * w[0] - i * w[2],
        real * w[2] + i * w[1] - j * w[0],
        -i * w[0] - j * w[1] - k * w[2],
    )


@compiled
def rotor_force(
    speed: float, v_air_B: kernels.Vector, gain: float, craft: Craft
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
    speed = kernels.norm(v_air_B)
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


@compiled
def battery(power: float, used: float, craft: Craft) -> tuple[float, float]:
    """Return the voltage relative to a full battery, and the current [A].

    ``power`` [W] is drawn by the rotors, ``used`` [A s] is the charge used so far. The voltage
    without current U falls linearly with the charge. With the current I the voltage is V = U - R
    I, and V I is the power over the efficiency: V^2 - U V + R P = 0. The larger root is the
    operating point. The power saturates at the battery's maximum, where V = U / 2.
    """
    if craft.capacity == 0.0:
        return 1.0, 0.0
    left = max(1.0 - used / craft.capacity, 0.0)
    idle = craft.voltage_empty + left * (craft.voltage_full - craft.voltage_empty)
    asked = power / craft.efficiency
    root = math.sqrt(max(idle * idle - 4.0 * craft.resistance * asked, 0.0))
    voltage = 0.5 * (idle + root)
    most = 0.25 * idle * idle / craft.resistance if craft.resistance > 0.0 else asked
    return voltage / craft.voltage_full, min(asked, most) / voltage
