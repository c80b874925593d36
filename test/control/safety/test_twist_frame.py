"""Noticing that the odometry's twist is in the other frame."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.twist_frame import TwistFrameCheck

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


def reported(check: TwistFrameCheck, samples: list[OdometrySample]) -> list[str]:
    return [frame for frame in map(check.suspect, samples) if frame is not None]


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_reports_wrong_frame_once(noise: float) -> None:
    body = circling(1500, noise=noise)
    world = [in_world(odometry) for odometry in body]
    assert reported(TwistFrameCheck(twist_frame="child"), world) == ["world"]
    assert reported(TwistFrameCheck(twist_frame="world"), body) == ["child"]


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_never_reports_right_frame(noise: float) -> None:
    body = circling(1500, noise=noise)
    world = [in_world(odometry) for odometry in body]
    assert reported(TwistFrameCheck(twist_frame="child"), body) == []
    assert reported(TwistFrameCheck(twist_frame="world"), world) == []


def test_does_not_report_again_after_correction() -> None:
    check = TwistFrameCheck(twist_frame="child")
    found: list[str] = []
    for odometry in circling(1500):
        # The wrong frame until it is reported, then the right one, then the wrong one again.
        right = bool(found) and odometry.stamp_ns < 20_000_000_000
        found += reported(check, [odometry if right else in_world(odometry)])
    assert found == ["world"]


def test_reports_within_a_few_seconds() -> None:
    world = [in_world(odometry) for odometry in circling(250)]
    assert reported(TwistFrameCheck(twist_frame="child"), world) == ["world"]


def test_position_jump_is_not_evidence() -> None:
    body = circling(1000)
    for i in (200, 600):
        body[i] = dataclasses.replace(body[i], p_WB=body[i].p_WB + 50.0)
    assert reported(TwistFrameCheck(twist_frame="child"), body) == []


def test_skips_repeated_and_backwards_stamps() -> None:
    samples = circling(10)
    repeated = [samples[5], samples[5], samples[2], samples[3]] * 50
    assert reported(TwistFrameCheck(twist_frame="child"), repeated) == []


def test_standing_still_gives_no_evidence() -> None:
    still = [
        dataclasses.replace(odometry, p_WB=np.zeros(3), v_WB_B=np.array([3.0, 0.0, 0.0]))
        for odometry in circling(500)
    ]
    assert reported(TwistFrameCheck(twist_frame="child"), still) == []
