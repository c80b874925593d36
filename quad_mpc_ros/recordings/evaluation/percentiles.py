# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Percentiles for all tables, pages and files of this package."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def percentiles(values: NDArray[Any] | Sequence[float], *percents: int) -> dict[str, float | None]:
    """Return percentiles and maximum of the finite values, None without finite values.

    The percentile P of n values is the smallest value that P % of the values do not exceed: rank
    ceil(P n / 100), a measured value without interpolation.
    """
    given = np.asarray(values)
    ordered = np.sort(given[np.isfinite(given)])
    # Rounded up in integers: 0.01 * 90 * n is not exactly 0.9 n.
    ranks = {f"p{percent}": -(-percent * len(ordered) // 100) for percent in percents}
    ranks["max"] = len(ordered)
    return {name: ordered[rank - 1].item() if rank else None for name, rank in ranks.items()}
