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

from quad_mpc_ros.lie import Array
from quad_mpc_ros.model.estimate_reset import EstimateReset

_OMEGA, _DAMPING = 3.0, 0.8  # rad/s
# A position so much further [m] than the velocity led to jumped.
_JUMP = 0.3
_MOST = 1.0  # m/s on each axis; what is more is no bias
_LONGEST_GAP = 0.5  # s


class VelocityBias:
    """Follows the bias ``b`` of the velocity in the world (3,) [m/s]."""

    def __init__(self) -> None:
        self._bias = [0.0, 0.0, 0.0]
        self._led = [0.0, 0.0, 0.0]
        self._v = [0.0, 0.0, 0.0]
        self._stamp_ns: int | None = None

    def follow(self, *, p_WB: Array, v_WB_W: Array, stamp_ns: int) -> list[float]:
        """Take an odometry, position (3,) [m] and velocity (3,) [m/s]; return the bias."""
        p, v = p_WB.tolist(), v_WB_W.tolist()
        duration = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) * 1e-9
        if 0.0 < duration <= _LONGEST_GAP:
            self._learn(p, v, duration)
        else:
            self._led = p
        self._v, self._stamp_ns = v, stamp_ns
        return self._bias

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate."""
        if self._stamp_ns is not None and self._stamp_ns < reset.stamp_ns:
            self._led = reset.points(np.array(self._led)).tolist()
            self._v = reset.vectors(np.array(self._v)).tolist()
            self._bias = reset.vectors(np.array(self._bias)).tolist()

    def _learn(self, p: list[float], v: list[float], duration: float) -> None:
        led = [
            self._led[k] + duration * (0.5 * (v[k] + self._v[k]) - self._bias[k]) for k in range(3)
        ]
        off = [p[k] - led[k] for k in range(3)]
        if math.hypot(*off) > _JUMP:
            self._led = p
            return
        share = 1.0 - math.exp(-2.0 * _DAMPING * _OMEGA * duration)
        turned = _OMEGA / (2.0 * _DAMPING) * share
        self._led = [led[k] + share * off[k] for k in range(3)]
        self._bias = [min(max(self._bias[k] - turned * off[k], -_MOST), _MOST) for k in range(3)]
