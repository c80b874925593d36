# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The rotation group SO(3) and its Lie algebra.

A rotation is a 3x3 matrix, a tangent vector is a rotation vector ``phi`` (axis times angle, rad).
Leading batch dimensions are accepted where shapes have an ellipsis: (..., 3) and (..., 3, 3).
Conventions follow Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics"
(2018), with right (body-frame) Jacobians.

Arguments with a wrong shape, or no rotations, raise :class:`ArgumentError`, a ``ValueError``.

Compiled code has the same formulas (:mod:`.formulas`). NumPy computes the sines of a batch of
rotation vectors, and a batch of quaternions, because these batches may be long.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from quad_mpc_ros.configuration.arguments import array
from quad_mpc_ros.configuration.errors import ArgumentError
from quad_mpc_ros.control.lie import Array, formulas


def hat(phi: ArrayLike) -> Array:
    """Return the skew matrix [phi] with ``hat(a) @ b == cross(a, b)``; (..., 3) → (..., 3, 3)."""
    phi = array(phi, "phi", ..., 3)
    skew = np.zeros((*phi.shape, 3))
    skew[..., 2, 1] = phi[..., 0]
    skew[..., 0, 2] = phi[..., 1]
    skew[..., 1, 0] = phi[..., 2]
    skew[..., 1, 2] = -phi[..., 0]
    skew[..., 2, 0] = -phi[..., 1]
    skew[..., 0, 1] = -phi[..., 2]
    return skew


def exp(phi: ArrayLike) -> Array:
    """Return the rotation by the rotation vector ``phi`` (Rodrigues); (..., 3) → (..., 3, 3)."""
    phi = array(phi, "phi", ..., 3)
    square = np.sum(phi * phi, axis=-1)
    if not np.isfinite(square).all():
        raise ArgumentError("phi", phi, "finite numbers with finite squares")
    if phi.ndim == 1:
        sine, versine, _ = formulas.turn_ratios(float(square))
    else:  # np.sinc(x) is sin(pi x) / (pi x)
        turns = np.sqrt(square) / math.pi
        sine, versine = np.sinc(turns), 0.5 * np.sinc(0.5 * turns) ** 2
    x, y, z = np.moveaxis(phi, -1, 0)
    return _matrices(formulas.polynomial((x, y, z), sine, versine))


def _matrices(entries: Sequence[ArrayLike]) -> Array:
    """Return matrices (..., 3, 3) of nine entries (...), row by row."""
    stacked = np.stack(entries, axis=-1)
    return stacked.reshape(*stacked.shape[:-1], 3, 3)


def log(rotation: Array) -> Array:
    """Return the rotation vector of ``rotation``, of length at most pi; (..., 3, 3) → (..., 3).

    The result comes from the unit quaternion, whose vector part is well conditioned near pi, where
    the trace formula divides by zero. At exactly pi two opposite axes are valid; one is returned.
    """
    q_xyzw = quaternion_xyzw_from_rotation(rotation)
    vectors = [
        formulas.rotation_vector((x, y, z, w)) for x, y, z, w in q_xyzw.reshape(-1, 4).tolist()
    ]
    return np.array(vectors).reshape(*q_xyzw.shape[:-1], 3)


def shortest_rotation(start: Array, end: Array) -> Array:
    """Return the shortest rotations (n, 3, 3) between two sets of unit vectors (n, 3).

    Between opposite vectors the rotation is undefined.
    """
    start, end = array(start, "start", ..., 3), array(end, "end", ..., 3)
    if start.ndim != 2 or start.shape != end.shape:
        raise ArgumentError("end", end, f"unit vectors (n, 3), as many as start: {start.shape}")
    cosine = np.sum(start * end, axis=-1)
    skew = hat(np.cross(start, end))
    # Rodrigues' formula without an angle: (1 - cos) / sin^2 = 1 / (1 + cos).
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + cosine)[:, None, None])


def shortest_turn_of_z(direction: Array) -> Array:
    """Return the rotation vector (3,) of the shortest rotation from e_3 to a direction (3,).

    The vector has no component along e_3. For the direction opposite to e_3, the axis is e_1.
    """
    length = np.linalg.norm(direction)
    if not 0.0 < length < math.inf:
        raise ArgumentError("direction", direction.tolist(), "3 finite numbers, not all 0")
    x, y, z = direction / length
    axis = np.array([-y, x, 0.0])  # e_3 cross direction
    sine = math.hypot(axis[0], axis[1])
    if sine < 1e-9:
        return np.zeros(3) if z > 0.0 else np.array([math.pi, 0.0, 0.0])
    return np.asarray(axis * (math.atan2(sine, z) / sine))


def rotation_from_quaternion_xyzw(q_xyzw: ArrayLike) -> Array:
    """Return the rotation of a quaternion (x, y, z, w), normalised first; (..., 4) → (..., 3, 3).

    Raises :class:`ArgumentError` if a quaternion is zero or not finite.
    """
    q = np.asarray(q_xyzw, dtype=np.float64)
    if q.ndim == 1:
        x, y, z, w = q.tolist()
        if not 0.0 < x * x + y * y + z * z + w * w < math.inf:
            raise ArgumentError("q_xyzw", q.tolist(), _QUATERNION)
        return np.array(formulas.rotation((x, y, z, w))).reshape(3, 3)
    norm = np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    if not np.all(np.isfinite(norm) & (norm > 0.0)):
        raise ArgumentError("q_xyzw", q.tolist(), _QUATERNION)
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    return _matrices(formulas.polynomial((x, y, z), 2.0 * w, 2.0))


def quaternion_xyzw_from_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (x, y, z, w) with w >= 0; (..., 3, 3) → (..., 4).

    Raises :class:`ArgumentError` for a matrix that is not a rotation.
    """
    rotation = array(rotation, "rotation", ..., 3, 3)
    rows: list[Any] = rotation.reshape(-1, 9).tolist()
    try:
        q_xyzw = np.array([formulas.quaternion(row) for row in rows])
    except (ArithmeticError, ValueError):
        q_xyzw = np.full((len(rows), 4), math.nan)
    if not np.isfinite(q_xyzw).all():
        raise ArgumentError("rotation", rotation, "a rotation: finite, orthogonal")
    return q_xyzw.reshape(*rotation.shape[:-2], 4)


_QUATERNION = "a quaternion that is finite and not zero"
