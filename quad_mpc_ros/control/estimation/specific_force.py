"""What an accelerometer measures, by the filter's own prediction.

An accelerometer measures the specific force, the acceleration less gravity, in the body. On the
average over a time it is what the velocity changed by, and the prediction says by how much it
does, f(x) of :mod:`.process_model`, so nothing of the forces is written again here:

    f_B = R' ((v(dt) - v) / dt - g) + a + n,     H = R' (F_v - E_v) / dt,   H_a = 1,

R the attitude half way, F_v and E_v the rows of the velocity of the Jacobian and of one, a the
accelerometer's bias, n white. It is a measurement of the state at the beginning of the time, and
comes before the prediction. Errors are of the second order in the turn over the time: 10 rad/s for
20 ms make 0.2 % of the force.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.estimation import kalman
from quad_mpc_ros.control.estimation.error_state import MOTION
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import StateRecord
from quad_mpc_ros.control.model.samples import ImuSample

_MOST_KEPT = 1024


class SpecificForce(Record):
    """The mean specific force between two odometries, and what became of it."""

    f_B: Vector3  # m/s^2
    variance: float  # m^2/s^4 along each axis, 0 where none was measured
    nis: float  # normalised innovation squared of the last one, of 3 degrees of freedom
    used: int  # whether the last one was


class SpecificForces:
    """Keeps what an accelerometer measured until the odometry after it has come."""

    def __init__(self) -> None:
        self._kept: deque[ImuSample] = deque(maxlen=_MOST_KEPT)
        self.newest_ns = 0
        """Stamp of the last one taken."""

    def add(self, sample: ImuSample) -> None:
        """Take a measurement, after those before."""
        if sample.stamp_ns < self.newest_ns:  # a clock was set
            self._kept.clear()
        self._kept.append(sample)
        self.newest_ns = sample.stamp_ns

    def mean(self, *, start_ns: int, end_ns: int) -> Array | None:
        """Return the mean (3,) [m/s^2] of those after a time until another, None without any.

        They and those before are forgotten.
        """
        total, count = np.zeros(3), 0
        while self._kept and self._kept[0].stamp_ns <= end_ns:
            sample = self._kept.popleft()
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
    """Return what a mean specific force says beyond the prediction.

    The state ``x`` (n,) of covariance ``P`` (n, n) is predicted to become ``later`` (n,) after a
    ``duration`` [s], with the Jacobian ``F``; ``between`` are the states measured at both ends.
    """
    H, nu = np.zeros((3, MOTION.size)), np.empty(3)
    R = half_way(between)
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


@compiled
def half_way(between: tuple[StateRecord, StateRecord]) -> kernels.Matrix:
    """Return the attitude half way between two that were measured."""
    before, after = kernels.matrix(between[0].R_WB), kernels.matrix(between[1].R_WB)
    turn = kernels.log(kernels.multiply(kernels.transposed(before), after))
    return kernels.multiply(before, kernels.exp(kernels.scaled(0.5, turn)))
