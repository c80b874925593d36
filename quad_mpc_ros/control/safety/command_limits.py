# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Slew limits and bounds of commands."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.config import MpcConfig, SlewParameters
from quad_mpc_ros.control.model.state import Input


def rate_limited(u: Input, before: Input, limits: SlewParameters, *, duration: float) -> Input:
    """Return the input nearest to ``u`` that is reachable in ``duration`` [s] from ``before``."""
    if limits.throttle == limits.body_rates == 0.0:
        return u
    throttle, w_WB_B = u.throttle, u.w_WB_B
    if limits.throttle > 0.0:
        most = limits.throttle * duration
        throttle = min(max(throttle, before.throttle - most), before.throttle + most)
    if limits.body_rates > 0.0:
        most = limits.body_rates * duration
        w_WB_B = np.clip(w_WB_B, before.w_WB_B - most, before.w_WB_B + most)
    return Input(throttle=throttle, w_WB_B=w_WB_B)


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
