# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the vehicle for the planner, from the parameters of MPC and simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, UserError, per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.feasibility import FeasibilityParameters
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.rotors.mixer import allocation
from quad_mpc_ros.simulation.rotors.parameters import inertia_tensor

_ROTORS_PLANT = "rotors"
_MIN_THRUST_RATIO = 0.02  # of the weight: without thrust the attitude is undefined


@dataclass(frozen=True, kw_only=True, eq=False)
class RotorLimits:
    """Limits of the rotors.

    ``allocation`` (4, n) maps the rotors' thrusts to thrust [N] and torques [N m]; ``least`` and
    ``greatest`` [N] bound each rotor's thrust; ``inertia`` (3, 3) [kg m^2].
    """

    allocation: Array
    least: float
    greatest: float
    inertia: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedVehicle:
    """The vehicle of a plan, with limits after the margin.

    ``drag`` and ``rotor_drag`` (3,) [1/s], ``translational_lift`` [1/m], lags [s] with
    ``rate_time_constant`` (3,), ``omega_max`` (3,) [rad/s]; ``least`` and ``greatest`` bound the
    specific thrust [m/s^2]. ``rotors`` is None if unknown.
    """

    mass: float
    gravity: float
    drag: Array
    rotor_drag: Array
    translational_lift: float
    rate_time_constant: Array
    thrust_time_constant: float
    omega_max: Array
    least: float
    greatest: float
    rotors: RotorLimits | None


def planned_vehicle(
    mpc: MpcConfig, simulator: SimulatorConfig, limits: FeasibilityParameters
) -> PlannedVehicle:
    """Return the vehicle with the limits of the MPC and ``limits``, minus the margin.

    The tighter bounds of both apply, and bounds of each rotor if the simulator has the plant
    ``rotors``. ``limit_margin`` is the unused share between hover and each bound.
    """
    vehicle, share = mpc.vehicle(), 1.0 - limits.limit_margin
    hover = vehicle.hover_throttle
    throttles = (
        hover + share * (max(mpc.throttle_min, limits.throttle_min) - hover),
        hover + share * (min(mpc.throttle_max, limits.throttle_max) - hover),
    )
    least, greatest = (vehicle.thrust(throttle) / vehicle.mass for throttle in throttles)
    rotors = None
    if simulator.plant == _ROTORS_PLANT:
        rotors = _rotors(simulator, share=share, weight=vehicle.mass * vehicle.gravity)
    omega_max = share * np.minimum(mpc.omega_max, limits.omega_max)
    if greatest <= 1.05 * vehicle.gravity:
        raise ConfigurationError(
            f"{limits.owner}.limit_margin",
            limits.limit_margin,
            f"a value that leaves thrust to climb: {greatest:.3g} m/s^2 of {mpc.gravity:g} remain",
        )
    return PlannedVehicle(
        mass=vehicle.mass,
        gravity=vehicle.gravity,
        drag=np.array(per_axis(mpc.drag)),
        rotor_drag=np.array(per_axis(mpc.rotor_drag)),
        translational_lift=mpc.translational_lift,
        rate_time_constant=np.array(per_axis(mpc.rate_time_constant)),
        thrust_time_constant=mpc.thrust_time_constant,
        omega_max=np.asarray(omega_max),
        least=max(least, _MIN_THRUST_RATIO * vehicle.gravity),
        greatest=greatest,
        rotors=rotors,
    )


def _rotors(simulator: SimulatorConfig, *, share: float, weight: float) -> RotorLimits:
    given, body = simulator.rotors, simulator.airframe
    hover = weight / len(given.x)
    bounds = [
        hover + share * (given.thrust_coefficient * speed**2 - hover)
        for speed in (given.speed_min, given.speed_max)
    ]
    if not bounds[0] < hover < bounds[1]:
        raise UserError(
            f"simulator.rotors.speed_max: {bounds[1]:.3g} N of thrust do not lift the vehicle"
        )
    return RotorLimits(
        allocation=allocation(given),
        least=bounds[0],
        greatest=bounds[1],
        inertia=inertia_tensor(body.inertia),
    )
