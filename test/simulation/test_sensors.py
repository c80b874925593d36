# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Noise, bias, drop-outs, delay and jitter of the odometry."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.simulation.internal_plant import InternalPlant
from quad_mpc_ros.simulation.sensors import (
    OdometryStream,
    Sensors,
    SentOdometry,
    odometry_stamps,
)

START_NS = 1_000_000_000
TRUTH = OdometrySample(
    stamp_ns=5,
    p_WB=np.array([1.0, -2.0, 3.0]),
    q_WB_xyzw=Rotation.from_euler("xyz", [0.5, -1.0, 2.5]).as_quat(),
    v_WB_B=np.array([4.0, 5.0, -6.0]),
    w_WB_B=np.array([-0.5, 0.7, 0.9]),
)


def sensors(**changes: Any) -> Sensors:
    return Sensors(ideal(changes))


def errors(samples: list[OdometrySample]) -> dict[str, Array]:
    """Return the errors by field; of the attitude as rotation vectors in the true body."""
    inverse = Rotation.from_quat(TRUTH.q_WB_xyzw).inv()
    found = {
        name: np.array([getattr(sample, name) - getattr(TRUTH, name) for sample in samples])
        for name in ("p_WB", "v_WB_B", "w_WB_B")
    }
    found["attitude"] = np.array(
        [(inverse * Rotation.from_quat(sample.q_WB_xyzw)).as_rotvec() for sample in samples]
    )
    return found


NOISE = {
    "position_noise": ("p_WB", 0.01),
    "attitude_noise": ("attitude", 0.02),
    "velocity_noise": ("v_WB_B", 0.05),
    "rate_noise": ("w_WB_B", 0.1),
}


@pytest.mark.parametrize("parameter", NOISE)
def test_noise_is_white_gaussian_of_its_standard_deviation(parameter: str) -> None:
    field, sigma = NOISE[parameter]
    sensor = sensors(**{parameter: sigma})
    found = errors([sensor.measured(TRUTH) for _ in range(5000)])
    noise = found.pop(field)
    assert_allclose(noise.std(axis=0), sigma, rtol=0.04)
    assert_allclose(noise.mean(axis=0), 0.0, atol=0.06 * sigma)
    assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 0.06
    assert np.abs(np.mean(noise[1:] * noise[:-1], axis=0)).max() < 0.06 * sigma**2
    for axis in noise.T:
        assert kstest(axis / sigma, "norm").pvalue > 0.001
    for other in found.values():
        assert_allclose(other, 0.0, atol=1e-14)


def test_biases_are_in_the_frames_of_the_odometry() -> None:
    sample = sensors(
        position_bias=(0.1, 0.2, -0.3),
        velocity_bias=(0.4, 0.0, 0.0),
        attitude_bias=(0.0, 0.3, 0.0),
    ).measured(TRUTH)
    assert_allclose(sample.p_WB, [1.1, -1.8, 2.7])
    assert_allclose(sample.v_WB_B, [4.4, 5.0, -6.0])
    assert_array_equal(sample.w_WB_B, TRUTH.w_WB_B)
    tilted = Rotation.from_quat(TRUTH.q_WB_xyzw) * Rotation.from_euler("y", 0.3)
    assert (tilted.inv() * Rotation.from_quat(sample.q_WB_xyzw)).magnitude() < 1e-12


@pytest.mark.parametrize("probability", [0.0, 0.05, 0.5, 0.99])
def test_drops_the_configured_fraction(probability: float) -> None:
    sensor = sensors(odom_dropout=probability)
    lost = [sensor.lost() for _ in range(10_000)]
    assert not lost[0]
    assert np.mean(lost) == pytest.approx(probability, abs=0.015)


def test_an_effect_does_not_change_the_random_numbers_of_another() -> None:
    plain = sensors(position_noise=0.1)
    lossy = sensors(position_noise=0.1, odom_dropout=0.5, odom_jitter=0.001, rate_noise=0.2)
    for _ in range(10):
        lossy.lost()
        assert_array_equal(plain.measured(TRUTH).p_WB, lossy.measured(TRUTH).p_WB)


def stamps(**changes: Any) -> list[int]:
    return list(odometry_stamps(ideal({"duration": 100.0, **changes})))


def test_jitter_has_its_standard_deviation_and_no_memory() -> None:
    found = np.array(stamps(odom_jitter=0.002))
    late = (found - 20_000_000 * np.arange(5000)) * 1e-9
    assert late[0] == 0.0
    assert late.std() == pytest.approx(0.002, rel=0.04)
    assert abs(late.mean()) < 0.0001
    assert abs(np.mean(late[1:] * late[:-1])) < 0.06 * 0.002**2


@pytest.mark.parametrize("jitter", [0.01, 1.0])
def test_jitter_never_reorders(jitter: float) -> None:
    found = stamps(odom_jitter=jitter)
    assert found[0] == 0
    assert min(b - a for a, b in itertools.pairwise(found)) >= 0.1 * 20_000_000 - 1
    assert max(np.abs(found - 20_000_000 * np.arange(5000))) <= 0.45 * 20_000_000


def flown(**changes: Any) -> list[SentOdometry]:
    """Return the odometries of a vehicle that falls from rest at 100 m."""
    config = ideal(
        {"initial_position": (0.0, 0.0, 100.0), "duration": 2.0, "drag": 0.0, **changes}
    )
    stream = OdometryStream(InternalPlant(config), config, start_stamp_ns=START_NS)
    sent: list[SentOdometry] = []
    while (odometry := stream.step()) is not None:
        sent.append(odometry)
    return sent


def acceleration() -> float:
    vehicle = ideal().vehicle()
    return vehicle.thrust(0.0) / vehicle.mass - vehicle.gravity


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.02, 0.0537])
@pytest.mark.parametrize("jitter", [0.0, 0.003])
def test_an_odometry_is_the_measurement_at_its_stamp(delay: float, jitter: float) -> None:
    sent = flown(odom_delay=delay, odom_jitter=jitter)
    assert len(sent) == 100
    assert sent[0].odometry.stamp_ns == START_NS
    for odometry in sent:
        measured_ns = odometry.odometry.stamp_ns - START_NS
        assert odometry.time_ns == measured_ns + round(delay * 1e9)
        height = 100.0 + 0.5 * acceleration() * (measured_ns * 1e-9) ** 2
        assert odometry.odometry.p_WB[2] == pytest.approx(height, abs=1e-9)


@pytest.mark.parametrize("jitter", [0.0, 0.003])
def test_stamp_of_sending_hides_the_delay(jitter: float) -> None:
    sent = flown(odom_delay=0.0537, odom_jitter=jitter, odom_stamp="sent")
    assert len(sent) == 100
    for odometry in sent:
        assert odometry.odometry.stamp_ns == START_NS + odometry.time_ns
        assert odometry.truth.stamp_ns == odometry.odometry.stamp_ns
        for sample, age in ((odometry.odometry, 0.0537), (odometry.truth, 0.0)):
            height = 100.0 + 0.5 * acceleration() * (odometry.time_ns * 1e-9 - age) ** 2
            assert sample.p_WB[2] == pytest.approx(height, abs=1e-9)


def test_dropped_odometries_are_measured_but_not_sent() -> None:
    complete = {s.odometry.stamp_ns: s for s in flown(position_noise=0.1)}
    sent = flown(position_noise=0.1, odom_dropout=0.3)
    assert 50 <= len(sent) <= 90
    assert sent[0].odometry.stamp_ns == START_NS
    for one in sent:
        assert_array_equal(one.odometry.p_WB, complete[one.odometry.stamp_ns].odometry.p_WB)


def test_commands_act_from_the_publication_of_their_odometry() -> None:
    """With 50 ms of delay the third odometry is the first to see the answer to the first."""
    config = ideal(odom_delay=0.05, duration=0.2, initial_position=(0.0, 0.0, 9.0))
    plant = InternalPlant(config)
    stream = OdometryStream(plant, config, start_stamp_ns=START_NS)
    seen = []
    while (sent := stream.step()) is not None:
        seen.append(sent.odometry.w_WB_B[0])
        answer = np.array([float(len(seen)), 0.0, 0.0])
        plant.apply(CommandSample(stamp_ns=sent.odometry.stamp_ns, throttle=0.3, w_WB_B=answer))
    # Measured at 0, 20, 40, 60 … ms, answered at 50, 70 … ms.
    assert seen == [0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]


@pytest.mark.parametrize("changes", [{}, {"odom_delay": 0.033, "odom_jitter": 0.002}])
def test_stepping_by_a_clock_gives_the_same_odometries(changes: dict[str, float]) -> None:
    stepped = flown(position_noise=0.1, odom_dropout=0.1, **changes)
    config = ideal(
        {"initial_position": (0.0, 0.0, 100.0), "duration": 2.0, "drag": 0.0}
        | {"position_noise": 0.1, "odom_dropout": 0.1, **changes}
    )
    stream = OdometryStream(InternalPlant(config), config, start_stamp_ns=START_NS)
    followed: list[SentOdometry] = []
    time_ns = 0
    while not stream.ended(time_ns):
        for sent in stream.advance_to(time_ns):
            assert sent.time_ns <= time_ns
            followed.append(sent)
        time_ns += 777_777
    assert 2_000_000_000 <= time_ns <= 2_100_000_000
    assert [s.time_ns for s in followed] == [s.time_ns for s in stepped]
    for one, other in zip(followed, stepped, strict=True):
        assert_allclose(one.odometry.p_WB, other.odometry.p_WB, rtol=0.0, atol=1e-9)
