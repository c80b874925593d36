"""The equations of motion of the plant ``rotors``, compiled.

World ENU, body FLU. C is the centre of mass, J the inertia about it, a_i and r_i axis and place
of rotor i from C, o_i its sense, s_i its speed, f_i its force, h its share of the angular
momentum I_r o_i s_i a_i:

    m dv/dt = R (sum f_i + drag) - m g e_z + push
    J dw/dt = sum (r_i x f_i - o_i c_q s_i^2 a_i - o_i I_r ds_i/dt a_i) - w x (J w + sum h_i)
    ds/dt = (s_wanted - s) / tau

Of the reaction torques the first is that of the air on the rotor, which the motor hands on to
the body, the second that of its acceleration; the last term is gyroscopic.
"""

from __future__ import annotations

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.rotors.aerodynamics import body_drag, ground_gain, rotor_force
from quad_mpc_ros.simulation.rotors.battery import battery
from quad_mpc_ros.simulation.rotors.craft import Craft, craft_in
from quad_mpc_ros.simulation.rotors.state import SPEEDS, rotation_in

Outside = tuple[kernels.Vector, kernels.Vector]
"""Velocity of the air [m/s] and a force that pushes at C [N], both in the world."""


@compiled
def derivative(
    x: Array, wanted: Array, outside: Outside, craft: Array, rotors: Array, out: Array
) -> None:
    """Write the time derivative of a state (14 + n,) into ``out`` (14 + n,).

    ``wanted`` (n,) are the speeds that the autopilot asks for [rad/s], at a full battery;
    ``craft`` and ``rotors`` those of :mod:`quad_mpc_ros.simulation.rotors.craft`.
    """
    numbers, (wind_W, push_W) = craft_in(craft), outside
    charge, current = battery(_power(x, numbers), used=x[13], craft=numbers)
    out[13] = current
    _follow(x, wanted=wanted, charge=charge, craft=numbers, out=out)
    R_WB = rotation_in(x)
    w = kernels.vector(x[10:13])
    through_W = kernels.plus(kernels.vector(x[3:6]), kernels.scaled(-1.0, wind_W))
    v_air_B = kernels.apply_transposed(R_WB, through_W)
    force, torque, momentum = _wrench(x, v_air_B=v_air_B, craft=numbers, rotors=rotors, rate=out)
    total_W = kernels.plus(kernels.apply(R_WB, force), push_W)
    a_W = kernels.scaled(1.0 / numbers.mass, total_W)
    momentum = kernels.plus(momentum, kernels.apply(numbers.inertia, w))
    torque = kernels.plus(torque, kernels.cross(momentum, w))
    kernels.store_vector(kernels.vector(x[3:6]), out[0:3])
    kernels.store_vector((a_W[0], a_W[1], a_W[2] - numbers.gravity), out[3:6])
    _turn(x, w, out[6:10])
    kernels.store_vector(kernels.apply(numbers.inverse_inertia, torque), out[10:13])


@compiled
def charge(x: Array, craft: Array) -> float:
    """Return the voltage of a state (14 + n,) over that of a full battery."""
    numbers = craft_in(craft)
    return battery(_power(x, numbers), used=x[13], craft=numbers)[0]


@compiled
def _power(x: Array, craft: Craft) -> float:
    """Return the power that the air takes from the rotors [W]."""
    power = 0.0
    for speed in x[SPEEDS:]:
        power += craft.torque_coefficient * speed * speed * speed
    return power


@compiled
def _follow(x: Array, wanted: Array, charge: float, craft: Craft, out: Array) -> None:
    """Write the accelerations of the rotors; speeds go with the voltage, ``charge`` its share."""
    highest = max(charge * craft.speed_max, craft.speed_min)
    gain = 1.0 if craft.compensated else charge
    for rotor in range(wanted.shape[0]):
        target = kernels.clamp(gain * wanted[rotor], craft.speed_min, highest)
        out[SPEEDS + rotor] = (target - x[SPEEDS + rotor]) / craft.time_constant


@compiled
def _wrench(
    x: Array, v_air_B: kernels.Vector, craft: Craft, rotors: Array, rate: Array
) -> tuple[kernels.Vector, kernels.Vector, kernels.Vector]:
    """Return force and torque on the body, about C, and the rotors' angular momentum, all in it.

    ``rate`` is the derivative, of which the rotors' accelerations are there.
    """
    R_WB, w = rotation_in(x), kernels.vector(x[10:13])
    force, torque, momentum = body_drag(v_air_B, craft), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for rotor in range(rotors.shape[0]):
        place, axis = kernels.vector(rotors[rotor, 0:3]), kernels.vector(rotors[rotor, 3:6])
        spin, speed = rotors[rotor, 6], x[SPEEDS + rotor]
        height = x[2] + kernels.apply(R_WB, place)[2] + craft.clearance
        pushed = rotor_force(
            speed,
            axis=axis,
            v_air_B=kernels.plus(v_air_B, kernels.cross(w, place)),
            gain=ground_gain(height, upright=R_WB[8], craft=craft),
            craft=craft,
        )
        handed_on = craft.torque_coefficient * speed * speed
        handed_on += craft.rotor_inertia * rate[SPEEDS + rotor]
        force = kernels.plus(force, pushed)
        torque = kernels.plus(torque, kernels.cross(place, pushed))
        torque = kernels.plus(torque, kernels.scaled(-spin * handed_on, axis))
        momentum = kernels.plus(momentum, kernels.scaled(spin * craft.rotor_inertia * speed, axis))
    return force, torque, momentum


@compiled
def _turn(x: Array, w: kernels.Vector, out: Array) -> None:
    """Write the derivative of the quaternion, q times (w, 0) / 2."""
    i, j, k, real = 0.5 * x[6], 0.5 * x[7], 0.5 * x[8], 0.5 * x[9]
    out[0] = real * w[0] + j * w[2] - k * w[1]
    out[1] = real * w[1] + k * w[0] - i * w[2]
    out[2] = real * w[2] + i * w[1] - j * w[0]
    out[3] = -i * w[0] - j * w[1] - k * w[2]
