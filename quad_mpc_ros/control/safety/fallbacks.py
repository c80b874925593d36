# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Controllers that need no solver: hover in place, and level and descend without odometry.

The hover law is geometric attitude control (Lee, Leok, McClamroch 2010) with body rates as the
input: a PID law on the position gives a specific force, the thrust axis turns towards the force,
yaw is free. The estimated thrust scale and disturbance are compensated, and the gains follow the
estimated rate loop.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.delay_compensation import LearnedModel
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.control.safety.command_limits import clamped
from quad_mpc_ros.control.stage import Stage

# Gains (x, y, z) for rate and thrust lags of 20 to 80 ms, delays up to 80 ms, 0.7 to 1.3 times
# the modelled thrust, and wind.
_POSITION_GAIN = np.array([2.2, 2.2, 5.0])  # 1/s^2
VELOCITY_GAIN = np.array([3.2, 3.2, 4.5])  # 1/s
_INTEGRAL_GAIN = np.array([0.6, 0.6, 3.0])  # 1/s^3
_INTEGRAL_LIMIT = np.array([3.0, 3.0, 5.0])  # m/s^2
_TILT_GAIN = 7.0  # 1/s
# Largest tilt gain over the natural frequency of the rate loop, and the damping ratio of the loop
# with which it is derived; a loop with less is damped by its angular acceleration.
_GAIN_OVER_FREQUENCY, _DAMPING = 0.45, 0.7
# Dead reckoning has no feedback, so no delay makes it oscillate.
_BLIND_TILT_GAIN = 10.0  # 1/s
# Limits of the commanded acceleration, which keep the tilt below 40 degrees.
_HORIZONTAL_LIMIT, _VERTICAL_LIMIT = 8.0, 5.0  # m/s^2
ACCELERATION_LIMIT = np.array([_HORIZONTAL_LIMIT, _HORIZONTAL_LIMIT, _VERTICAL_LIMIT])
_TURNING_TIME = 0.15  # s, until the thrust brakes
_BLIND_DESCENT = 0.1  # reduction of the hover throttle at the end of the blind time, a share
_DESCENT_SPEED = 2.0  # m/s, as after a fall from 0.2 m, with a dead reckoned velocity


class HoverFallback(Stage):
    """Brakes and holds a position."""

    def __init__(self, config: MpcConfig) -> None:
        self._config = config
        self._vehicle = config.vehicle()
        self._p_hold: Array | None = None
        self._integral = np.zeros(3)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed bounds; the held position is kept."""
        self._config = config

    def release(self) -> None:
        """Reset the held position; the next call holds the position at that time."""
        if self._p_hold is not None:
            self._p_hold, self._integral = None, np.zeros(3)

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the held position and the integral by an odometry jump."""
        if self._p_hold is not None:
            self._p_hold = reset.points(self._p_hold)
        self._integral = reset.vectors(self._integral)

    def engage(self, engaged: bool) -> None:
        """Reset the held position: another controller moves the vehicle."""
        self.release()

    def command(
        self,
        x: State,
        *,
        p_hold: Array | None = None,
        learned: LearnedModel | None = None,
        duration: float = 0.0,
    ) -> Input:
        """Return the command that brakes and holds the position of the first call.

        ``p_hold`` (3,) of the first call after the release, if given, is held instead. The error
        is integrated over ``duration`` [s].
        """
        if self._p_hold is None:
            self._p_hold = (x.p_WB if p_hold is None else p_hold).copy()
        error, model = self._p_hold - x.p_WB, learned or LearnedModel()
        # Slower turns need a slower loop around them.
        gain, damping = _tilt_law(model)
        pace = gain / _TILT_GAIN
        wanted = pace**2 * _POSITION_GAIN * error - pace * VELOCITY_GAIN * x.v_WB_W
        self._integrate(error, wanted, pace**3 * duration)
        wanted += self._integral
        horizontal = math.hypot(wanted[0], wanted[1])
        wanted[:2] *= min(1.0, _HORIZONTAL_LIMIT / max(horizontal, 1e-9))
        wanted[2] = min(max(wanted[2], -_VERTICAL_LIMIT), _VERTICAL_LIMIT)
        force = wanted - model.a_W
        force[2] += self._vehicle.gravity

        thrust = self._vehicle.mass * float(x.R_WB[:, 2] @ force) / model.thrust_scale
        throttle = self._vehicle.nearest_throttle(thrust)
        rates = gain * tilt_to(force, x.R_WB) + damping
        return clamped(Input(throttle=throttle, w_WB_B=rates), self._config)

    def _integrate(self, error: Array, wanted: Array, duration: float) -> None:
        """Integrate the error of axes whose commanded acceleration is within its limit."""
        free = np.abs(wanted) < ACCELERATION_LIMIT
        grown = self._integral + duration * _INTEGRAL_GAIN * np.where(free, error, 0.0)
        self._integral = np.clip(grown, -_INTEGRAL_LIMIT, _INTEGRAL_LIMIT)


class BlindFallback(Stage):
    """Levels the dead reckoned attitude, and descends slowly."""

    def __init__(self, config: MpcConfig) -> None:
        self._config = config
        self._vehicle = config.vehicle()
        self._R_WB: Array | None = None

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed bounds; the attitude is kept."""
        self._config = config

    def release(self) -> None:
        """Reset the dead reckoned attitude, as odometry is available."""
        self._R_WB = None

    def dead_reckon(self, R_WB: Array, w_WB_B: Array, *, duration: float) -> None:
        """Rotate the attitude at body rates (3,) [rad/s] for ``duration`` [s].

        The first call after the release starts at ``R_WB`` (3, 3), the last measured attitude.
        """
        last = R_WB if self._R_WB is None else self._R_WB
        self._R_WB = np.asarray(last @ so3.exp(duration * w_WB_B))

    def command(
        self,
        R_WB: Array,
        *,
        elapsed: float,
        learned: LearnedModel | None = None,
        v_WB_W: Array | None = None,
    ) -> Input:
        """Return the command ``elapsed`` seconds after the loss of odometry.

        ``R_WB`` (3, 3) is the last measured attitude, used without a dead reckoned attitude. With
        a dead reckoned velocity ``v_WB_W`` (3,) [m/s] the vehicle brakes first.
        """
        if self._R_WB is not None:
            R_WB = self._R_WB
        share = min(elapsed / max(self._config.blind_time, 1e-9), 1.0)
        model = learned or LearnedModel()
        force = np.array([0.0, 0.0, self._vehicle.gravity - model.a_W[2]])
        turn = levelling(R_WB, gain=_BLIND_TILT_GAIN)
        if v_WB_W is not None:
            braking = -VELOCITY_GAIN * (v_WB_W + np.array([0.0, 0.0, _DESCENT_SPEED]))
            most, gravity = ACCELERATION_LIMIT, self._vehicle.gravity
            force += np.clip(braking, (-most[0], -most[1], -gravity), most)
            # In free fall the tilt is limited as in hover.
            towards = np.array([force[0], force[1], max(force[2], gravity)])
            turn = _BLIND_TILT_GAIN * tilt_to(towards, R_WB)
        thrust = self._vehicle.mass * force[2] / model.thrust_scale
        throttle = self._vehicle.nearest_throttle(thrust) * (1.0 - _BLIND_DESCENT * share)
        return clamped(Input(throttle=throttle, w_WB_B=turn), self._config)


def _tilt_law(model: LearnedModel) -> tuple[float, Array]:
    """Return the gain from tilt to rates [1/s] that the rate loop can follow.

    Also return the rates (3,) [rad/s] to command against a ringing rate loop.
    """
    period = math.sqrt(model.rate_lag * model.torque_lag)  # one over the natural frequency
    gain = min(_TILT_GAIN, _GAIN_OVER_FREQUENCY / period) if period > 0.0 else _TILT_GAIN
    lacking = max(2.0 * _DAMPING * period - model.rate_lag, 0.0)
    roll, pitch, _yaw = model.acceleration
    return gain, -lacking * np.array([roll, pitch, 0.0])


def stop_within(corridor: Corridor, p_W: Array, *, v_WB_W: Array) -> Array:
    """Return the position (3,) to hold so that a vehicle at ``p_W`` stops inside a corridor.

    The braking distance beyond the planes of the first stage moves this position back.
    """
    held = p_W.copy()
    for n, b in zip(corridor.normals[0], corridor.offsets[0], strict=True):
        towards = max(float(n @ v_WB_W), 0.0)
        braking = towards * _TURNING_TIME + towards**2 / (2.0 * _HORIZONTAL_LIMIT)
        held -= max(float(n @ p_W) + braking - b, 0.0) * n
    return held


def tilt_to(direction_W: Array, R_WB: Array) -> Array:
    """Return the body rotation vector (3,) that turns the thrust axis to a world direction.

    The rotation is the shortest, so it has no yaw.
    """
    return so3.shortest_turn_of_z(R_WB.T @ direction_W)


def idle(config: MpcConfig) -> Input:
    """Return the idle command for a vehicle on the ground."""
    return Input(throttle=config.throttle_min, w_WB_B=np.zeros(3))


def levelling(R_WB: Array, *, gain: float = _TILT_GAIN) -> Array:
    """Return the body rates (3,) [rad/s], without yaw, that level a vehicle with a gain [1/s]."""
    return np.asarray(gain * tilt_to(np.array([0.0, 0.0, 1.0]), R_WB))
