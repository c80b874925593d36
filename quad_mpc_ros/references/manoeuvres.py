# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Manoeuvres in which the vehicle turns upside down: vertical loop, flip and split-S.

A vertical loop is a full circle in a vertical plane, from rest at its lowest point and back. The
angle is a smooth turn (:class:`.path.SmoothTurn`), so speed, acceleration and jerk are
continuous from hover to hover, and the path stays on the circle. At the top the thrust points
downwards when the centripetal acceleration v^2/r exceeds gravity.

A flip is a full rotation about the pitch or roll axis during a short climb and fall. During the
rotation the thrust is small and constant; minimum-snap legs lead from hover to the climb before
the rotation, and from the fall back to the start.

A split-S accelerates, rolls upside down, pulls through downwards, and flies back. The thrust is
low in the roll and higher in the pull; a minimum-snap leg brakes from the remaining speed. The
final heading is opposite to the initial one, because the body turns with its thrust axis and never
about this axis.

A vehicle that flips with little thrust falls. So the thrust of flip and split-S is given over time
instead of positions, and the path follows from integration of the dynamics with drag. If drag
differs between the body axes, the mean across the thrust is used, without lift: the path remains
feasible, its thrust differs slightly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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
Thrust = Callable[[Array], tuple[Array, Array]]
"""Returns the specific thrust (n, 3) [m/s^2] at times (n,) [s], and its time derivative."""

_TOLERANCE = 1e-11
_UP = np.array([0.0, 0.0, 1.0])
_UP = np.array([0.0, 0.0, 1.0])
_CLIMB_ACCELERATION = 0.5  # mean over the way to the turn, over gravity
_RECOVERY_ACCELERATION = 1.2  # over gravity
_SAMPLES = 201
_UP = np.array([0.0, 0.0, 1.0])
_RUN_UP_ACCELERATION = 0.5  # mean, over gravity
_BRAKING_ACCELERATION = 1.0  # over gravity
_PULL_SPEED_RATIO = 1.6  # mean over that at the top
_MAX_PULL = 3.0  # strongest, over gravity


@dataclass(frozen=True, kw_only=True)
class VerticalLoopParameters(TrajectoryParameters):
    """Parameters of a vertical loop; a split-S ends with half a loop."""

    loop_radius: float = parameter(
        1.5,
        doc="vertical_loop: radius. split_s: radius of the inverted part.",
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
class TurnParameters(TrajectoryParameters):
    """Parameters of a turn with little thrust."""

    flip_rate: float = parameter(
        12.0,
        doc="flip, split_s: highest body rate of the rotation.",
        unit="rad/s",
        minimum=1.0,
        maximum=1000.0,
    )
    coasting_thrust: float = parameter(
        0.3,
        doc="flip, split_s: thrust-to-weight ratio during the rotation.",
        minimum=0.01,
        maximum=1.0,
    )


class ThrustPath:
    """The motion under thrust from a position and velocity, (3,) each.

    dp/dt = v and dv/dt = f - g e_3 - mu v, integrated once by an order 8 method with dense output;
    acceleration and jerk follow from the thrust, so that flatness reproduces exactly this thrust.
    """

    periodic = False

    def __init__(
        self,
        thrust: Thrust,
        config: TurnParameters,
        *,
        duration: float,
        p_WB: Array,
        v_WB_W: Array,
    ) -> None:
        from scipy.integrate import solve_ivp

        self.duration = duration
        self._thrust, self._config = thrust, config
        self._weight = np.array([0.0, 0.0, config.gravity])

        def rate(time: float, state: Array) -> Array:
            force, force_rate = thrust(np.array([time]))
            drag, _ = _mean_drag(config, force, force_rate)
            return np.concatenate((state[3:], force[0] - self._weight - drag[0] * state[3:]))

        solved = solve_ivp(
            rate,
            (0.0, duration),
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
        drag, drag_rate = _mean_drag(self._config, force, force_rate)
        acceleration = force - self._weight - drag * state[:, 3:]
        return PathSamples(
            p_WB=state[:, :3],
            v_WB_W=state[:, 3:],
            a_WB_W=acceleration,
            j_WB_W=force_rate - drag * acceleration - drag_rate * state[:, 3:],
        )


def _mean_drag(config: TurnParameters, force: Array, force_rate: Array) -> tuple[Array, Array]:
    """Return the mean drag across the thrust [1/s] and its rate [1/s^2], (n, 1) each.

    The drag is from the body, and from the rotors at their speed with specific thrusts ``force``
    (n, 3) [m/s^2] with the rates ``force_rate``.
    """
    (x, y, _), (rotors_x, rotors_y, _) = per_axis(config.drag), per_axis(config.rotor_drag)
    air, rotors = x if x == y else 0.5 * (x + y), 0.5 * (rotors_x + rotors_y)
    size = np.linalg.norm(force, axis=1, keepdims=True)
    speed = np.sqrt(size / config.gravity)
    size_rate = np.sum(force * force_rate, axis=1, keepdims=True) / size
    speed_rate = 0.5 * size_rate / (config.gravity * speed)
    return air + rotors * speed, rotors * speed_rate


def turning_over(
    turn: SmoothTurn, v_WB_W: Array, config: TurnParameters, *, towards: Array, entry: float
) -> tuple[Leg, ThrustPath]:
    """Return a leg of ``entry`` [s] from hovering to a velocity (3,) [m/s], and the turn there.

    The leg ends in the state at the start of the turn: moving upwards with the coasting thrust. In
    the turn this thrust is constant and rotates through a direction ``towards`` (3,).
    """
    gravity = config.gravity
    force = config.coasting_thrust * gravity
    (((drag,),), _) = _mean_drag(config, force * _UP[None], np.zeros((1, 3)))
    acceleration = (force - gravity) * _UP - drag * v_WB_W
    leg = Leg(
        End.at_rest(np.array([*config.origin, config.height])),
        End(p_WB=None, v_WB_W=v_WB_W, a_WB_W=acceleration, j_WB_W=-drag * acceleration),
        duration=entry,
    )

    def thrust(seconds: Array) -> tuple[Array, Array]:
        angle, rate, _, _ = turn.at(seconds)
        sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
        direction = cosine * _UP + sine * towards
        return force * direction, force * rate[:, None] * (cosine * towards - sine * _UP)

    start = leg.at(np.array([entry])).p_WB[0]
    return leg, ThrustPath(thrust, config, duration=turn.duration, p_WB=start, v_WB_W=v_WB_W)


@dataclass(frozen=True, kw_only=True)
class FlipParameters(TurnParameters):
    """Parameters of a flip."""

    flip_axis: str = parameter("pitch", doc="flip: axis of rotation.", choices=("pitch", "roll"))


def flip(config: FlipParameters) -> Path:
    """Return the configured flip, with the lowest point at the configured height."""
    turn = SmoothTurn.with_peak_rate(math.tau, rate=config.flip_rate)
    force = config.coasting_thrust * config.gravity
    # As high up as down: the climb that gravity, less the thrust's mean, takes back half way.
    times = np.linspace(0.0, turn.duration, _SAMPLES)
    lift = force * float(np.mean(np.cos(turn.at(times)[0])))
    climb = 0.5 * (config.gravity - lift) * turn.duration
    entry, over = turning_over(
        turn,
        climb * _UP,
        config,
        towards=_side(config),
        entry=climb / (_CLIMB_ACCELERATION * config.gravity),
    )
    recovery = leg_within(
        End.of(over.at(np.array([over.duration])), 0),
        End.at_rest(np.array([*config.origin, config.height])),
        max_speed=math.inf,
        max_acceleration=_RECOVERY_ACCELERATION * config.gravity,
    )
    return with_lowest_point(Chain([entry, over, recovery]), config.height)


def _side(config: FlipParameters) -> Array:
    """Return the horizontal direction (3,) to which the thrust turns: forwards, or right."""
    forward = np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0])
    return forward if config.flip_axis == "pitch" else np.cross(forward, _UP)


@dataclass(frozen=True, kw_only=True)
class SplitSParameters(VerticalLoopParameters, TurnParameters):
    """Parameters of a split-S: parameters of a loop and of a rotation."""


def split_s(config: SplitSParameters) -> Path:
    """Return the configured split-S, with the lowest point at the configured height."""
    force = config.coasting_thrust * config.gravity
    forward = np.array([math.cos(config.yaw), math.sin(config.yaw), 0.0])
    # The speed at which gravity and this thrust bend the inverted path to the radius.
    speed = math.sqrt(config.loop_radius * (config.gravity + force))
    roll = SmoothTurn.with_peak_rate(math.pi, rate=config.flip_rate)
    climb = 0.5 * config.gravity * roll.duration  # gone when the roll ends
    run_up, rolling = turning_over(
        roll,
        speed * forward + climb * _UP,
        config,
        towards=np.cross(forward, _UP),
        entry=speed / (_RUN_UP_ACCELERATION * config.gravity),
    )
    inverted = rolling.at(np.array([rolling.duration]))
    turn = SmoothTurn(math.pi, duration=math.pi * config.loop_radius / (_PULL_SPEED_RATIO * speed))
    pull = ThrustPath(
        _pulling(turn, force=force, hover=config.gravity, forward=forward),
        config,
        duration=turn.duration,
        p_WB=inverted.p_WB[0],
        v_WB_W=inverted.v_WB_W[0],
    )
    braking = leg_within(
        End.of(pull.at(np.array([pull.duration])), 0),
        End.at_rest(None),
        max_speed=math.inf,
        max_acceleration=_BRAKING_ACCELERATION * config.gravity,
    )
    return with_lowest_point(Chain([run_up, rolling, pull, braking]), config.height)


def _pulling(turn: SmoothTurn, *, force: float, hover: float, forward: Array) -> Thrust:
    """Return a thrust from ``force`` downwards via backwards to ``hover`` upwards.

    The thrust is strongest in the second half, where it must also compensate gravity.
    """
    strength = _MAX_PULL * hover
    peak = float(turn.at(np.array([0.5 * turn.duration]))[1][0])

    def thrust(seconds: Array) -> tuple[Array, Array]:
        angle, rate, rate_1, _ = turn.at(seconds)
        share, share_rate = angle / math.pi, rate / math.pi
        amount = force + (hover - force) * share + strength * share * rate / peak
        change = (hover - force) * share_rate + strength * (
            share_rate * rate / peak + share * rate_1 / peak
        )
        sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
        direction = -cosine * _UP - sine * forward
        direction_rate = rate[:, None] * (sine * _UP - cosine * forward)
        amount, change = amount[:, None], change[:, None]
        return amount * direction, change * direction + amount * direction_rate

    return thrust
