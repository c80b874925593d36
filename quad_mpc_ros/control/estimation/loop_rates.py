# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measured body rates, compared with the rates of loops that follow the commands.

The loops are not corrected by measurements. Both sides are low-passed and compared without their
means of the last seconds, because rates have offsets from their commands.
"""

from __future__ import annotations

import math
from typing import Annotated

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import axis_step, loop_step

_LOWPASS, _MEMORY = 0.05, 0.6  # s
FLOOR = 0.3
"""Root of the mean square of a slow motion, which need not be explained [rad/s]."""

_OneLoop = Annotated[Array, (1, 3)]


class LoopRates(Record):
    """Rates of one loop and measured rates, low-passed, with means and mean squares.

    ``left`` are mean squares of the difference, ``squares`` of the measured rates.
    """

    measured: Vector3
    mean_measured: Vector3
    squares: Vector3
    rates: _OneLoop  # rad/s
    acceleration: _OneLoop  # rad/s^2
    expected: _OneLoop
    mean_expected: _OneLoop
    left: _OneLoop


@compiled
def start_loops(state: LoopRates, w: kernels.Vector) -> None:
    """Start all loops at body rates, and reset the comparison."""
    for axis in range(3):
        state.rates[:, axis] = w[axis]
        state.expected[:, axis] = state.mean_expected[:, axis] = w[axis]
        state.measured[axis] = state.mean_measured[axis] = w[axis]
    state.acceleration[:], state.left[:], state.squares[:] = 0.0, 0.0, 0.0


@compiled
def follow_loops(
    state: LoopRates,
    loops: Array,
    command: Array,
    w: kernels.Vector,
    acceleration_max: kernels.Vector,
    duration: float,
) -> None:
    """Compare body rates with the rates of n loops after a command (3,) for a duration [s].

    ``loops`` (n, 3, 2) are the time constants tau and T of each axis [s], ``acceleration_max``
    bounds the demanded angular acceleration of each axis [rad/s^2].
    """
    share, forgotten = -math.expm1(-duration / _LOWPASS), -math.expm1(-duration / _MEMORY)
    for axis in range(3):
        state.measured[axis] += share * (w[axis] - state.measured[axis])
        state.mean_measured[axis] += forgotten * (state.measured[axis] - state.mean_measured[axis])
        y = state.measured[axis] - state.mean_measured[axis]
        state.squares[axis] += forgotten * (y * y - state.squares[axis])
        for k in range(len(loops)):
            tau, lag = loops[k, axis, 0], loops[k, axis, 1]
            loop = loop_step(tau, lag, acceleration_max[axis], duration)
            after = axis_step(
                loop, state.rates[k, axis], state.acceleration[k, axis], command[axis]
            )
            state.rates[k, axis], state.acceleration[k, axis] = after.rate, after.acceleration
            state.expected[k, axis] += share * (after.rate - state.expected[k, axis])
            off = state.expected[k, axis] - state.mean_expected[k, axis]
            state.mean_expected[k, axis] += forgotten * off
            x = state.expected[k, axis] - state.mean_expected[k, axis]
            state.left[k, axis] += forgotten * ((y - x) * (y - x) - state.left[k, axis])


@compiled
def unexplained(state: LoopRates) -> float:
    """Return the share of the roll and pitch rates that the loop leaves, at most 1."""
    left, squares = state.left[0, :2].sum(), state.squares[:2].sum()
    return float(min(left / (squares + FLOOR**2), 1.0))
