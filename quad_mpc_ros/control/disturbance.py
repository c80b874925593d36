"""Estimating what the model does not explain: an acceleration and a scale of the thrust.

A Kalman filter on the velocity: between two odometries it is predicted with the commands that
were really acting, delayed and lagged, and the difference to the measured velocity is shared
between an acceleration in the world (wind, drag) and a factor on the thrust (mass, battery). Both
are random walks. The two look alike at hover and part company as the vehicle tilts.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.prediction import Disturbance
from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.core.vehicle import Vehicle

_V, _D, _K = slice(0, 3), slice(3, 6), 6
_SIZE = 7

_VELOCITY_NOISE = 0.03  # m/s, of a measurement
_ACCELERATION_NOISE = 0.3  # m/s^2 / sqrt(Hz), of the model within a step
_ACCELERATION_WALK = 1.5  # m/s^2 / sqrt(s)
_SCALE_WALK = 0.15  # 1 / sqrt(s)
_ACCELERATION_SPREAD, _SCALE_SPREAD = 1.0, 0.2  # at the start
_ACCELERATION_BOUND = 5.0  # m/s^2
_SCALE_BOUNDS = (0.5, 1.5)
# At rest and not lifted: on the ground, which carries what the thrust does not.
_REST_SPEED, _LIFT = 0.1, 1.02


class DisturbanceEstimator:
    """Estimates the disturbance from velocities; frozen on the ground and while saturated."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._x = np.zeros(_SIZE)
        self._x[_K] = 1.0
        self._P = np.zeros((_SIZE, _SIZE))
        self._started = False

    @property
    def estimate(self) -> Disturbance:
        """The present estimate."""
        return Disturbance(a_W=self._x[_D].copy(), thrust_scale=float(self._x[_K]))

    def update(
        self, *, v_WB_W: Array, thrust_axis_W: Array, thrust: float, duration: float, frozen: bool
    ) -> None:
        """Take a measured velocity (3,) after ``duration`` [s].

        ``thrust_axis_W`` (3,) is the mean direction of the thrust since the last one and
        ``thrust`` [N] its mean, by the model. ``frozen`` keeps the estimate as it is.
        """
        lifted = thrust * thrust_axis_W[2] > _LIFT * self._vehicle.mass * self._vehicle.gravity
        resting = float(v_WB_W @ v_WB_W) < _REST_SPEED**2 and not lifted
        if not self._started or frozen or duration <= 0.0 or (resting and self._is_untouched()):
            self._restart(v_WB_W)
            return
        self._predict(thrust_axis_W, thrust, duration)
        self._correct(v_WB_W)
        self._x[_D] = np.clip(self._x[_D], -_ACCELERATION_BOUND, _ACCELERATION_BOUND)
        self._x[_K] = min(max(self._x[_K], _SCALE_BOUNDS[0]), _SCALE_BOUNDS[1])

    def _is_untouched(self) -> bool:
        """Whether nothing has been learned yet: the vehicle has not flown."""
        return not self._x[_D].any() and bool(self._x[_K] == 1.0)

    def _restart(self, v_WB_W: Array) -> None:
        """Believe a velocity and keep the disturbance."""
        if not self._started:
            self._P[_D, _D] = np.eye(3) * _ACCELERATION_SPREAD**2
            self._P[_K, _K] = _SCALE_SPREAD**2
            self._started = True
        self._x[_V] = v_WB_W
        self._P[_V, :] = self._P[:, _V] = 0.0
        self._P[_V, _V] = np.eye(3) * _VELOCITY_NOISE**2

    def _predict(self, thrust_axis_W: Array, thrust: float, duration: float) -> None:
        x, drag = self._x, self._vehicle.drag
        push = thrust / self._vehicle.mass * thrust_axis_W
        acceleration = x[_K] * push + x[_D] - drag * x[_V]
        acceleration[2] -= self._vehicle.gravity
        F = np.eye(_SIZE)
        F[_V, _V] -= drag * duration * np.eye(3)
        F[_V, _D] = duration * np.eye(3)
        F[_V, _K] = duration * push
        x[_V] += duration * acceleration
        self._P = F @ self._P @ F.T
        self._P[range(3), range(3)] += _ACCELERATION_NOISE**2 * duration
        self._P[range(3, 6), range(3, 6)] += _ACCELERATION_WALK**2 * duration
        self._P[_K, _K] += _SCALE_WALK**2 * duration

    def _correct(self, v_WB_W: Array) -> None:
        S = self._P[_V, _V] + _VELOCITY_NOISE**2 * np.eye(3)
        gain = np.linalg.solve(S, self._P[_V, :]).T
        self._x += gain @ (v_WB_W - self._x[_V])
        self._P -= gain @ self._P[_V, :]
        self._P = 0.5 * (self._P + self._P.T)
