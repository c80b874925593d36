# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether body rates follow their commands like a ringing or slow rate loop.

Such a loop turns against its command temporarily, a reversed axis permanently. So the rates of
each axis are compared with the rates of a few loops (:mod:`..model.actuators`). A loop explains an
axis if the residual is below three quarters of the variance of the rates of the last seconds, or
no more than a slow motion. Saturated rotors limit the angular acceleration: the loops have bounds
that follow from the vehicle's own.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import axis_step, loop_step

# (tau, T) [s]: three of a damping ratio of 0.7, two that ring.
_LOOPS = np.array([(0.12, 0.06), (0.24, 0.12), (0.4, 0.2), (0.04, 0.06), (0.04, 0.16)])
_LOWPASS, _MEMORY = 0.05, 0.6  # s
_LEFT_SHARE, _FLOOR = 0.75, 0.3  # of the squares, and in rad/s

_OfLoops = Annotated[Array, (len(_LOOPS), 3)]


class PlausibleRates(Record):
    """Rates of each loop, both sides low-passed, with means and sums of squares."""

    rates: _OfLoops  # rad/s
    acceleration: _OfLoops  # rad/s^2
    expected: _OfLoops
    mean_expected: _OfLoops
    left: _OfLoops  # squares of the difference
    measured: Vector3
    mean_measured: Vector3
    squares: Vector3


@compiled
def start_loops(state: PlausibleRates, w: kernels.Vector) -> None:
    """Start all loops at body rates, and reset the comparison."""
    for axis in range(3):
        state.rates[:, axis] = w[axis]
        state.expected[:, axis] = state.mean_expected[:, axis] = w[axis]
        state.measured[axis] = state.mean_measured[axis] = w[axis]
    state.acceleration[:], state.left[:], state.squares[:] = 0.0, 0.0, 0.0


@compiled
def follow_loops(
    state: PlausibleRates,
    command: Array,
    w: kernels.Vector,
    acceleration_max: kernels.Vector,
    duration: float,
) -> None:
    """Compare body rates with the loops' rates after a command (3,) for a duration [s].

    ``acceleration_max`` bounds the demanded angular acceleration of each axis [rad/s^2].
    """
    share, forgotten = -math.expm1(-duration / _LOWPASS), -math.expm1(-duration / _MEMORY)
    for axis in range(3):
        state.measured[axis] += share * (w[axis] - state.measured[axis])
        state.mean_measured[axis] += forgotten * (state.measured[axis] - state.mean_measured[axis])
        y = state.measured[axis] - state.mean_measured[axis]
        state.squares[axis] += forgotten * (y * y - state.squares[axis])
        for k in range(len(_LOOPS)):
            loop = loop_step(_LOOPS[k, 0], _LOOPS[k, 1], acceleration_max[axis], duration)
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
def are_explained(state: PlausibleRates) -> bool:
    """Whether some loop explains the rates of each axis."""
    for axis in range(3):
        least = math.inf
        for k in range(len(_LOOPS)):
            least = min(least, state.left[k, axis])
        if least > max(_LEFT_SHARE * state.squares[axis], _FLOOR * _FLOOR):
            return False
    return True
