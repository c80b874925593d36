# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Manoeuvres in which the vehicle turns upside down: vertical loop and flip.

A vertical loop is a full circle in a vertical plane, from rest at its lowest point and back. The
angle is a smooth turn (:class:`.path.SmoothTurn`), so speed, acceleration and jerk are
continuous from hover to hover, and the path stays on the circle. At the top the thrust points
downwards when the centripetal acceleration v^2/r exceeds gravity.

A flip is a full rotation about the pitch or roll axis during a short climb and fall. During the
rotation the thrust is small and constant; minimum-snap legs lead from hover to the climb before
the rotation, and from the fall back to the start.

A vehicle that flips with little thrust falls. So its thrust is given over time instead of
positions, and the path follows from integration of the dynamics with drag. If drag differs between
the body axes, the mean across the thrust is used, without lift: the path remains feasible, its
thrust differs slightly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, parameter, per_axis
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import End, Leg, leg_within
from quad_mpc_ros.references.path import (
    Chain,
    CircularPath,
    Path,
    PathSamples,
    SmoothTurn,
    with_lowest_point,
)
from quad_mpc_ros.references.trajectory import TrajectoryParameters

_LEAST_PULL = 1.2  # centripetal acceleration at the top over gravity
_TOLERANCE = 1e-11
_UP = np.array([0.0, 0.0, 1.0])
_CLIMB_ACCELERATION = 0.5  # mean over the way to the turn, over gravity
_RECOVERY_ACCELERATION = 1.2  # over gravity
_SAMPLES = 201


@dataclass(frozen=True, kw_only=True)
class VerticalLoopParameters(TrajectoryParameters):
    """Parameters of a vertical loop."""

    loop_radius: float = parameter(
        1.5,
        doc="vertical_loop: radius.",
        unit="m",
        above=0.0,
        maximum=1e3,
    )
    loop_speed: float = parameter(
        5.5,
        doc="vertical_loop: speed at the highest point.",
        unit="m/s",
        above=0.0,
        maximum=1e3,
    )


def vertical_loop(config: VerticalLoopParameters) -> CircularPath:
    """Return the configured loop, flown forwards in the direction of the nose."""
    radius, speed = config.loop_radius, config.loop_speed
    least = math.sqrt(_LEAST_PULL * config.gravity * radius)
    if speed < least:
        raise ConfigurationError(
            f"{config.owner}.loop_speed",
            speed,
            f"at least {least:.3g} m/s, below which a loop of {radius:g} m radius needs no "
            "thrust at its top",
        )
    return CircularPath(
        np.array([*config.origin, config.height]),
        forwards=np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0]),
        inwards=np.array([0.0, 0.0, 1.0]),
        radius=radius,
        turn=SmoothTurn.with_peak_rate(math.tau, rate=speed / radius),
    )


@dataclass(frozen=True, kw_only=True)
class FlipParameters(TrajectoryParameters):
    """Parameters of a flip, with little thrust during the rotation."""

    flip_rate: float = parameter(
        12.0,
        doc="flip: highest body rate of the rotation.",
        unit="rad/s",
        minimum=1.0,
        maximum=1000.0,
    )
    coasting_thrust: float = parameter(
        0.3,
        doc="flip: thrust-to-weight ratio during the rotation.",
        minimum=0.01,
        maximum=1.0,
    )
    flip_axis: str = parameter("pitch", doc="flip: axis of rotation.", choices=("pitch", "roll"))

    @property
    def coasting_force(self) -> float:
        """Specific thrust during the rotation [m/s^2]."""
        return self.coasting_thrust * self.gravity

    @property
    def coasting_drag(self) -> float:
        """Mean drag across the coasting thrust [1/s], of body and rotors."""
        (x, y, _), (rotors_x, rotors_y, _) = per_axis(self.drag), per_axis(self.rotor_drag)
        rotors = 0.5 * (rotors_x + rotors_y) * math.sqrt(self.coasting_thrust)
        return (x if x == y else 0.5 * (x + y)) + rotors


class CoastingTurn:
    """The motion under a thrust of constant size that turns, from the end of a climb.

    dp/dt = v and dv/dt = f - g e_3 - mu v, integrated once by an order 8 method with dense output;
    acceleration and jerk follow from the thrust, so that flatness reproduces exactly this thrust.
    """

    periodic = False

    def __init__(
        self, turn: SmoothTurn, config: FlipParameters, *, p_WB: Array, v_WB_W: Array
    ) -> None:
        """Start at a position and a velocity, (3,) each."""
        from scipy.integrate import solve_ivp

        self.duration = turn.duration
        self._turn, self._config = turn, config
        forward = np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0])
        # The thrust turns forwards, or to the right.
        self._side = forward if config.flip_axis == "pitch" else np.cross(forward, _UP)

        def rate(time: float, state: Array) -> Array:
            acceleration = self._acceleration(self._thrust(np.array([time]))[0], state[None, 3:])
            return np.concatenate((state[3:], acceleration[0]))

        solved = solve_ivp(
            rate,
            (0.0, turn.duration),
            np.concatenate((p_WB, v_WB_W)),
            method="DOP853",
            dense_output=True,
            rtol=_TOLERANCE,
            atol=_TOLERANCE,
        )
        if solved.sol is None:
            raise ValueError(f"the motion under thrust cannot be integrated: {solved.message}")
        self._state = solved.sol

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s] from 0 to its duration."""
        seconds = np.clip(seconds, 0.0, self.duration)
        force, force_rate = self._thrust(seconds)
        state = self._state(seconds).T
        acceleration = self._acceleration(force, state[:, 3:])
        return PathSamples(
            p_WB=state[:, :3],
            v_WB_W=state[:, 3:],
            a_WB_W=acceleration,
            j_WB_W=force_rate - self._config.coasting_drag * acceleration,
        )

    def _acceleration(self, force: Array, v_WB_W: Array) -> Array:
        config = self._config
        weight = np.array([0.0, 0.0, config.gravity])
        return np.asarray(force - weight - config.coasting_drag * v_WB_W)

    def _thrust(self, seconds: Array) -> tuple[Array, Array]:
        """Return the specific thrust (n, 3) [m/s^2], and its time derivative."""
        angle, rate, _, _ = self._turn.at(seconds)
        sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
        direction = cosine * _UP + sine * self._side
        change = cosine * self._side - sine * _UP
        force = self._config.coasting_force
        return force * direction, force * rate[:, None] * change


def flip(config: FlipParameters) -> Path:
    """Return the configured flip, with the lowest point at the configured height."""
    turn = SmoothTurn.with_peak_rate(math.tau, rate=config.flip_rate)
    force, drag, gravity = config.coasting_force, config.coasting_drag, config.gravity
    # As high up as down: the climb that gravity, less the thrust's mean, takes back half way.
    times = np.linspace(0.0, turn.duration, _SAMPLES)
    lift = force * float(np.mean(np.cos(turn.at(times)[0])))
    climb = 0.5 * (gravity - lift) * turn.duration
    v_WB_W, rest = climb * _UP, End.at_rest(np.array([*config.origin, config.height]))
    a_WB_W = (force - gravity) * _UP - drag * v_WB_W
    end = End(p_WB=None, v_WB_W=v_WB_W, a_WB_W=a_WB_W, j_WB_W=-drag * a_WB_W)
    entry = Leg(rest, end, duration=climb / (_CLIMB_ACCELERATION * gravity))
    start = entry.at(np.array([entry.duration])).p_WB[0]
    over = CoastingTurn(turn, config, p_WB=start, v_WB_W=v_WB_W)
    recovery = leg_within(
        End.of(over.at(np.array([over.duration])), 0),
        rest,
        max_speed=math.inf,
        max_acceleration=_RECOVERY_ACCELERATION * gravity,
    )
    return with_lowest_point(Chain([entry, over, recovery]), config.height)
