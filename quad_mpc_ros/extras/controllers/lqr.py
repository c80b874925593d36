# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Linear quadratic regulator on the error state of the MPC.

The error about the reference is (p, v, attitude, body rates), attitude as Log(R_r' R), all in the
reference's body frame. Linearised about hover, p' = v, v' = g (th_y, -th_x, 0) + thrust,
th' = w, and w follows the commanded rates with the configured lag. The discrete Riccati equation
(``scipy.linalg.solve_discrete_are``) at the control rate gives one gain matrix.

Gains: from Q and R of the configuration, the weights of the MPC. Body rates have no weight in
them. The feed-forward is the reference's thrust, with drag, and its body rates. An LQR has no
limits: a step of 2 m would turn the vehicle over. So the position error is bounded to the error
that balances a tilt of ``limits.tilt_max``, and to ``limits.position_error_max``.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import linalg

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.extras.controllers.tracking import command, tracked

_STATES, _INPUTS = 12, 4
_SHORTEST_LAG = 1e-3  # s
_TINY_WEIGHT = 1e-9  # of the body rates, so that the Riccati equation is regular


class LqrController:
    """LQR with the weights of the MPC; see the module for the model."""

    def __init__(self, config: MpcConfig) -> None:
        """Take vehicle, weights, rate lag and control rate."""
        self._vehicle, self._gain = config.vehicle(), gain(config)
        limits = config.limits
        self._highest = self._longest = limits.position_error_max
        if limits.tilt_max > 0.0:
            balance = limits.tilt_max * self._gain[2, 7] / self._gain[2, 0]
            self._longest = min(self._longest, abs(float(balance)))

    def reset(self) -> None:
        """Do nothing: the controller has no state."""

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> CommandSample:
        """Return the command for an odometry."""
        x, vehicle = tracked(odometry, reference), self._vehicle
        to_body = x.R_WB_ref.T
        error = np.concatenate(
            (
                to_body @ self._saturated(x.p_error),
                to_body @ x.v_error,
                so3.log(to_body @ x.R_WB),
                x.w_WB_B - x.w_ref,
            )
        )
        specific = vehicle.specific_thrust(
            a_WB_W=x.a_ref[None], v_WB_W=x.v_ref[None], R_WB=x.R_WB_ref[None]
        )
        correction = -self._gain @ error
        throttle = vehicle.nearest_throttle(vehicle.mass * float(specific[0]))
        return command(
            odometry, throttle=throttle + float(correction[0]), w_WB_B=x.w_ref + correction[1:]
        )

    def _saturated(self, error: Array) -> Array:
        """Return a position error (3,) with its horizontal and vertical parts bounded [m]."""
        horizontal = math.hypot(error[0], error[1])
        share = 1.0 if horizontal <= self._longest else self._longest / horizontal
        up = float(np.clip(error[2], -self._highest, self._highest))
        return np.array([share * error[0], share * error[1], up])


def gain(config: MpcConfig) -> Array:
    """Return the gain matrix (4, 12) of throttle and body rates over the error state."""
    vehicle = config.vehicle()
    a, b, _ = vehicle.thrust_curve
    slope = vehicle.motor_count * (2.0 * a * vehicle.hover_throttle + b) / vehicle.mass
    lags = np.maximum(per_axis(config.rate_time_constant), _SHORTEST_LAG)
    p, v, turn, w = (slice(start, start + 3) for start in range(0, _STATES, 3))
    # Continuous model and inputs in one matrix, whose exponential is the discrete model.
    model = np.zeros((_STATES + _INPUTS, _STATES + _INPUTS))
    model[p, v] = model[turn, w] = np.eye(3)
    model[v, turn] = vehicle.gravity * np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0] * 3])
    model[w, w] = np.diag(-1.0 / lags)
    model[5, _STATES] = slope
    model[w, _STATES + 1 :] = np.diag(1.0 / lags)
    discrete = linalg.expm(model / config.control_rate)
    A, B = discrete[:_STATES, :_STATES], discrete[:_STATES, _STATES:]
    Q, R = np.diag([*config.Q, *[_TINY_WEIGHT] * 3]), np.diag(config.R)
    S = linalg.solve_discrete_are(A, B, Q, R)
    return np.asarray(np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A))
