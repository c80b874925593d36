# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bounds of commands."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.state import Input


def clamped(u: Input, config: MpcConfig) -> Input:
    """Return the input clamped to the configured bounds; the same object if within bounds."""
    x, y, z = u.w_WB_B.tolist()
    x_max, y_max, z_max = config.omega_max
    if (
        config.throttle_min <= u.throttle <= config.throttle_max
        and -x_max <= x <= x_max
        and -y_max <= y <= y_max
        and -z_max <= z <= z_max
    ):
        return u
    limit = np.array(config.omega_max)
    return Input(
        throttle=min(max(u.throttle, config.throttle_min), config.throttle_max),
        w_WB_B=np.clip(u.w_WB_B, -limit, limit),
    )
