# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A smooth curve near measured points: penalised B-splines.

Eilers and Marx, "Flexible smoothing with B-splines and penalties" (1996): least squares on a
uniform grid of knots, with the fourth differences of the coefficients, which stand for snap, as
the penalty. The penalty's weight is the largest for which the curve is within the tolerance.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.sparse.linalg import splu

from quad_mpc_ros.control.lie import Array

_DEGREE = 5
_LONGEST_STEP = 0.05  # s, between knots
_MOST_KNOTS = 4000
# Logarithms of the weight: from none to as much as the normal equations bear.
_LIGHTEST, _HEAVIEST, _BISECTIONS = -8.0, 9.0, 24


def smooth_curve(
    seconds: Array, values: Array, *, tolerance: float, rests: tuple[bool, bool]
) -> BSpline:
    """Return the smoothest curve with values (n, k) at ``seconds`` (n,), increasing.

    The root mean square of its distance to ``values`` (n, k) is at most ``tolerance``. ``rests``
    is whether the curve starts and ends at rest, in all derivatives. Raises ``ValueError`` if no
    curve is within the tolerance.
    """
    duration = float(seconds[-1] - seconds[0])
    step = max(min(float(np.median(np.diff(seconds))), _LONGEST_STEP), duration / _MOST_KNOTS)
    count = int(np.ceil(duration / step))
    step = duration / count
    knots = seconds[0] + step * np.arange(-_DEGREE, count + _DEGREE + 1)
    joined = _with_equal_ends(count + _DEGREE, rests)
    # Rounding must not put the last point beyond the last knot.
    inside = np.clip(seconds, knots[_DEGREE], knots[-_DEGREE - 1])
    basis = BSpline.design_matrix(inside, knots, _DEGREE) @ joined
    snap = _differences(count + _DEGREE) @ joined
    fit, roughness, right = basis.T @ basis, snap.T @ snap, basis.T @ values

    def coefficients(weight: float) -> Array:
        return np.asarray(splu((fit + 10.0**weight * roughness).tocsc()).solve(right))

    def miss(weight: float) -> float:
        error = basis @ coefficients(weight) - values
        return float(np.sqrt(np.mean(np.sum(error * error, axis=1))))

    light, heavy = _LIGHTEST, _HEAVIEST
    nearest = miss(light)
    if not nearest <= tolerance:
        raise ValueError(f"the nearest smooth curve is {nearest:.3g} away")
    for _ in range(_BISECTIONS):
        middle = 0.5 * (light + heavy)
        light, heavy = (middle, heavy) if miss(middle) <= tolerance else (light, middle)
    return BSpline(knots, joined @ coefficients(light), _DEGREE)


def _with_equal_ends(count: int, rests: tuple[bool, bool]) -> sparse.csr_array:
    """Return the map from free to all coefficients: coefficients of a span at rest are equal."""
    first = np.arange(count)
    if rests[0]:
        first = np.maximum(first - _DEGREE, 0)
    if rests[1]:
        first = np.minimum(first, first[-1] - _DEGREE)
    return sparse.csr_array(
        (np.ones(count), (np.arange(count), first)), shape=(count, int(first[-1]) + 1)
    )


def _differences(count: int) -> sparse.csr_array:
    stencil = (1.0, -4.0, 6.0, -4.0, 1.0)
    shape = (count - len(stencil) + 1, count)
    return sparse.csr_array(sparse.diags(stencil, offsets=range(len(stencil)), shape=shape))
