"""A path defined by its thrust over time instead of positions.

A vehicle that flips with little thrust falls. So the thrust is given, and the path follows from
integration of the dynamics with drag. If drag differs between the body axes, the mean across the
thrust is used, without lift: the path remains feasible, its thrust differs slightly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter, per_axis
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import End, Leg
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.references.smooth_turn import SmoothTurn
from quad_mpc_ros.references.trajectory import TrajectoryParameters

Thrust = Callable[[Array], tuple[Array, Array]]
"""Returns the specific thrust (n, 3) [m/s^2] at times (n,) [s], and its time derivative."""

_TOLERANCE = 1e-11
_UP = np.array([0.0, 0.0, 1.0])


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
