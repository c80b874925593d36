"""Messages that nobody should fly: what a fault makes of a good one."""

from __future__ import annotations

import dataclasses

import numpy as np

from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow

_FAR = np.array([1000.0, 1000.0, 0.0])  # m
_ASIDE = np.array([2.0, -1.0, 1.0])  # m
_A_LITTLE_ASIDE = np.array([0.5, 0.0, 0.0])  # m


def not_a_number(odometry: OdometrySample) -> OdometrySample:
    """Make the position NaN."""
    return dataclasses.replace(odometry, p_WB=np.full(3, np.nan))


def in_another_frame(odometry: OdometrySample) -> OdometrySample:
    """Name another world frame."""
    return dataclasses.replace(odometry, frame_id="elsewhere")


def not_of_unit_length(odometry: OdometrySample) -> OdometrySample:
    """Make the quaternion too long."""
    return dataclasses.replace(odometry, q_WB_xyzw=1.1 * odometry.q_WB_xyzw)


def aside(odometry: OdometrySample) -> OdometrySample:
    """Move the position, as an estimator does that finds itself somewhere else."""
    return dataclasses.replace(odometry, p_WB=odometry.p_WB + _ASIDE)


def of_another_estimator(odometry: OdometrySample) -> OdometrySample:
    """Move the position as far as two estimators differ, a millisecond later."""
    return dataclasses.replace(
        odometry, p_WB=odometry.p_WB + _A_LITTLE_ASIDE, stamp_ns=odometry.stamp_ns + 1_000_000
    )


def reference_not_a_number(window: ReferenceWindow) -> ReferenceWindow:
    """Make every velocity NaN."""
    return dataclasses.replace(window, v_WB_W=np.full_like(window.v_WB_W, np.nan))


def reference_empty(window: ReferenceWindow) -> ReferenceWindow:
    """Leave no sample."""
    arrays = {
        field.name: getattr(window, field.name)[:0]
        for field in dataclasses.fields(window)
        if isinstance(getattr(window, field.name), np.ndarray)
    }
    return dataclasses.replace(window, **arrays)


def reference_in_another_frame(window: ReferenceWindow) -> ReferenceWindow:
    """Name another world frame."""
    return dataclasses.replace(window, frame_id="elsewhere")


def reference_not_of_unit_length(window: ReferenceWindow) -> ReferenceWindow:
    """Make every quaternion zero."""
    return dataclasses.replace(window, q_WB_xyzw=np.zeros_like(window.q_WB_xyzw))


def reference_far_away(window: ReferenceWindow) -> ReferenceWindow:
    """Move the reference by more than a kilometre."""
    return dataclasses.replace(window, p_WB=window.p_WB + _FAR)


def reference_of_another_server(window: ReferenceWindow) -> ReferenceWindow:
    """Move the reference a little."""
    return dataclasses.replace(window, p_WB=window.p_WB + _A_LITTLE_ASIDE)
