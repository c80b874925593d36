"""Sampling a window of the reference at any time, independent of the window's own step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import Array, ReferenceWindow

_NANOSECOND = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePoints:
    """The reference at one or more times.

    Shapes, with leading dimensions of the times: ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``w_WB_B``
    (..., 3) in m, m/s, m/s^2, rad/s; ``R_WB`` (..., 3, 3).
    """

    p_WB: Array
    R_WB: Array
    v_WB_W: Array
    a_WB_W: Array
    w_WB_B: Array

    @property
    def v_WB_B(self) -> Array:
        """Velocity in the body frame of the reference (..., 3) [m/s]."""
        return np.asarray(np.einsum("...ji,...j->...i", self.R_WB, self.v_WB_W))


def sample(window: ReferenceWindow, stamps_ns: ArrayLike) -> ReferencePoints:
    """Return the reference at ``stamps_ns`` (absolute, any shape).

    Between samples: position by the cubic through position and velocity, velocity by the cubic
    through velocity and acceleration, attitude along the geodesic, the rest linearly. Before the
    first sample the first one holds; from the last one on its pose holds, at rest.
    """
    times = np.asarray(stamps_ns, dtype=np.int64) - window.stamp_ns
    lower, upper, fraction, width = _intervals(window.offset_ns, times)
    moving = (times < window.offset_ns[-1])[..., None].astype(np.float64)

    R_WB = _geodesic(window.q_WB_xyzw[lower], window.q_WB_xyzw[upper], fraction)
    w_WB_W = _linear(window.w_WB_W, lower, upper, fraction)
    return ReferencePoints(
        p_WB=_cubic(window.p_WB, window.v_WB_W, lower, upper, fraction, width),
        R_WB=R_WB,
        v_WB_W=moving * _cubic(window.v_WB_W, window.a_WB_W, lower, upper, fraction, width),
        a_WB_W=moving * _linear(window.a_WB_W, lower, upper, fraction),
        w_WB_B=moving * np.einsum("...ji,...j->...i", R_WB, w_WB_W),
    )


_Index = NDArray[np.intp]


def _intervals(
    offsets: NDArray[np.int64], times: NDArray[np.int64]
) -> tuple[_Index, _Index, Array, Array]:
    """Return the samples around each time, the fraction between them and their distance [s]."""
    last = len(offsets) - 1
    # side="right": of two samples at the same time the later one holds from that time on.
    lower = np.clip(np.searchsorted(offsets, times, side="right") - 1, 0, last)
    upper = np.minimum(lower + 1, last)
    width = offsets[upper] - offsets[lower]
    elapsed = np.clip(times - offsets[lower], 0, width)
    fraction = np.asarray(elapsed / np.maximum(width, 1), dtype=np.float64)
    seconds = np.asarray(width * _NANOSECOND, dtype=np.float64)
    return lower, upper, fraction[..., None], seconds[..., None]


def _geodesic(q_lower_xyzw: Array, q_upper_xyzw: Array, fraction: Array) -> Array:
    R_lower = so3.rotation_from_quaternion_xyzw(q_lower_xyzw)
    if np.array_equal(q_lower_xyzw, q_upper_xyzw):
        return R_lower  # a held attitude, and exactly so
    R_upper = so3.rotation_from_quaternion_xyzw(q_upper_xyzw)
    turn = so3.log(np.swapaxes(R_lower, -1, -2) @ R_upper)
    return np.asarray(R_lower @ so3.exp(fraction * turn))


def _linear(values: Array, lower: _Index, upper: _Index, fraction: Array) -> Array:
    return np.asarray(values[lower] + fraction * (values[upper] - values[lower]))


def _cubic(
    values: Array, slopes: Array, lower: _Index, upper: _Index, fraction: Array, width: Array
) -> Array:
    """Hermite's cubic, written so that equal values at rest come out without rounding."""
    f = fraction
    return np.asarray(
        values[lower]
        + f * f * (3.0 - 2.0 * f) * (values[upper] - values[lower])
        + f * (1.0 - f) ** 2 * width * slopes[lower]
        - f * f * (1.0 - f) * width * slopes[upper]
    )
