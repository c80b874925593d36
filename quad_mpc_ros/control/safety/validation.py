# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Validation of inputs: each check returns why an input is unusable, or None."""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow

BODY = "base_link"
QUATERNION_TOLERANCE = 1e-3
LARGEST = 1e8  # above map coordinates in metres; squares do not overflow

NOT_UNIT = "quaternion does not have unit length"


def odometry_fault(odometry: OdometrySample, *, frame_id: str) -> str | None:
    """Return why an odometry is unusable, independently of previous ones."""
    x, y, z, w = odometry.q_WB_xyzw.tolist()
    vectors = (*odometry.p_WB.tolist(), *odometry.v_WB_B.tolist(), *odometry.w_WB_B.tolist())
    for value in (*vectors, x, y, z, w):
        if not -LARGEST <= value <= LARGEST:  # also true for NaN
            fields = {
                "pose.pose.position": odometry.p_WB,
                "twist.twist.linear": odometry.v_WB_B,
                "twist.twist.angular": odometry.w_WB_B,
                "pose.pose.orientation": odometry.q_WB_xyzw,
            }
            return f"odometry {unusable_field(fields)}"
    if abs(math.sqrt(x * x + y * y + z * z + w * w) - 1.0) > QUATERNION_TOLERANCE:
        return f"odometry {NOT_UNIT}"
    if not is_frame(odometry.frame_id, frame_id):
        return f"odometry is in frame '{odometry.frame_id}', expected '{frame_id}'"
    return None


def unusable_field(fields: dict[str, Array]) -> str:
    """Return the first unusable number; names of arrays of vectors have ``{}`` for the index."""
    return next(
        f"{name.format(*index)}.{'xyzw'[axis]} is not finite or beyond 1e8"
        for name, values in fields.items()
        for *index, axis in np.argwhere(~(np.abs(values) <= LARGEST)).tolist()
    )


def imu_fault(sample: ImuSample, *, body: str) -> str | None:
    """Return why an accelerometer sample is unusable.

    The sample's frame must be ``body``, the frame of the odometry's twist, or ``base_link``.
    """
    if not all(abs(value) <= LARGEST for value in sample.f_B.tolist()):
        return f"imu {unusable_field({'linear_acceleration': sample.f_B})}"
    if not (is_frame(sample.frame_id, body) or is_frame(sample.frame_id, BODY)):
        return f"imu is in frame '{sample.frame_id}', expected '{BODY}'"
    return None


def pose_fault(
    *, frame_id: str, expected_frame_id: str, p_WB: Array, q_WB_xyzw: Array
) -> str | None:
    """Return why poses, positions (n, 3) and quaternions (n, 4), are unusable."""
    if not is_frame(frame_id, expected_frame_id):
        return f"the message is in frame '{frame_id}', expected '{expected_frame_id}'"
    # Comparisons with NaN are false, so that NaN is refused.
    if not ((np.abs(p_WB) <= LARGEST).all() and (np.abs(q_WB_xyzw) <= LARGEST).all()):
        return f"it contains a number that is not finite or beyond {LARGEST:g}"
    if (np.abs(np.linalg.norm(q_WB_xyzw, axis=1) - 1.0) > QUATERNION_TOLERANCE).any():
        return "it contains a quaternion that does not have unit length"
    return None


def coverage_fault(window: ReferenceWindow, stamp_ns: int, *, tolerance_ns: int) -> str | None:
    """Return why a reference does not cover a time, or None if it does."""
    begins_ns = window.stamp_ns + int(window.offset_ns[0])
    ends_ns = window.stamp_ns + int(window.offset_ns[-1])
    if stamp_ns - ends_ns > tolerance_ns:
        return f"reference ended {(stamp_ns - ends_ns) * 1e-9:.2f} s before the odometry's stamp"
    if begins_ns - stamp_ns > tolerance_ns:
        return f"reference begins {(begins_ns - stamp_ns) * 1e-9:.2f} s after the odometry's stamp"
    return None


def is_frame(frame_id: str, expected: str) -> bool:
    """Return whether a frame is the expected one, ignoring tf's old leading slash."""
    return frame_id == expected or frame_id.removeprefix("/") == expected.removeprefix("/")
