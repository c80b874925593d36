"""By how much the measured velocity disagrees with how the measured position moves.

An autopilot's estimator corrects its position by GPS or vision more than its velocity, and the
two disagree by tenths of a metre per second for seconds on end. A controller that weighs both
holds the vehicle where their errors cancel, beside the reference: by some 0.4 m for each m/s, with
position and velocity weighted 10 : 1. What is to be held is the position; so the velocity is
believed in what changes quickly, and the position's motion in what changes slowly:

    d q / dt = v - b + 2 zeta omega (p - q)         q, the position as the velocity leads on
    d b / dt = -omega^2 (p - q)
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset

_OMEGA, _DAMPING = 3.0, 0.8  # rad/s
# A position so much further [m] than the velocity led to jumped.
_JUMP = 0.3
_MOST = 1.0  # m/s on each axis; what is more is no bias
_LONGEST_GAP = 0.5  # s

# A vector of the bias, where the velocity led, and the velocity; and whether it is asked for.
_BIAS, _LED, _V = slice(0, 3), slice(3, 6), slice(6, 9)
_ASKED, SIZE = 9, 10


def begun(*, asked: bool = True) -> Array:
    """Return what is believed at the start (10,); unless it is ``asked`` there is no bias."""
    bias = np.zeros(SIZE)
    bias[_ASKED] = asked
    return bias


def reset_estimate(bias: Array, reset: EstimateReset) -> None:
    """Take an announced step of the estimate."""
    bias[_LED] = reset.points(bias[_LED])
    bias[_V] = reset.vectors(bias[_V])
    bias[_BIAS] = reset.vectors(bias[_BIAS])


@compiled
def correct(bias: Array, p_WB: Array, v_WB_W: Array, duration: float) -> None:
    """Take an odometry, position (3,) [m] and velocity (3,) [m/s], and take the bias off that.

    It is ``duration`` [s] after the one before; 0 for the first.
    """
    if bias[_ASKED] == 0.0:
        return
    _follow(bias, p_WB=p_WB, v_WB_W=v_WB_W, duration=duration)
    for k in range(3):
        v_WB_W[k] -= bias[k]


@compiled
def _follow(bias: Array, p_WB: Array, v_WB_W: Array, duration: float) -> None:
    """Go on to an odometry."""
    led, before, square = bias[_LED], bias[_V], 0.0
    for k in range(3):
        led[k] += duration * (0.5 * (v_WB_W[k] + before[k]) - bias[k])
        before[k] = v_WB_W[k]
        square += (p_WB[k] - led[k]) ** 2
    if not 0.0 < duration <= _LONGEST_GAP or math.sqrt(square) > _JUMP:
        led[:] = p_WB
        return
    share = 1.0 - math.exp(-2.0 * _DAMPING * _OMEGA * duration)
    turned = _OMEGA / (2.0 * _DAMPING) * share
    for k in range(3):
        off = p_WB[k] - led[k]
        led[k] += share * off
        bias[k] = kernels.clamp(bias[k] - turned * off, -_MOST, _MOST)
