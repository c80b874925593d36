# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The time that a controller takes for a command."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from quad_mpc_ros.control.config import MPC
from quad_mpc_ros.control.tick import Tick


def median_step_us(ticks: Sequence[Tick | None], controller: str) -> float:
    """Return the median of the steps of a flight [us]: of the MPC including its estimator."""
    own = controller != MPC
    stats = [tick.stats for tick in ticks if tick is not None]
    times = [each.solve_time_us if own else each.step_time_us for each in stats]
    return float(np.nanmedian(times)) if times else math.nan
