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

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.estimate_reset import EstimateReset

_OMEGA, _DAMPING = 3.0, 0.8  # rad/s
# A position so much further [m] than the velocity led to jumped.
_JUMP = 0.3
_MOST = 1.0  # m/s on each axis; what is more is no bias
_LONGEST_GAP = 0.5  # s


class VelocityBias:
    """Follows the bias ``b`` of the velocity in the world (3,) [m/s]."""

    def __init__(self) -> None:
        self._bias, self._led, self._v = self._state = np.zeros((3, 3))
        self._stamp_ns: int | None = None

    def follow(self, *, p_WB: Array, v_WB_W: Array, stamp_ns: int) -> Array:
        """Take an odometry, position (3,) [m] and velocity (3,) [m/s]; return the bias.

        The next call overwrites it.
        """
        duration = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = stamp_ns
        _follow(p_WB=p_WB, v_WB_W=v_WB_W, duration=duration, state=self._state)
        return self._bias

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate."""
        if self._stamp_ns is not None and self._stamp_ns < reset.stamp_ns:
            self._led[:] = reset.points(self._led)
            self._v[:] = reset.vectors(self._v)
            self._bias[:] = reset.vectors(self._bias)


@compiled
def _follow(p_WB: Array, v_WB_W: Array, duration: float, state: Array) -> None:
    """Go on to an odometry; the state (3, 3) is bias, where the velocity led, and velocity."""
    bias, led, before = state[0], state[1], state[2]
    square = 0.0
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
