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

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.records import quaternion_in, store_quaternion
from quad_mpc_ros.simulation.rotors.aerodynamics import body_drag, ground_gain, rotor_force
from quad_mpc_ros.simulation.rotors.battery import battery
from quad_mpc_ros.simulation.rotors.craft import Craft, Rotor
from quad_mpc_ros.simulation.rotors.state import BodyState, rotation_of

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
    through_W = kernels.plus(v_W, kernels.scaled(-1.0, wind_W))
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
    store_quaternion(_turn(quaternion_in(body.q_WB_xyzw), w), rate.q_WB_xyzw)
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
