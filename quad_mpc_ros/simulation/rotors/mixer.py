"""The mixer: which thrust of each rotor gives a total thrust and a torque.

Thrust and torque are linear in the rotors' thrusts; the pseudo-inverse allocates them to any
number of rotors. Where a rotor saturates, airmode gives up thrust before torque, else torque goes
before thrust; in either case yaw, of which rotors have the least, before roll and pitch.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.rotors.craft import rotors_of
from quad_mpc_ros.simulation.rotors.parameters import RotorParameters

Limits = tuple[float, float]
"""Least and greatest thrust of a rotor [N]."""


class Share(Record):
    """Thrust of a rotor [N] over what all are to make together."""

    thrust: float  # over thrust [N]
    roll: float  # over the torque about each axis [N m]
    pitch: float
    yaw: float


def allocation(rotors: RotorParameters) -> Array:
    """Return what thrusts (n,) [N] of the rotors give together (4, n): thrust [N], torque [N m].

    As the autopilot knows it, about the origin of the body.
    """
    records = rotors_of(rotors, center_B=np.zeros(3))
    axis, spin = records["axis"], records["spin"][:, None]
    drag = rotors.torque_coefficient / rotors.thrust_coefficient * spin * axis
    return np.vstack((axis[:, 2], (np.cross(records["place"], axis) - drag).T))


def mixing(rotors: RotorParameters) -> RecordArray[Share]:
    """Return the shares of the rotors (n,).

    Raises :class:`ConfigurationError` for rotors that cannot make them.
    """
    given = allocation(rotors)
    mix = np.linalg.pinv(given)
    if not np.allclose(given @ mix, np.eye(4), atol=1e-6) or (mix[:, 0] <= 0.0).any():
        raise ConfigurationError(
            "simulator.rotors.x",
            rotors.x,
            "rotors that all lift, and together make thrust and every torque",
        )
    shares = Share.zeros(len(mix))
    shares["thrust"], shares["roll"], shares["pitch"], shares["yaw"] = mix.T
    return shares


@compiled
def mixed(
    thrust: float,
    torque: kernels.Vector,
    mix: RecordArray[Share],
    limits: Limits,
    airmode: bool,
    out: Array,
) -> tuple[float, float]:
    """Write the rotors' thrusts (n,) [N]; return the shares of the torques that are left.

    First that about roll and pitch, then that about yaw, each in [0, 1].
    """
    least, greatest = limits
    rotor_count = mix.shape[0]
    demand = np.empty((3, rotor_count))
    for rotor in range(rotor_count):
        share = mix[rotor]
        demand[0, rotor] = share.thrust
        demand[1, rotor] = share.roll * torque[0] + share.pitch * torque[1]
        demand[2, rotor] = share.yaw * torque[2]
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
    """Return the least and the greatest total thrust with which no rotor saturates."""
    low, high = -np.inf, np.inf
    for rotor in range(given.shape[0]):
        low = max(low, (limits[0] - given[rotor]) / lift[rotor])
        high = min(high, (limits[1] - given[rotor]) / lift[rotor])
    return low, high


@compiled
def _share(given: Array, turn: Array, limits: Limits) -> float:
    """Return the greatest share of a torque with which no rotor saturates."""
    share = 1.0
    for rotor in range(given.shape[0]):
        if turn[rotor] > 0.0:
            share = min(share, (limits[1] - given[rotor]) / turn[rotor])
        elif turn[rotor] < 0.0:
            share = min(share, (limits[0] - given[rotor]) / turn[rotor])
    return max(share, 0.0)


@compiled
def _share_with_any_thrust(given: Array, turn: Array, lift: Array, limits: Limits) -> float:
    """Return the greatest share of a torque for which there is a thrust that saturates no rotor.

    Of every two rotors, what the one needs at least must not be above what the other bears.
    """
    share = 1.0
    for i in range(given.shape[0]):
        for j in range(given.shape[0]):
            steeper = turn[j] / lift[j] - turn[i] / lift[i]
            if steeper > 0.0:
                room = (limits[1] - given[j]) / lift[j] - (limits[0] - given[i]) / lift[i]
                share = min(share, room / steeper)
    return max(share, 0.0)
