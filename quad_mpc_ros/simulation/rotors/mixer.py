# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The mixer: allocates a total thrust and a torque to the rotors.

Thrust and torque are linear in the rotors' thrusts; the pseudo-inverse allocates them to any
number of rotors. If a rotor saturates, airmode reduces the thrust before the torque. Without
airmode, as on the ground, the torque is reduced first. Yaw torque, for which rotors have the least
authority, is reduced before roll and pitch.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.rotors.parameters import RotorParameters

Limits = tuple[float, float]
"""Minimum and maximum thrust of a rotor [N]."""


def allocation(rotors: RotorParameters) -> Array:
    """Return thrust [N] and torque [N m] of the rotors' thrusts (n,) [N], a matrix (4, n).

    The torque is about the origin of the body, where the autopilot assumes the centre of mass.
    """
    x, y, spin = np.array(rotors.x), np.array(rotors.y), np.array(rotors.spin)
    drag = rotors.torque_coefficient / rotors.thrust_coefficient * spin
    return np.vstack((np.ones(len(x)), y, -x, -drag))


def mixing(rotors: RotorParameters) -> Array:
    """Return the rotors' thrusts [N] for each unit of thrust [N] and torque [N m], (n, 4).

    Raises :class:`ConfigurationError` for rotors that cannot produce torque about every axis.
    """
    effect = allocation(rotors)
    mix = np.linalg.pinv(effect)
    if not np.allclose(effect @ mix, np.eye(4), atol=1e-6) or (mix[:, 0] <= 0.0).any():
        raise ConfigurationError(
            "simulator.rotors.x",
            rotors.x,
            "rotors that together produce thrust and torque about every axis",
        )
    return np.ascontiguousarray(mix)


@compiled
def mixed(
    thrust: float,
    torque: kernels.Vector,
    mix: Array,
    limits: Limits,
    airmode: bool,
    out: Array,
) -> tuple[float, float]:
    """Write the rotors' thrusts (n,) [N]; return the shares of the torques that remain.

    The first share applies to roll and pitch, the second to yaw, each in [0, 1].
    """
    least, greatest = limits
    rotor_count = mix.shape[0]
    demand = np.empty((3, rotor_count))
    for rotor in range(rotor_count):
        demand[0, rotor] = mix[rotor, 0]
        demand[1, rotor] = mix[rotor, 1] * torque[0] + mix[rotor, 2] * torque[1]
        demand[2, rotor] = mix[rotor, 3] * torque[2]
    out[:] = 0.0
    low, high = _thrusts_between(out, lift=demand[0], limits=limits)
    total = kernels.clamp(thrust, low, high)
    if not airmode:
        out += total * demand[0]
    shares = np.empty(2)
    for part in range(2):
        turn = demand[part + 1]
        if airmode:
            shares[part] = _share_with_any_thrust(out, turn=turn, lift=demand[0], limits=limits)
        else:
            shares[part] = _share(out, turn=turn, limits=limits)
        out += shares[part] * turn
    if airmode:
        low, high = _thrusts_between(out, lift=demand[0], limits=limits)
        out += min(max(thrust, low), high) * demand[0]
    for rotor in range(rotor_count):  # within the limits to the last bit
        out[rotor] = kernels.clamp(out[rotor], least, greatest)
    return shares[0], shares[1]


@compiled
def _thrusts_between(given: Array, lift: Array, limits: Limits) -> tuple[float, float]:
    """Return the minimum and maximum total thrust for which no rotor saturates."""
    low, high = -np.inf, np.inf
    for rotor in range(given.shape[0]):
        low = max(low, (limits[0] - given[rotor]) / lift[rotor])
        high = min(high, (limits[1] - given[rotor]) / lift[rotor])
    return low, high


@compiled
def _share(given: Array, turn: Array, limits: Limits) -> float:
    """Return the largest share of a torque for which no rotor saturates."""
    share = 1.0
    for rotor in range(given.shape[0]):
        if turn[rotor] > 0.0:
            share = min(share, (limits[1] - given[rotor]) / turn[rotor])
        elif turn[rotor] < 0.0:
            share = min(share, (limits[0] - given[rotor]) / turn[rotor])
    return max(share, 0.0)


@compiled
def _share_with_any_thrust(given: Array, turn: Array, lift: Array, limits: Limits) -> float:
    """Return the largest share of a torque for which some total thrust saturates no rotor.

    For every pair of rotors, the minimum total thrust of one must not exceed the maximum of the
    other.
    """
    share = 1.0
    for i in range(given.shape[0]):
        for j in range(given.shape[0]):
            steeper = turn[j] / lift[j] - turn[i] / lift[i]
            if steeper > 0.0:
                room = (limits[1] - given[j]) / lift[j] - (limits[0] - given[i]) / lift[i]
                share = min(share, room / steeper)
    return max(share, 0.0)
