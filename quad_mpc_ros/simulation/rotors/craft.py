# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Records of the plant ``rotors`` for compiled code: state and numbers of body and rotors.

The state is a record of the body, and the rotors' speeds (n,) [rad/s]. C is the centre of mass.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3, Vector4
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.rotors.parameters import (
    RotorParameters,
    RotorsPlantParameters,
    inertia_tensor,
)


class BodyState(Record):
    """State of body and battery, or its time derivative."""

    p_WC: Vector3  # m
    v_WC_W: Vector3  # m/s
    q_WB_xyzw: Vector4
    w_WB_B: Vector3  # rad/s
    charge_used: float  # from the battery [A s]


@compiled
def add(
    body: BodyState, speeds: Array, factor: float, rate: BodyState, accelerations: Array
) -> None:
    """Add a multiple of a derivative (rate and accelerations) to a state."""
    for k in range(3):
        body.p_WC[k] += factor * rate.p_WC[k]
        body.v_WC_W[k] += factor * rate.v_WC_W[k]
        body.w_WB_B[k] += factor * rate.w_WB_B[k]
    for k in range(4):
        body.q_WB_xyzw[k] += factor * rate.q_WB_xyzw[k]
    body.charge_used += factor * rate.charge_used
    for rotor in range(speeds.shape[0]):
        speeds[rotor] += factor * accelerations[rotor]


@compiled
def rotation_of(body: BodyState) -> kernels.Matrix:
    """Return the rotation of body to world."""
    return kernels.rotation(kernels.quaternion_in(body.q_WB_xyzw))


@compiled
def put(body: BodyState, p_WB: kernels.Vector, center_B: kernels.Vector) -> None:
    """Set the position of the body's origin [m]; keep the attitude."""
    offset = kernels.apply(rotation_of(body), center_B)
    kernels.store_vector(kernels.plus(p_WB, offset), body.p_WC)


@compiled
def origin_height(body: BodyState, center_B: kernels.Vector) -> float:
    """Return the height of the body's origin [m]."""
    return float(body.p_WC[2] - kernels.apply(rotation_of(body), center_B)[2])


@compiled
def on_ground(body: BodyState, center_B: kernels.Vector) -> bool:
    """Whether the body is at rest on the ground."""
    x, y, z = kernels.vector(body.v_WC_W)
    return origin_height(body, center_B) <= 0.0 and x == 0.0 and y == 0.0 and z == 0.0


class Craft(Record):
    """The numbers of the equations in :mod:`quad_mpc_ros.simulation.rotors.equations`.

    Units follow the parameters with equal names.
    """

    mass: float
    gravity: float
    center_B: Vector3  # centre of mass in the body
    inertia: Matrix3
    inverse_inertia: Matrix3
    drag_linear: Vector3
    drag_quadratic: Vector3
    thrust_coefficient: float
    torque_coefficient: float
    time_constant: float
    rotor_inertia: float
    speed_min: float
    speed_max: float
    inflow_loss: float
    rotor_drag: float
    translational_lift: float  # of one rotor
    radius: float
    ground_effect: float
    clearance: float
    capacity: float  # A s; 0 for a battery with constant voltage
    voltage_full: float
    voltage_empty: float
    resistance: float
    efficiency: float
    compensated: int
    longest_step_ns: int  # of the integrator


class Rotor(Record):
    """Position and spin direction of a rotor."""

    place: Vector3  # from the centre of mass, in the body [m]
    spin: float  # 1 anticlockwise from above, or -1


def craft_of(config: RotorsPlantParameters, vehicle: Vehicle) -> RecordArray[Craft]:
    """Return a configured vehicle; ``vehicle`` has the true mass."""
    rotors, airframe, battery = config.rotors, config.airframe, config.battery
    craft = Craft.zeros()
    own = craft[()]
    own.mass, own.gravity = vehicle.mass, vehicle.gravity
    own.center_B[:] = airframe.center_of_mass
    own.inertia[:] = inertia_tensor(airframe.inertia)
    own.inverse_inertia[:] = np.linalg.inv(own.inertia)
    own.drag_linear[:], own.drag_quadratic[:] = airframe.drag_linear, airframe.drag_quadratic
    own.thrust_coefficient = rotors.thrust_coefficient * config.thrust_scale
    own.torque_coefficient = rotors.torque_coefficient
    own.time_constant, own.rotor_inertia = rotors.time_constant, rotors.inertia
    own.speed_min, own.speed_max = rotors.speed_min, rotors.speed_max
    own.inflow_loss, own.rotor_drag = rotors.inflow_loss, rotors.drag
    own.translational_lift = airframe.translational_lift / len(rotors.x)
    own.radius, own.clearance = rotors.radius, airframe.clearance
    own.ground_effect = airframe.ground_effect
    own.capacity = 3600.0 * battery.capacity
    own.voltage_full, own.voltage_empty = battery.voltage_full, battery.voltage_empty
    own.resistance, own.efficiency = battery.resistance, battery.efficiency
    own.compensated = battery.compensated
    own.longest_step_ns = round(1e9 * config.integration_step)
    return craft


def rotors_of(rotors: RotorParameters, *, center_B: Array) -> RecordArray[Rotor]:
    """Return the rotors (n,), with positions relative to a centre of mass (3,) [m]."""
    records = Rotor.zeros(len(rotors.x))
    records["place"] = np.column_stack((rotors.x, rotors.y, rotors.z)) - center_B
    records["spin"] = rotors.spin
    return records
