# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Accelerometer samples that the controller uses, and those that it rejects."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import Tick

MS = 1_000_000
START_NS = 1_000_000_000
PERIOD_NS = 20 * MS
WEIGHT = np.array([0.0, 0.0, 9.81])


def reading(stamp_ns: int, f_B: np.ndarray = WEIGHT, frame_id: str = "base_link") -> ImuSample:
    return ImuSample(stamp_ns=stamp_ns, f_B=f_B, frame_id=frame_id)


def answered(controller: Controller, stamp_ns: int) -> Tick | None:
    """Pass odometry and reference of a hovering vehicle."""
    odometry = OdometrySample.at_rest([0.0, 0.0, 2.0], stamp_ns=stamp_ns)
    return controller.step(odometry, ReferenceWindow.hover([0.0, 0.0, 2.0], stamp_ns=stamp_ns))


def use(controller: Controller, *samples: ImuSample) -> str:
    """Return the use of samples between two odometries, after two others."""
    for stamp_ns in (START_NS - PERIOD_NS, START_NS):
        assert answered(controller, stamp_ns) is not None
    for sample in samples:
        assert controller.receive_imu(sample) is None
    tick = answered(controller, START_NS + PERIOD_NS)
    assert tick is not None and tick.command is not None
    return tick.stats.accelerometer


@pytest.fixture
def controller() -> Controller:
    return Controller(MpcConfig(accelerometer_noise=0.5))


def test_uses_samples_between_two_odometries(controller: Controller) -> None:
    assert use(controller, reading(START_NS + 5 * MS), reading(START_NS + 15 * MS)) != "missing"
    assert controller.take_warnings() == []


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (reading(START_NS + 5 * MS, np.array([0.0, np.nan, 9.81])), "linear_acceleration.y is"),
        (reading(START_NS + 5 * MS, np.array([0.0, 0.0, 1e9])), "not finite or beyond"),
        (reading(START_NS + 5 * MS, frame_id="imu_link"), "in frame 'imu_link', expected 'base_"),
        (reading(START_NS - 500 * MS), "imu stamp is 0.50 s behind the odometry's stamp"),
        (reading(START_NS + 5_000 * MS), "imu stamp is 5.00 s ahead of the odometry's stamp"),
    ],
)
def test_rejects_unusable_samples(controller: Controller, sample: ImuSample, reason: str) -> None:
    assert use(controller, sample) == "missing"
    (warning,) = controller.take_warnings()
    assert reason in warning
    tick = answered(controller, START_NS + 2 * PERIOD_NS)
    assert tick is not None and tick.stats.rejected_inputs == 1


def test_rejects_stamps_that_run_backwards(controller: Controller) -> None:
    samples = (reading(START_NS + 15 * MS), reading(START_NS + 5 * MS))
    assert use(controller, *samples) != "missing"
    assert controller.take_warnings() == ["imu stamps do not advance"]


def test_the_body_of_the_odometry_may_have_another_name(controller: Controller) -> None:
    odometry = OdometrySample.at_rest([0.0, 0.0, 2.0], stamp_ns=START_NS)
    odometry = dataclasses.replace(odometry, child_frame_id="uav1/base_link")
    controller.step(odometry, ReferenceWindow.hover([0.0, 0.0, 2.0], stamp_ns=START_NS))
    controller.receive_imu(reading(START_NS + 5 * MS, frame_id="uav1/base_link"))
    assert controller.take_warnings() == []


def test_ignores_samples_without_the_parameter() -> None:
    controller = Controller(MpcConfig())
    assert use(controller, reading(0, np.full(3, np.nan), "moon")) == "off"
    assert controller.take_warnings() == []


def test_in_lockstep_an_odometry_waits_for_its_imu_sample() -> None:
    controller = Controller(MpcConfig(accelerometer_noise=0.5, lockstep=True))
    assert answered(controller, START_NS) is not None  # there is nothing before it
    later_ns = START_NS + PERIOD_NS
    assert controller.receive_imu(reading(START_NS + 10 * MS)) is None
    assert answered(controller, later_ns) is None
    tick = controller.receive_imu(reading(later_ns))
    assert tick is not None and tick.stamp_ns == later_ns
    # A repeated sample is no fault, and the tick is returned again.
    assert controller.receive_imu(reading(later_ns)) is None
    again = answered(controller, later_ns)
    assert again is tick and controller.take_warnings() == []
