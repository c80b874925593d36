# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The formulas of SO(3), and a low-pass, on plain numbers, for Python and Numba.

:mod:`.so3` calls them uncompiled, without Numba, and :mod:`.kernels` compiles them. Both give
bit-identical results, because powers are written as products.
"""

from __future__ import annotations

import math

Vector = tuple[float, float, float]
Matrix = tuple[float, float, float, float, float, float, float, float, float]
Quaternion = tuple[float, float, float, float]

# Below this angle the closed forms lose digits to cancellation and their Taylor series, cut after
# the third term, is exact to rounding (the fourth is smaller than 1e-3**6 / 5040).
SMALL_ANGLE = 1e-3
# Up to this square of an angle six terms are exact to rounding (the seventh is below
# 0.0625**6 / 15!), and take a third of the time of a sine. Rotations in a substep are smaller.
_SERIES_SQUARE = 0.0625


def polynomial(phi: Vector, a: float, b: float) -> Matrix:
    """Return I + a [phi] + b [phi]^2."""
    x, y, z = phi
    return (
        1.0 - b * (y * y + z * z),
        b * x * y - a * z,
        b * x * z + a * y,
        b * x * y + a * z,
        1.0 - b * (x * x + z * z),
        b * y * z - a * x,
        b * x * z - a * y,
        b * y * z + a * x,
        1.0 - b * (x * x + y * y),
    )


def turn_ratios(x: float) -> Vector:
    """Return sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3 for the square x of an angle t."""
    if x < _SERIES_SQUARE:
        versine = 1 / 3628800 - 1 / 479001600 * x
        versine = 1 / 2 + x * (-1 / 24 + x * (1 / 720 + x * (-1 / 40320 + x * versine)))
        deficit = 1 / 39916800 - 1 / 6227020800 * x
        deficit = 1 / 6 + x * (-1 / 120 + x * (1 / 5040 + x * (-1 / 362880 + x * deficit)))
        return 1.0 - x * deficit, versine, deficit
    angle = math.sqrt(x)
    sine, half_sine = math.sin(angle), math.sin(0.5 * angle)
    return sine / angle, 2.0 * half_sine * half_sine / x, (angle - sine) / (x * angle)


def heading(q_xyzw: Quaternion) -> float:
    """Return the rotation about the vertical [rad] after the shortest tilt from level."""
    return 2.0 * math.atan2(q_xyzw[2], q_xyzw[3])


def lowpass_share(duration: float, time_constant: float) -> float:
    """Return the share of a step that a first-order low-pass covers in a duration [s]."""
    return 1.0 - math.exp(-duration / time_constant)


def rotation(q_xyzw: Quaternion) -> Matrix:
    """Return the rotation of a quaternion (x, y, z, w), normalised first; it must not be zero."""
    x, y, z, w = q_xyzw
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - z * w),
        2.0 * (x * z + y * w),
        2.0 * (x * y + z * w),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - x * w),
        2.0 * (x * z - y * w),
        2.0 * (y * z + x * w),
        1.0 - 2.0 * (x * x + y * y),
    )


def quaternion(r: Matrix) -> Quaternion:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a rotation (Shepperd 1978).

    Each of the four products 4 q_i q is linear in the matrix; the product with the largest q_i is
    the best conditioned.
    """
    xx, yy, zz = r[0], r[4], r[8]
    squares = (1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz)
    largest = max(squares)
    if squares[0] == largest:
        x, y, z, w = squares[0], r[3] + r[1], r[2] + r[6], r[7] - r[5]
    elif squares[1] == largest:
        x, y, z, w = r[3] + r[1], squares[1], r[7] + r[5], r[2] - r[6]
    elif squares[2] == largest:
        x, y, z, w = r[2] + r[6], r[7] + r[5], squares[2], r[3] - r[1]
    else:
        x, y, z, w = r[7] - r[5], r[2] - r[6], r[3] - r[1], squares[3]
    norm = math.copysign(math.sqrt(x * x + y * y + z * z + w * w), w)
    return x / norm, y / norm, z / norm, w / norm


def rotation_vector(q_xyzw: Quaternion) -> Vector:
    """Return the rotation vector, of length at most pi, of a unit quaternion with w >= 0."""
    x, y, z, w = q_xyzw
    sine = math.sqrt(x * x + y * y + z * z)
    if sine < SMALL_ANGLE:
        t = sine / w
        square = t * t
        ratio = 2.0 * (1.0 - square / 3.0 + square * square / 5.0) / w  # 2 atan(t) / (w t)
    else:
        ratio = 2.0 * math.atan2(sine, w) / sine
    return ratio * x, ratio * y, ratio * z
