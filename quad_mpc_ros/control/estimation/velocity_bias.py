"""By how much the measured velocity disagrees with how the measured position moves.

An autopilot's estimator corrects its position by GPS or vision more than its velocity, and the
two disagree by tenths of a metre per second for seconds on end. A controller that weighs both
holds the vehicle where their errors cancel, beside the reference: by some 0.4 m for each m/s, with
position and velocity weighted 10 : 1. What is to be held is the position; so fast
changes are taken from the velocity, and slow ones from the position's motion:

    d q / dt = v - b + 2 zeta omega (p - q)         q, the position as the velocity leads on
    d b / dt = -omega^2 (p - q)
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset

_OMEGA, _DAMPING = 3.0, 0.8  # rad/s
# A position so much further [m] than the velocity led to jumped.
_JUMP = 0.3
_MOST = 1.0  # m/s on each axis; what is more is no bias
_LONGEST_GAP = 0.5  # s


class VelocityBias(Record):
    """What is known of the bias."""

    enabled: int  # whether it is estimated; else there is none
    b: Vector3  # m/s
    q: Vector3  # m, the position as the velocity leads on
    v: Vector3  # m/s, as measured last


def reset_estimate(bias: VelocityBias, reset: EstimateReset) -> None:
    """Take an announced step of the estimate."""
    bias.q[:] = reset.points(bias.q)
    bias.v[:] = reset.vectors(bias.v)
    bias.b[:] = reset.vectors(bias.b)


@compiled
def correct(bias: VelocityBias, p_WB: Array, v_WB_W: Array, duration: float) -> None:
    """Take an odometry, position (3,) [m] and velocity (3,) [m/s], and take the bias off that.

    It is ``duration`` [s] after the one before; 0 for the first.
    """
    if not bias.enabled:
        return
    _follow(bias, p_WB=p_WB, v_WB_W=v_WB_W, duration=duration)
    for k in range(3):
        v_WB_W[k] -= bias.b[k]


@compiled
def _follow(bias: VelocityBias, p_WB: Array, v_WB_W: Array, duration: float) -> None:
    """Go on to an odometry."""
    b, q, before, square = bias.b, bias.q, bias.v, 0.0
    for k in range(3):
        q[k] += duration * (0.5 * (v_WB_W[k] + before[k]) - b[k])
        before[k] = v_WB_W[k]
        square += (p_WB[k] - q[k]) ** 2
    if not 0.0 < duration <= _LONGEST_GAP or math.sqrt(square) > _JUMP:
        q[:] = p_WB
        return
    share = 1.0 - math.exp(-2.0 * _DAMPING * _OMEGA * duration)
    turned = _OMEGA / (2.0 * _DAMPING) * share
    for k in range(3):
        off = p_WB[k] - q[k]
        q[k] += share * off
        b[k] = kernels.clamp(b[k] - turned * off, -_MOST, _MOST)
