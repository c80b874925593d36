"""Limits on how fast commands may change."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.model.state import Input
from quad_mpc_ros.mpc_config import SlewParameters


def slewed(u: Input, before: Input, limits: SlewParameters, *, duration: float) -> Input:
    """Return the input nearest to ``u`` that can be reached in ``duration`` [s] from another."""
    if limits.throttle_max == limits.rate_max == 0.0:
        return u
    throttle, w_WB_B = u.throttle, u.w_WB_B
    if limits.throttle_max > 0.0:
        most = limits.throttle_max * duration
        throttle = min(max(throttle, before.throttle - most), before.throttle + most)
    if limits.rate_max > 0.0:
        most = limits.rate_max * duration
        w_WB_B = np.clip(w_WB_B, before.w_WB_B - most, before.w_WB_B + most)
    return Input(throttle=throttle, w_WB_B=w_WB_B)
