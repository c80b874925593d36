"""The numbers of a vehicle for compiled code: body, and each rotor."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.rotors.parameters import (
    RotorParameters,
    RotorsPlantParameters,
    inertia_tensor,
)


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
