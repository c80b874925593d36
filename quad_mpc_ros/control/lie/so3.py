"""The rotation group SO(3) and its Lie algebra.

A rotation is a 3x3 matrix, a tangent vector is a rotation vector ``phi`` (axis times angle, rad).
Leading batch dimensions are accepted where shapes have an ellipsis: (..., 3) and (..., 3, 3).
Conventions follow Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics"
(2018), with right (body-frame) Jacobians.

Arguments with a wrong shape, or no rotations, raise :class:`ArgumentError`, a ``ValueError``.

A single rotation goes through plain numbers (:mod:`.formulas`), batches through NumPy, which takes
ten times as long for three numbers.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.configuration.arguments import array
from quad_mpc_ros.configuration.errors import ArgumentError
from quad_mpc_ros.control.lie import Array, formulas
from quad_mpc_ros.control.lie.formulas import SMALL_ANGLE, Matrix, Quaternion


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
    if phi.ndim == 1:
        x, y, z = phi.tolist()
        square = x * x + y * y + z * z
        if not square < math.inf:  # NaN compares with nothing
            raise ArgumentError("phi", phi, _ROTATION_VECTOR)
        sine, versine, _ = formulas.turn_ratios(square)
        return _array(formulas.polynomial((x, y, z), sine, versine))
    angle = np.sqrt(np.sum(phi * phi, axis=-1))[..., None, None]  # to multiply matrices with
    if not np.isfinite(angle).all():
        raise ArgumentError("phi", phi, _ROTATION_VECTOR)
    skew = hat(phi)
    return _EYE + _sinc(angle) * skew + _versine(angle) * (skew @ skew)


def log(rotation: Array) -> Array:
    """Return the rotation vector of ``rotation``, of length at most pi; (..., 3, 3) → (..., 3).

    The result comes from the unit quaternion, whose vector part is well conditioned near pi, where
    the trace formula divides by zero. At exactly pi two opposite axes are valid; one is returned.
    """
    rotation = array(rotation, "rotation", ..., 3, 3)
    if rotation.ndim == 2:
        try:
            return np.array(formulas.rotation_vector(_quaternion(rotation)))
        except ArithmeticError:
            raise ArgumentError("rotation", rotation.tolist(), _ROTATION) from None
    q = quaternion_xyzw_from_rotation(rotation)
    vector, w = q[..., :3], q[..., 3:]  # w >= 0: the shorter way round
    sine = np.sqrt(np.sum(vector * vector, axis=-1, keepdims=True))
    small = sine < SMALL_ANGLE
    t = sine / np.where(small, w, 1.0)
    ratio = np.where(
        small,
        2.0 * (1.0 - t**2 / 3.0 + t**4 / 5.0) / np.where(small, w, 1.0),  # 2 atan(t) / (w t)
        2.0 * np.arctan2(sine, w) / np.where(small, 1.0, sine),
    )
    return np.asarray(ratio * vector)


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
        return _array(formulas.rotation((x, y, z, w)))
    norm = np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    if not np.all(np.isfinite(norm) & (norm > 0.0)):
        raise ArgumentError("q_xyzw", q.tolist(), _QUATERNION)
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    rotation = np.empty((*q.shape[:-1], 3, 3))
    rotation[..., 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    rotation[..., 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    rotation[..., 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    rotation[..., 0, 1] = 2.0 * (x * y - z * w)
    rotation[..., 1, 0] = 2.0 * (x * y + z * w)
    rotation[..., 0, 2] = 2.0 * (x * z + y * w)
    rotation[..., 2, 0] = 2.0 * (x * z - y * w)
    rotation[..., 1, 2] = 2.0 * (y * z - x * w)
    rotation[..., 2, 1] = 2.0 * (y * z + x * w)
    return rotation


def quaternion_xyzw_from_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (x, y, z, w) with w >= 0; (..., 3, 3) → (..., 4).

    Each of the four products ``4 q_i q`` is linear in the matrix; the product with the largest
    norm is the best conditioned everywhere, including at pi (Shepperd 1978).
    """
    r = array(rotation, "rotation", ..., 3, 3)
    if r.ndim == 2:
        return np.array(_quaternion(r))
    if not np.isfinite(r).all():
        raise ArgumentError("rotation", r, _ROTATION)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    products = np.empty((*r.shape[:-2], 4, 4))
    products[..., 0, 0] = 1.0 + xx - yy - zz
    products[..., 1, 1] = 1.0 - xx + yy - zz
    products[..., 2, 2] = 1.0 - xx - yy + zz
    products[..., 3, 3] = 1.0 + xx + yy + zz
    products[..., 0, 1] = products[..., 1, 0] = r[..., 1, 0] + r[..., 0, 1]
    products[..., 0, 2] = products[..., 2, 0] = r[..., 0, 2] + r[..., 2, 0]
    products[..., 1, 2] = products[..., 2, 1] = r[..., 2, 1] + r[..., 1, 2]
    products[..., 0, 3] = products[..., 3, 0] = r[..., 2, 1] - r[..., 1, 2]
    products[..., 1, 3] = products[..., 3, 1] = r[..., 0, 2] - r[..., 2, 0]
    products[..., 2, 3] = products[..., 3, 2] = r[..., 1, 0] - r[..., 0, 1]
    best = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(products, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    return np.asarray(np.where(q[..., 3:] < 0.0, -q, q))


_EYE = np.eye(3)
_ROTATION_VECTOR = "finite numbers with finite squares"
_QUATERNION = "a quaternion that is finite and not zero"
_ROTATION = "a rotation: finite, orthogonal"


def _quaternion(rotation: Array) -> Quaternion:
    """Return the unit quaternion of a rotation (3, 3), as plain numbers."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    try:
        return formulas.quaternion((a, b, c, d, e, f, g, h, i))
    except (ArithmeticError, ValueError):
        raise ArgumentError("rotation", rotation.tolist(), _ROTATION) from None


def _array(matrix: Matrix) -> Array:
    """Return the (3, 3) of plain numbers."""
    return np.array(matrix).reshape(3, 3)


def _sinc(angle: Array) -> Array:
    """sin(a) / a."""
    small, safe = _split(angle)
    return np.where(small, 1.0 - angle**2 / 6.0 + angle**4 / 120.0, np.sin(safe) / safe)


def _versine(angle: Array) -> Array:
    """(1 - cos(a)) / a^2, by the half angle: no cancellation."""
    small, safe = _split(angle)
    closed = 2.0 * np.sin(0.5 * safe) ** 2 / safe**2
    return np.where(small, 0.5 - angle**2 / 24.0 + angle**4 / 720.0, closed)


def _split(angle: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return where the angle is small, and an angle that is safe to divide by."""
    small = angle < SMALL_ANGLE
    return small, np.where(small, 1.0, angle)
