"""A rate loop of second order, compiled: a proportional gain in front of a torque that lags.

For each axis, with the commanded rate w_c, the gain 1 / tau and the lag T of the torque,

    dw/dt = alpha,    T dalpha/dt = clamp((w_c - w) / tau, -alpha_max, alpha_max) - alpha.

The natural frequency is 1 / sqrt(tau T) and the damping ratio sqrt(tau / T) / 2. With a gain D
on the angular acceleration the loop is the same with tau and T divided by 1 + D. Without T the
rate lags by tau alone, as fast as alpha_max permits.
"""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import kernels


class RateLoop(NamedTuple):
    """The numbers of the loop of each axis."""

    time_constant: kernels.Vector  # tau [s]
    torque_time_constant: kernels.Vector  # T [s]
    acceleration_max: kernels.Vector  # rad/s^2


AxisState = tuple[float, float]
"""Body rate [rad/s] and angular acceleration [rad/s^2]."""


@compiled
def controlled_rates(
    w_WB_B: kernels.Vector,
    acceleration: kernels.Vector,
    command: kernels.Vector,
    loop: RateLoop,
    duration: float,
) -> tuple[kernels.Vector, kernels.Vector]:
    """Return body rates and angular accelerations after ``duration`` [s] under one command."""
    roll = _axis_after((w_WB_B[0], acceleration[0]), command[0], _axis(loop, 0), duration)
    pitch = _axis_after((w_WB_B[1], acceleration[1]), command[1], _axis(loop, 1), duration)
    yaw = _axis_after((w_WB_B[2], acceleration[2]), command[2], _axis(loop, 2), duration)
    return (roll[0], pitch[0], yaw[0]), (roll[1], pitch[1], yaw[1])


@compiled
def turned(
    w: tuple[kernels.Vector, kernels.Vector],
    acceleration: tuple[kernels.Vector, kernels.Vector],
    duration: float,
) -> kernels.Matrix:
    """Return the rotation over ``duration`` [s] between two body rates.

    ``w`` and ``acceleration`` are at the beginning and at the end. The integral of the rates is
    that of the cubic through them (Hermite); their commutator counts as in
    :func:`.actuators.turn`.
    """
    half, twelfth = 0.5 * duration, duration * duration / 12.0
    mean = kernels.scaled(half, kernels.plus(w[0], w[1]))
    bend = kernels.scaled(twelfth, kernels.minus(acceleration[0], acceleration[1]))
    twist = kernels.scaled(twelfth, kernels.cross(w[0], w[1]))
    return kernels.exp(kernels.plus(kernels.plus(mean, bend), twist))


@compiled
def _axis(loop: RateLoop, k: int) -> kernels.Vector:
    return loop.time_constant[k], loop.torque_time_constant[k], loop.acceleration_max[k]


@compiled
def _axis_after(
    state: AxisState, command: float, loop: kernels.Vector, duration: float
) -> AxisState:
    """Return an axis after one Runge-Kutta step of order 4."""
    half = 0.5 * duration
    k1 = _slope(state, command, loop)
    k2 = _slope(_moved(state, k1, half), command, loop)
    k3 = _slope(_moved(state, k2, half), command, loop)
    k4 = _slope(_moved(state, k3, duration), command, loop)
    w, alpha = _moved(state, k1, duration / 6.0)
    w, alpha = _moved((w, alpha), k2, duration / 3.0)
    w, alpha = _moved((w, alpha), k3, duration / 3.0)
    w, alpha = _moved((w, alpha), k4, duration / 6.0)
    if loop[1] == 0.0:
        alpha = _slope((w, alpha), command, loop)[0]
    return w, alpha


@compiled
def _slope(state: AxisState, command: float, loop: kernels.Vector) -> AxisState:
    (w, alpha), (tau, torque_lag, most) = state, loop
    wanted = kernels.clamp((command - w) / tau, -most, most)
    return (alpha, (wanted - alpha) / torque_lag) if torque_lag > 0.0 else (wanted, 0.0)


@compiled
def _moved(state: AxisState, slope: AxisState, duration: float) -> AxisState:
    return state[0] + duration * slope[0], state[1] + duration * slope[1]
