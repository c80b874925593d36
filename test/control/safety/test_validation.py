# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Unusable inputs, and the reasons that are reported."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.validation import coverage_fault, odometry_fault
from quad_mpc_ros.control.safety.window_validation import reference_fault

MakeOdometry = Callable[..., OdometrySample]
MakeWindow = Callable[..., ReferenceWindow]

NOT_FINITE = [math.nan, math.inf, -math.inf]
ODOMETRY_NUMBERS = [
    (name, index)
    for name, size in (("p_WB", 3), ("q_WB_xyzw", 4), ("v_WB_B", 3), ("w_WB_B", 3))
    for index in range(size)
]


def fault_of(odometry: OdometrySample) -> str | None:
    return odometry_fault(odometry, frame_id="odom")


@pytest.mark.parametrize("value", NOT_FINITE)
@pytest.mark.parametrize(("name", "index"), ODOMETRY_NUMBERS)
def test_every_number_of_an_odometry_must_be_finite(
    make_odometry: MakeOdometry, name: str, index: int, value: float
) -> None:
    numbers = np.array(getattr(make_odometry(0), name))
    numbers[index] = value
    assert "not finite" in (fault_of(make_odometry(0, **{name: numbers})) or "")


@pytest.mark.parametrize(
    ("length", "accepted"),
    [
        (0.0, False),
        (0.9985, False),
        (0.9995, True),
        (1.0, True),
        (1.0005, True),
        (1.0015, False),
        (2.0, False),
    ],
)
def test_quaternions_must_be_of_unit_length(
    make_odometry: MakeOdometry, make_window: MakeWindow, length: float, accepted: bool
) -> None:
    q = length * np.array([0.5, -0.5, 0.5, 0.5])
    odometry = make_odometry(0, q_WB_xyzw=q)
    window = make_window(0, q_WB_xyzw=np.stack([[0.0, 0.0, 0.0, 1.0], q]))
    assert (fault_of(odometry) is None) == accepted
    assert (reference_fault(window, frame_id="odom") is None) == accepted
    if not accepted:
        assert "unit length" in (fault_of(odometry) or "")
        assert "unit length" in (reference_fault(window, frame_id="odom") or "")


@pytest.mark.parametrize(
    ("frame_id", "accepted"),
    [("odom", True), ("/odom", True), ("map", False), ("", False), ("odom2", False)],
)
def test_the_frame_must_be_the_expected_one(
    make_odometry: MakeOdometry, make_window: MakeWindow, frame_id: str, accepted: bool
) -> None:
    for expected in ("odom", "/odom"):
        faults = (
            odometry_fault(make_odometry(0, frame_id=frame_id), frame_id=expected),
            reference_fault(make_window(0, frame_id=frame_id), frame_id=expected),
        )
        for fault in faults:
            assert (fault is None) == accepted
            assert accepted or f"'{frame_id}', expected '{expected}'" in (fault or "")


@pytest.mark.parametrize("value", NOT_FINITE)
@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("p_WB", "transforms[0].translation.z"),
        ("q_WB_xyzw", "transforms[0].rotation.w"),
        ("v_WB_W", "velocities[0].linear.z"),
        ("a_WB_W", "accelerations[0].linear.z"),
        ("w_WB_W", "velocities[0].angular.z"),
    ],
)
def test_every_number_of_a_reference_must_be_finite(
    make_window: MakeWindow, name: str, field: str, value: float
) -> None:
    numbers: Array = np.array(getattr(make_window(0), name))
    numbers[-1, -1] = value
    fault = reference_fault(make_window(0, **{name: numbers}), frame_id="odom")
    assert fault == f"reference points[1].{field} is not finite or beyond 1e8"


def test_times_of_a_reference_must_not_run_backwards(make_window: MakeWindow) -> None:
    for offsets, accepted in (([0, 0], True), ([5, 5], True), ([5, 4], False)):
        window = make_window(0, offset_ns=np.array(offsets, dtype=np.int64))
        fault = reference_fault(window, frame_id="odom")
        assert fault == (None if accepted else "reference times go backwards")


def test_an_empty_reference_is_refused(make_window: MakeWindow) -> None:
    whole = make_window(0)
    empty = dataclasses.replace(
        whole,
        **{
            name: getattr(whole, name)[:0]
            for name in ("offset_ns", "p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W")
        },
    )
    assert reference_fault(empty, frame_id="odom") == "reference is empty"


@pytest.mark.parametrize(
    ("stamp_ms", "expected"),
    [
        (-501, "reference begins 0.50 s after"),
        (-500, None),
        (0, None),
        (2500, None),
        (2501, "reference ended 0.50 s before"),
        (60_000, "reference ended 58.00 s before"),
    ],
)
def test_reference_must_cover_odometry_time(
    make_window: MakeWindow, stamp_ms: int, expected: str | None
) -> None:
    start = 10**18
    window = make_window(start)  # two seconds long
    fault = coverage_fault(window, start + stamp_ms * 1_000_000, tolerance_ns=500_000_000)
    assert (fault or "").startswith(expected or "")
    assert (fault is None) == (expected is None)
