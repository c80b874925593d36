"""The numbers of a vehicle as compiled code takes them: a vector, and a row for each rotor.

In compiled code :func:`craft_in` gives the vector's numbers their names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels, so3
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.rotors.parameters import RotorParameters, RotorsPlantParameters

PLACE, AXIS, SPIN = slice(0, 3), slice(3, 6), 6
"""Parts of a rotor's row: place from the centre of mass [m], direction of thrust, sense."""

ROTOR_SIZE = 7


class Craft(NamedTuple):
    """The numbers of the equations in :mod:`quad_mpc_ros.simulation.rotors.equations`.

    Units are those of the parameters of the same names; ``inverse_inertia`` is that of the
    tensor ``inertia``, ``center_B`` the centre of mass in the body, ``translational_lift`` the
    share of one rotor, ``capacity`` [A s] 0 for a battery that never sags.
    """

    mass: float
    gravity: float
    center_B: kernels.Vector
    inertia: kernels.Matrix
    inverse_inertia: kernels.Matrix
    drag_linear: kernels.Vector
    drag_quadratic: kernels.Vector
    thrust_coefficient: float
    torque_coefficient: float
    time_constant: float
    rotor_inertia: float
    speed_min: float
    speed_max: float
    inflow_loss: float
    rotor_drag: float
    translational_lift: float
    radius: float
    ground_effect: float
    ground_effect_max: float
    clearance: float
    capacity: float
    voltage_full: float
    voltage_empty: float
    resistance: float
    efficiency: float
    compensated: bool


def craft_vector(config: RotorsPlantParameters, vehicle: Vehicle) -> Array:
    """Return a configured vehicle as the vector; ``vehicle`` has its true mass."""
    rotors, airframe, battery = config.rotors, config.airframe, config.battery
    inertia = inertia_tensor(airframe.inertia)
    return np.array(
        [
            vehicle.mass,
            vehicle.gravity,
            *airframe.center_of_mass,
            *inertia.ravel(),
            *np.linalg.inv(inertia).ravel(),
            *airframe.drag_linear,
            *airframe.drag_quadratic,
            rotors.thrust_coefficient * config.thrust_scale,
            rotors.torque_coefficient,
            rotors.time_constant,
            rotors.inertia,
            rotors.speed_min,
            rotors.speed_max,
            rotors.inflow_loss,
            rotors.drag,
            airframe.translational_lift / len(rotors.x),
            rotors.radius,
            airframe.ground_effect,
            airframe.ground_effect_max,
            airframe.clearance,
            3600.0 * battery.capacity,
            battery.voltage_full,
            battery.voltage_empty,
            battery.resistance,
            battery.efficiency,
            float(battery.compensated),
        ]
    )


@compiled
def craft_in(vector: Array) -> Craft:
    """Return what is in the vector (48,)."""
    return Craft(
        vector[0],
        vector[1],
        kernels.vector(vector[2:5]),
        kernels.matrix_in_row(vector[5:14]),
        kernels.matrix_in_row(vector[14:23]),
        kernels.vector(vector[23:26]),
        kernels.vector(vector[26:29]),
        vector[29],
        vector[30],
        vector[31],
        vector[32],
        vector[33],
        vector[34],
        vector[35],
        vector[36],
        vector[37],
        vector[38],
        vector[39],
        vector[40],
        vector[41],
        vector[42],
        vector[43],
        vector[44],
        vector[45],
        vector[46],
        vector[47] != 0.0,
    )


def rotor_rows(rotors: RotorParameters, *, center_B: Array) -> Array:
    """Return the rotors as rows (n, 7), their places from a centre of mass (3,) [m]."""
    rows = np.empty((len(rotors.x), ROTOR_SIZE))
    rows[:, PLACE] = np.column_stack((rotors.x, rotors.y, rotors.z)) - center_B
    for row, tilt_x, tilt_y in zip(rows, rotors.tilt_x, rotors.tilt_y, strict=True):
        row[AXIS] = so3.exp(np.array([tilt_x, tilt_y, 0.0]))[:, 2]
    rows[:, SPIN] = rotors.spin
    return rows


def inertia_tensor(entries: tuple[float, ...]) -> Array:
    """Return the tensor (3, 3) of its entries xx, yy, zz, xy, xz, yz [kg m^2]."""
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
