"""Noticing that the odometry's twist is in the other frame."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.estimation.twist_frame import TwistFrameCheck
from quad_mpc_ros.control.model.samples import OdometrySample

PERIOD_NS = 20_000_000


def circling(count: int, *, speed: float = 3.0, noise: float = 0.0) -> list[OdometrySample]:
    """Return odometry, twist in the body, of a circle flown nose first."""
    rng = np.random.default_rng(1)
    radius = 4.0
    samples = []
    for i in range(count):
        angle = speed / radius * i * PERIOD_NS * 1e-9
        samples.append(
            OdometrySample(
                stamp_ns=i * PERIOD_NS,
                p_WB=radius * np.array([math.sin(angle), 1.0 - math.cos(angle), 0.5])
                + noise * rng.normal(size=3),
                q_WB_xyzw=Rotation.from_euler("z", angle).as_quat(),
                v_WB_B=np.array([speed, 0.0, 0.0]),
                w_WB_B=np.array([0.0, 0.0, speed / radius]),
            )
        )
    return samples


def in_world(odometry: OdometrySample) -> OdometrySample:
    rotation = Rotation.from_quat(odometry.q_WB_xyzw)
    return dataclasses.replace(odometry, v_WB_B=rotation.apply(odometry.v_WB_B))


def told(check: TwistFrameCheck, samples: list[OdometrySample]) -> list[str]:
    return [frame for frame in map(check.suspect, samples) if frame is not None]


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_the_wrong_frame_is_told_once(noise: float) -> None:
    body = circling(1500, noise=noise)
    world = [in_world(odometry) for odometry in body]
    assert told(TwistFrameCheck(twist_frame="child"), world) == ["world"]
    assert told(TwistFrameCheck(twist_frame="world"), body) == ["child"]


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_right_frame_is_never_suspected(noise: float) -> None:
    body = circling(1500, noise=noise)
    world = [in_world(odometry) for odometry in body]
    assert told(TwistFrameCheck(twist_frame="child"), body) == []
    assert told(TwistFrameCheck(twist_frame="world"), world) == []


def test_it_is_not_told_again_when_the_source_is_put_right() -> None:
    check = TwistFrameCheck(twist_frame="child")
    found: list[str] = []
    for odometry in circling(1500):
        # The wrong frame until it is told, then the right one, then the wrong one again.
        right = bool(found) and odometry.stamp_ns < 20_000_000_000
        found += told(check, [odometry if right else in_world(odometry)])
    assert found == ["world"]


def test_it_is_told_within_a_few_seconds() -> None:
    world = [in_world(odometry) for odometry in circling(250)]
    assert told(TwistFrameCheck(twist_frame="child"), world) == ["world"]


def test_a_jump_of_the_position_alone_is_not_evidence_enough() -> None:
    body = circling(1000)
    for i in (200, 600):
        body[i] = dataclasses.replace(body[i], p_WB=body[i].p_WB + 50.0)
    assert told(TwistFrameCheck(twist_frame="child"), body) == []


def test_stamps_that_repeat_or_run_backwards_are_passed_over() -> None:
    samples = circling(10)
    repeated = [samples[5], samples[5], samples[2], samples[3]] * 50
    assert told(TwistFrameCheck(twist_frame="child"), repeated) == []


def test_standing_still_gives_no_evidence() -> None:
    still = [
        dataclasses.replace(odometry, p_WB=np.zeros(3), v_WB_B=np.array([3.0, 0.0, 0.0]))
        for odometry in circling(500)
    ]
    assert told(TwistFrameCheck(twist_frame="child"), still) == []
