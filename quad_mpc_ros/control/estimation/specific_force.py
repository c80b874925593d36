# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The measurement model of the accelerometer.

An accelerometer measures the specific force, the acceleration minus gravity, in the body. The mean
over an interval follows from the predicted change of the velocity (:mod:`.translation_update`), so
no model of the forces is needed here:

    f_B = R' ((v(dt) - v) / dt - g) + a + n,     H = R' (F_v - E_v) / dt,   H_a = 1,

with the midpoint attitude R, the rows F_v and E_v of the velocity in the Jacobian and in the unit
matrix, the bias a and white noise n. The innovation corrects the state at the start of the
interval, before the prediction. Errors are of second order in the rotation: 0.2 % of the force at
10 rad/s and 20 ms.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import kalman
from quad_mpc_ros.control.estimation.filter_state import MOTION, SpecificForce
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.samples import ImuSample

_MAX_SAMPLES = 1024


class SpecificForces:
    """Buffers accelerometer samples until the next odometry."""

    def __init__(self) -> None:
        self._samples: deque[ImuSample] = deque(maxlen=_MAX_SAMPLES)
        self.newest_ns = 0
        """Stamp of the newest sample."""

    def add(self, sample: ImuSample) -> None:
        """Add a sample."""
        if sample.stamp_ns < self.newest_ns:  # a clock was set
            self._samples.clear()
        self._samples.append(sample)
        self.newest_ns = sample.stamp_ns

    def mean(self, *, start_ns: int, end_ns: int) -> Array | None:
        """Return the mean (3,) [m/s^2] of the samples in (start, end], None without samples.

        Samples up to ``end_ns`` are removed.
        """
        total, count = np.zeros(3), 0
        while self._samples and self._samples[0].stamp_ns <= end_ns:
            sample = self._samples.popleft()
            if sample.stamp_ns > start_ns:
                total += sample.f_B
                count += 1
        return total / count if count else None


@compiled
def force_innovation(
    x: Array,
    P: Array,
    F: Array,
    later: Array,
    between: tuple[StateRecord, StateRecord],
    duration: float,
    gravity: float,
    measured: SpecificForce,
) -> kalman.Innovation:
    """Return the innovation of a mean specific force.

    The state ``x`` (n,) of covariance ``P`` (n, n) is predicted to become ``later`` (n,) after a
    ``duration`` [s], with the Jacobian ``F``; ``between`` are the measured states at both ends.
    """
    H, nu = np.zeros((3, MOTION.size)), np.empty(3)
    R = kernels.matrix(between[0].R_WB)
    turn = kernels.log(kernels.multiply(kernels.transposed(R), kernels.matrix(between[1].R_WB)))
    R = kernels.multiply(R, kernels.exp(kernels.scaled(0.5, turn)))  # half way
    for k in range(3):
        axis = kernels.column(R, k)
        force = axis[2] * gravity
        for n in range(3):
            v, by_time = MOTION.velocity + n, axis[n] / duration
            force += by_time * (later[v] - x[v])
            for i in range(MOTION.accelerometer):
                H[k, i] += by_time * (F[v, i] - (1.0 if i == v else 0.0))
        H[k, MOTION.accelerometer + k] = 1.0
        nu[k] = measured.f_B[k] - force - x[MOTION.accelerometer + k]
    return kalman.innovation(P, H, measured.variance, nu)
