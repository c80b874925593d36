# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Geometric tracking control on SE(3).

T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)",
IEEE CDC 2010, equations 12, 15 and 17 to 19: force f = m (-k_x e_x - k_v e_v + g e3 + a_d), thrust
f' R e3, attitude error e_R = (R_d' R - R' R_d)^v / 2. The paper's torque -k_R e_R - k_W e_W is
zero at the body rates W = R' R_d W_d - (k_R / k_W) e_R, which are commanded here.

Gains: those of rotorpy 3.0 (S. Folk, J. Paulos and V. Kumar, "RotorPy", 2023), class
``SE3Control``, which implements the paper: k_x = (6.5, 6.5, 15) 1/s^2, k_v = (4, 4, 9) 1/s,
k_R = 310 1/s^2, k_W = 57 1/s. The paper states gains for one vehicle of 4.3 kg and no rule.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.extras.controllers.tracking import attitude_of_thrust, command, tracked

POSITION_GAIN = np.array([6.5, 6.5, 15.0])
"""k_x / m [1/s^2]."""
VELOCITY_GAIN = np.array([4.0, 4.0, 9.0])
"""k_v / m [1/s]."""
ATTITUDE_GAIN = 310.0 / 57.0
"""k_R / k_W [1/s]."""


class GeometricController:
    """Geometric tracking control; see the module for source and gains."""

    def __init__(self, config: MpcConfig) -> None:
        """Take mass, thrust curve and gravity of the vehicle."""
        self._vehicle = config.vehicle()
        self._gravity = np.array([0.0, 0.0, self._vehicle.gravity])

    def reset(self) -> None:
        """Do nothing: the controller has no state."""

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> CommandSample:
        """Return the command for an odometry."""
        x = tracked(odometry, reference)
        force = self._vehicle.mass * (
            self._gravity + x.a_ref - POSITION_GAIN * x.p_error - VELOCITY_GAIN * x.v_error
        )
        R_d = attitude_of_thrust(force, yaw=x.yaw)
        E = R_d.T @ x.R_WB
        w_d = x.R_WB.T @ x.R_WB_ref @ x.w_ref
        return command(
            odometry,
            throttle=self._vehicle.nearest_throttle(float(force @ x.R_WB[:, 2])),
            w_WB_B=w_d - ATTITUDE_GAIN * _vee(0.5 * (E - E.T)),
        )


def _vee(S: Array) -> Array:
    """Return the vector (3,) of a skew-symmetric matrix (3, 3)."""
    return np.array([S[2, 1], S[0, 2], S[1, 0]])
