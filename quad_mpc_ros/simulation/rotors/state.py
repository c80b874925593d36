"""The state of the plant ``rotors``: a record of the body, and the rotors' speeds (n,) [rad/s].

C is the centre of mass.
"""

from __future__ import annotations

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3, Vector4
from quad_mpc_ros.control.lie import Array, kernels


class BodyState(Record):
    """State of body and battery, or its time derivative."""

    p_WC: Vector3  # m
    v_WC_W: Vector3  # m/s
    q_WB_xyzw: Vector4
    w_WB_B: Vector3  # rad/s
    charge_used: float  # from the battery [A s]


@compiled
def add(
    body: BodyState, speeds: Array, factor: float, rate: BodyState, accelerations: Array
) -> None:
    """Add a multiple of a derivative (rate and accelerations) to a state."""
    for k in range(3):
        body.p_WC[k] += factor * rate.p_WC[k]
        body.v_WC_W[k] += factor * rate.v_WC_W[k]
        body.w_WB_B[k] += factor * rate.w_WB_B[k]
    for k in range(4):
        body.q_WB_xyzw[k] += factor * rate.q_WB_xyzw[k]
    body.charge_used += factor * rate.charge_used
    for rotor in range(speeds.shape[0]):
        speeds[rotor] += factor * accelerations[rotor]


@compiled
def rotation_of(body: BodyState) -> kernels.Matrix:
    """Return the rotation of body to world."""
    return kernels.rotation(kernels.quaternion_in(body.q_WB_xyzw))


@compiled
def put(body: BodyState, p_WB: kernels.Vector, center_B: kernels.Vector) -> None:
    """Set the position of the body's origin [m]; keep the attitude."""
    offset = kernels.apply(rotation_of(body), center_B)
    kernels.store_vector(kernels.plus(p_WB, offset), body.p_WC)


@compiled
def origin_height(body: BodyState, center_B: kernels.Vector) -> float:
    """Return the height of the body's origin [m]."""
    return float(body.p_WC[2] - kernels.apply(rotation_of(body), center_B)[2])


@compiled
def on_ground(body: BodyState, center_B: kernels.Vector) -> bool:
    """Whether the body is at rest on the ground."""
    x, y, z = kernels.vector(body.v_WC_W)
    return origin_height(body, center_B) <= 0.0 and x == 0.0 and y == 0.0 and z == 0.0
