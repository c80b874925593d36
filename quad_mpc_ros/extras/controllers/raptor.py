# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""RAPTOR, a recurrent policy that commands the rotors of unknown quadrotors.

J. Eschmann, D. Albani and G. Loianno, "RAPTOR: A Foundation Policy for Quadrotor Control", 2025,
arXiv 2509.11481; weights and inference from the package ``foundation-policy`` of its authors. The
policy uses neither mass nor thrust curve: its recurrent state infers the vehicle.

Position and velocity error are in the heading of the reference, and limited as in the module
``mc_raptor`` of PX4. The policy has no setpoint for acceleration and body rates. The policy
expects four rotors, front right anticlockwise seen from above, and the rate of its training.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow, RotorCommand
from quad_mpc_ros.extras.controllers.tracking import tracked

RATE = 100.0
"""Control rate of the training [Hz]."""
POSITION_ERROR_MAX, VELOCITY_ERROR_MAX = 0.5, 1.0  # m, m/s
ANTICLOCKWISE = np.array([3, 2, 1, 0])
"""The rotors of the policy, clockwise from front right, in the order of ``rotor_throttles``."""


class RaptorController:
    """RAPTOR; see the module for its inputs."""

    commands_rotors = True

    def __init__(self, config: MpcConfig) -> None:
        """Load the policy. Raises :class:`UserError` without its package and at other rates."""
        if config.control_rate != RATE:
            raise ConfigurationError(
                "mpc.control_rate",
                config.control_rate,
                "100, the rate of the training of raptor; add --set mpc.control_rate=100 "
                "--set simulator.odom_rate=100",
            )
        if config.motor_count != 4:
            raise ConfigurationError("mpc.motor_count", config.motor_count, "4, with raptor")
        try:
            policy: Any = importlib.import_module("foundation_policy")
        except ImportError as error:
            raise UserError(
                f"mpc.controller: raptor cannot be imported ({error}); "
                "install it with: pip install 'quad_mpc_ros[raptor]'"
            ) from error
        self._policy = policy.Raptor()
        self.reset()

    def reset(self) -> None:
        """Discard the recurrent state and the last action."""
        self._policy.reset()
        self._action: Array = np.zeros(4)

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> RotorCommand:
        """Return the command for an odometry."""
        x = tracked(odometry, reference)
        to_heading = so3.exp(np.array([0.0, 0.0, -x.yaw]))
        observation = np.concatenate(
            (
                np.clip(to_heading @ x.p_error, -POSITION_ERROR_MAX, POSITION_ERROR_MAX),
                (to_heading @ x.R_WB).ravel(),
                np.clip(to_heading @ x.v_error, -VELOCITY_ERROR_MAX, VELOCITY_ERROR_MAX),
                x.w_WB_B,
                self._action,
            )
        )
        self._action = np.clip(self._policy.evaluate_step(observation[None])[0], -1.0, 1.0)
        throttles = 0.5 * (self._action[ANTICLOCKWISE] + 1.0)
        return RotorCommand(
            stamp_ns=odometry.stamp_ns,
            throttle=float(throttles.mean()),
            w_WB_B=x.w_WB_B,
            rotor_throttles=throttles,
        )
