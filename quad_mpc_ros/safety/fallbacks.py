"""Controllers that need no solver: hover in place, and level and descend without odometry.

The hover law is geometric attitude control (Lee, Leok, McClamroch 2010) with body rates as the
input: a proportional-derivative law on position asks for a specific force, the thrust axis is
turned towards it, and yaw is left as it is.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.state import Input, State
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.safety.command_limits import clamped

_POSITION_GAIN = 4.0  # 1/s^2: with the next one a closed loop of 2 rad/s, critically damped
_VELOCITY_GAIN = 4.0  # 1/s
_TILT_GAIN = 10.0  # 1/s
_HORIZONTAL_LIMIT = 8.0  # m/s^2, keeps the asked tilt below 40 degrees
_VERTICAL_LIMIT = 5.0  # m/s^2
_BLIND_DESCENT = 0.2  # fraction of the hover throttle given up by the end of the blind time


class HoverFallback:
    """Brakes and holds a position."""

    def __init__(self, config: MpcConfig) -> None:
        self._config = config
        self._vehicle = config.vehicle()
        self._p_hold: Array | None = None

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed bounds; the held position stays."""
        self._config = config

    def release(self) -> None:
        """Forget the held position; the next call holds where the vehicle is then."""
        self._p_hold = None

    def command(self, x: State, *, p_hold: Array | None = None) -> Input:
        """Return the command that brakes and holds the position where it was engaged.

        Or ``p_hold`` (3,), as given with the first call after the release.
        """
        if self._p_hold is None:
            self._p_hold = (x.p_WB if p_hold is None else p_hold).copy()
        wanted = _POSITION_GAIN * (self._p_hold - x.p_WB) - _VELOCITY_GAIN * x.v_WB_W
        horizontal = math.hypot(wanted[0], wanted[1])
        wanted[:2] *= min(1.0, _HORIZONTAL_LIMIT / max(horizontal, 1e-9))
        wanted[2] = min(max(wanted[2], -_VERTICAL_LIMIT), _VERTICAL_LIMIT)
        wanted[2] += self._vehicle.gravity

        thrust = self._vehicle.mass * float(x.R_WB[:, 2] @ wanted)
        throttle = self._vehicle.nearest_throttle(thrust)
        u = Input(throttle=throttle, w_WB_B=_TILT_GAIN * tilt_to(wanted, x.R_WB))
        return clamped(u, self._config)


class BlindFallback:
    """Levels the attitude that dead reckoning still knows, and lets the vehicle sink slowly."""

    def __init__(self, config: MpcConfig) -> None:
        self._config = config
        self._hover_throttle = config.vehicle().hover_throttle
        self._R_WB: Array | None = None

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed bounds; the attitude stays."""
        self._config = config

    def release(self) -> None:
        """Forget the attitude by dead reckoning: there is odometry."""
        self._R_WB = None

    def dead_reckon(self, R_WB: Array, w_WB_B: Array, *, duration: float) -> None:
        """Turn on at body rates (3,) [rad/s] for ``duration`` [s].

        The first call after the release begins at ``R_WB`` (3, 3), the last attitude seen.
        """
        seen = R_WB if self._R_WB is None else self._R_WB
        self._R_WB = dead_reckoned(seen, w_WB_B, duration=duration)

    def command(self, R_WB: Array, *, elapsed: float) -> Input:
        """Return the command ``elapsed`` seconds after going blind.

        ``R_WB`` (3, 3) is the last attitude seen, from which dead reckoning may have gone on.
        """
        if self._R_WB is not None:
            R_WB = self._R_WB
        share = min(elapsed / max(self._config.blind_time, 1e-9), 1.0)
        throttle = self._hover_throttle * (1.0 - _BLIND_DESCENT * share)
        u = Input(throttle=throttle, w_WB_B=_TILT_GAIN * tilt_to(np.array([0.0, 0.0, 1.0]), R_WB))
        return clamped(u, self._config)


def tilt_to(direction_W: Array, R_WB: Array) -> Array:
    """Return the body rotation vector (3,) that turns the thrust axis to a world direction.

    It is the shortest rotation between the two, so it has no yaw.
    """
    return so3.shortest_turn_of_z(R_WB.T @ direction_W)


def idle(config: MpcConfig) -> Input:
    """Return the command of a vehicle that is to stay on the ground."""
    return Input(throttle=config.throttle_min, w_WB_B=np.zeros(3))


def dead_reckoned(R_WB: Array, w_WB_B: Array, *, duration: float) -> Array:
    """Return the attitude after turning at ``w_WB_B`` for ``duration`` seconds."""
    return np.asarray(R_WB @ so3.exp(duration * w_WB_B))
