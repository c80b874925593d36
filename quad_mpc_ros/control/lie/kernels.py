# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Vectors and rotations as plain numbers, for functions that Numba compiles.

NumPy takes a microsecond for each operation on three numbers, and a horizon has thousands of them.
Code of the control step is therefore compiled: plain loops over tuples of floats in registers.

A vector is a tuple of three numbers, a matrix of nine, row by row. Conventions as in
:mod:`quad_mpc_ros.control.lie.so3`, which works on arrays.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, formulas

Vector = formulas.Vector
Matrix = formulas.Matrix
Quaternion = formulas.Quaternion

# All bits of a float but its sign.
_MAGNITUDE = np.int64(0x7FFF_FFFF_FFFF_FFFF)
# Below this angle the closed form of the inverse Jacobian loses digits to cancellation: two per
# factor of ten.
_SMALL_DEFICIT = 0.05

lowpass_share = compiled(formulas.lowpass_share)
rotation = compiled(formulas.rotation)
quaternion = compiled(formulas.quaternion)
_polynomial = compiled(formulas.polynomial)
_turn_ratios = compiled(formulas.turn_ratios)
_rotation_vector = compiled(formulas.rotation_vector)


@compiled
def infinity_norm(values: Array) -> float:
    """Return the largest magnitude in an array; NaN if any is NaN."""
    # Without their sign the bits of floats order as whole numbers do, NaN above infinity, and of
    # those a processor compares several at a time.
    found = np.zeros(1, dtype=np.int64)
    most = found[0]
    for bits in values.ravel().view(np.int64):
        most = max(most, bits & _MAGNITUDE)
    found[0] = most
    return float(found.view(np.float64)[0])


@compiled
def clamp(value: float, lowest: float, highest: float) -> float:
    """Return a value limited to [lowest, highest]."""
    return min(max(value, lowest), highest)


@compiled
def vector(a: Array) -> Vector:
    """Return the vector in an array (3,)."""
    return a[0], a[1], a[2]


@compiled
def store_vector(v: Vector, out: Array) -> None:
    """Write a vector into an array (3,)."""
    out[0], out[1], out[2] = v


@compiled
def matrix(a: Array) -> Matrix:
    """Return the matrix in an array (3, 3)."""
    return (
        a[0, 0],
        a[0, 1],
        a[0, 2],
        a[1, 0],
        a[1, 1],
        a[1, 2],
        a[2, 0],
        a[2, 1],
        a[2, 2],
    )


@compiled
def store_matrix(m: Matrix, out: Array) -> None:
    """Write a matrix into an array (3, 3)."""
    out[0, 0], out[0, 1], out[0, 2] = m[0], m[1], m[2]
    out[1, 0], out[1, 1], out[1, 2] = m[3], m[4], m[5]
    out[2, 0], out[2, 1], out[2, 2] = m[6], m[7], m[8]


@compiled
def quaternion_in(a: Array) -> Quaternion:
    """Return the quaternion in an array (4,), x, y, z, w."""
    return a[0], a[1], a[2], a[3]


@compiled
def store_quaternion(q: Quaternion, out: Array) -> None:
    """Write a quaternion into an array (4,)."""
    out[0], out[1], out[2], out[3] = q


@compiled
def is_zero(a: Array) -> bool:
    """Whether a vector in an array (3,) is zero."""
    return bool(a[0] == 0.0 and a[1] == 0.0 and a[2] == 0.0)


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Return a' b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def scaled(factor: float, v: Vector) -> Vector:
    """Return a multiple of a vector."""
    return factor * v[0], factor * v[1], factor * v[2]


@compiled
def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def norm(v: Vector) -> float:
    """Return the length of a vector."""
    return math.sqrt(dot(v, v))


@compiled
def in_world(q_WB_xyzw: Array, v_B: Array) -> Vector:
    """Return a vector of the body (3,) in the world, by the quaternion of the attitude (4,)."""
    return apply(rotation(quaternion_in(q_WB_xyzw)), vector(v_B))


@compiled
def length(a: Array) -> float:
    """Return the length of a vector in an array (3,)."""
    return norm(vector(a))


@compiled
def distance(a: Array, b: Array) -> float:
    """Return the distance of two points in arrays (3,)."""
    return norm(minus(vector(a), vector(b)))


@compiled
def largest_length(rows: Array) -> float:
    """Return the largest length of vectors (n, 3), 0 without vectors."""
    square = 0.0
    for k in range(len(rows)):
        square = max(square, dot(vector(rows[k]), vector(rows[k])))
    return math.sqrt(square)


@compiled
def transposed(a: Matrix) -> Matrix:
    """Return a'."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@compiled
def row(a: Matrix, index: int) -> Vector:
    """Return row 0, 1 or 2."""
    return a[3 * index], a[3 * index + 1], a[3 * index + 2]


@compiled
def column(a: Matrix, index: int) -> Vector:
    """Return a column of a matrix."""
    return a[index], a[3 + index], a[6 + index]


@compiled
def apply(a: Matrix, v: Vector) -> Vector:
    """Return a v."""
    return (
        a[0] * v[0] + a[1] * v[1] + a[2] * v[2],
        a[3] * v[0] + a[4] * v[1] + a[5] * v[2],
        a[6] * v[0] + a[7] * v[1] + a[8] * v[2],
    )


@compiled
def apply_transposed(a: Matrix, v: Vector) -> Vector:
    """Return a' v."""
    return (
        a[0] * v[0] + a[3] * v[1] + a[6] * v[2],
        a[1] * v[0] + a[4] * v[1] + a[7] * v[2],
        a[2] * v[0] + a[5] * v[1] + a[8] * v[2],
    )


@compiled
def multiply(a: Matrix, b: Matrix) -> Matrix:
    """Return a b."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@compiled
def exp(phi: Vector) -> Matrix:
    """Return the rotation by a rotation vector (Rodrigues)."""
    sine, versine, _ = _turn_ratios(dot(phi, phi))
    return _polynomial(phi, sine, versine)


@compiled
def right_jacobian(phi: Vector) -> Matrix:
    """Return J_r with exp(phi + d) ≈ exp(phi) exp(J_r d)."""
    _, versine, deficit = _turn_ratios(dot(phi, phi))
    return _polynomial(phi, -versine, deficit)


@compiled
def right_jacobian_inverse(phi: Vector) -> Matrix:
    """Return the inverse of :func:`right_jacobian`, finite up to and at pi."""
    square = dot(phi, phi)
    angle = math.sqrt(square)
    if angle < _SMALL_DEFICIT:
        second = square * square
        deficit = 1 / 12 + square / 720 + second / 30240 + square * second / 1209600
    else:  # (1 - t / 2 cot(t / 2)) / t^2 of the angle t
        deficit = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / square
    return _polynomial(phi, 0.5, deficit)


@compiled
def shortest_rotation(start: Vector, end: Vector) -> Matrix:
    """Return the shortest rotation from the direction of one vector to another's.

    Rodrigues' formula without an angle, (1 - cos) / sin^2 = 1 / (1 + cos). The vectors must be
    nonzero and not opposite.
    """
    lengths = math.sqrt(dot(start, start) * dot(end, end))
    cosine = dot(start, end) / lengths
    return _polynomial(scaled(1.0 / lengths, cross(start, end)), 1.0, 1.0 / (1.0 + cosine))


@compiled
def log(r: Matrix) -> Vector:
    """Return the rotation vector of a rotation, of length at most pi.

    The unit quaternion gives the vector, because its vector part is well conditioned near pi.
    """
    return _rotation_vector(quaternion(r))
