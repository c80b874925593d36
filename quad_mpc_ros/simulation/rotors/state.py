"""The state of the plant ``rotors``: a row of 14 numbers and one for each rotor."""

from __future__ import annotations

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels

P_WC, V_WC_W, Q_WB, W_WB_B, USED = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), 13
"""Parts of a row: place and velocity of the centre of mass C in the world, attitude as a
quaternion x, y, z, w of body to world, body rates, charge taken from the battery [A s]."""

SPEEDS = 14
"""Where the speeds of the rotors begin [rad/s]; all that follows is of them."""


@compiled
def rotation_in(x: Array) -> kernels.Matrix:
    """Return the rotation of body to world of a state (14 + n,)."""
    return kernels.rotation((x[6], x[7], x[8], x[9]))


@compiled
def put(x: Array, p_WB: kernels.Vector, center_B: kernels.Vector) -> None:
    """Put the body's origin of a state (14 + n,) somewhere [m], its attitude as it is."""
    offset = kernels.apply(rotation_in(x), center_B)
    kernels.store_vector(kernels.plus(p_WB, offset), x[0:3])


@compiled
def origin_height(x: Array, center_B: kernels.Vector) -> float:
    """Return the height of the body's origin [m] of a state (14 + n,)."""
    return float(x[2] - kernels.apply(rotation_in(x), center_B)[2])


@compiled
def stands(x: Array, center_B: kernels.Vector) -> bool:
    """Whether a state (14 + n,) rests on the ground."""
    return origin_height(x, center_B) <= 0.0 and x[3] == 0.0 and x[4] == 0.0 and x[5] == 0.0
