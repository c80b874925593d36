# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulated accelerometer: readings and stamps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal

from quad_mpc_ros.control.model.samples import CommandSample, ImuSample
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.sensors import OdometryStream, SentOdometry

START_NS = 1_000_000_000
GRAVITY = 9.81


def flown(config: SimulatorConfig, *, throttle: float, count: int = 25) -> list[SentOdometry]:
    """Return odometries of a vehicle under one command."""
    plant = make_plant(config)
    stream, sent = OdometryStream(plant, config, start_stamp_ns=START_NS), []
    for _ in range(count):
        odometry = stream.step()
        assert odometry is not None
        command = CommandSample(
            stamp_ns=odometry.odometry.stamp_ns, throttle=throttle, w_WB_B=np.zeros(3)
        )
        plant.apply(command)
        sent.append(odometry)
    return sent


def imu_samples(config: SimulatorConfig, *, throttle: float, count: int = 25) -> list[ImuSample]:
    sent = flown(config, throttle=throttle, count=count)
    return [sample for each in sent for sample in each.imu]


def airborne(**changes: Any) -> SimulatorConfig:
    return ideal(initial_position=(0.0, 0.0, 50.0), imu_rate=200.0, **changes)


@pytest.mark.parametrize("plant", ["internal", "rotors"])
def test_hover_reads_gravity_upwards(plant: str) -> None:
    config = SimulatorConfig(
        plant=plant, imu_rate=200.0, initial_position=(0.0, 0.0, 50.0), initial_throttle=0.29
    )
    hover = config.vehicle().hover_throttle
    readings = np.array([sample.f_B for sample in imu_samples(config, throttle=hover)])
    np.testing.assert_allclose(readings[-20:, :2], 0.0, atol=0.1)
    np.testing.assert_allclose(readings[-20:, 2], GRAVITY, rtol=0.05)


def test_ground_reads_gravity_and_free_fall_nothing() -> None:
    ground = imu_samples(ideal(imu_rate=100.0), throttle=0.0)
    np.testing.assert_allclose([each.f_B for each in ground], [[0.0, 0.0, GRAVITY]] * len(ground))
    falling = imu_samples(airborne(drag=0.0, thrust_curve=(0.0, 1.0, 0.0)), throttle=0.0)
    np.testing.assert_allclose([each.f_B for each in falling], 0.0, atol=1e-6)


@pytest.mark.parametrize(("rate", "count"), [(10.0, 1), (50.0, 1), (120.0, 3), (200.0, 4)])
def test_samples_are_equally_spaced_and_come_with_each_odometry(rate: float, count: int) -> None:
    first, *others = flown(ideal(imu_rate=rate, odom_rate=50.0), throttle=0.0)
    assert first.imu == ()
    before_ns = first.odometry.stamp_ns
    for each in others:
        stamps = [sample.stamp_ns for sample in each.imu]
        assert len(stamps) == count and stamps[-1] == each.odometry.stamp_ns
        assert set(np.diff([before_ns, *stamps])) == {20_000_000 // count} or count == 3
        before_ns = each.odometry.stamp_ns


@pytest.mark.parametrize("more", [{"odom_dropout": 0.4}, {"odom_jitter": 0.003}])
@pytest.mark.parametrize("stamped", ["measured", "sent"])
def test_samples_are_neither_lost_nor_late_with_odometries(
    more: dict[str, float], stamped: str
) -> None:
    config = airborne(odom_delay=0.03, odom_stamp=stamped, **more)
    sent = flown(config, throttle=0.3, count=60)
    stamps = [sample.stamp_ns for each in sent for sample in each.imu]
    assert stamps == sorted(set(stamps))
    assert np.diff(stamps).max() < 9_000_000
    for each in sent[1:]:
        assert each.imu[-1].stamp_ns == each.odometry.stamp_ns


def test_errs_as_configured_and_repeats_with_its_seed() -> None:
    """On the ground."""
    config = ideal(imu_rate=200.0, imu_noise=0.5, imu_bias=(0.1, 0.2, -0.3), odom_rate=20.0)
    readings = np.array([each.f_B for each in imu_samples(config, throttle=0.0, count=400)])
    expected = np.add(config.imu_bias, [0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(readings.mean(axis=0), expected, atol=0.05)
    np.testing.assert_allclose(readings.std(axis=0), 0.5, rtol=0.05)
    again = np.array([each.f_B for each in imu_samples(config, throttle=0.0, count=400)])
    np.testing.assert_array_equal(again, readings)


def test_tilted_vehicle_reads_thrust_along_body_z() -> None:
    tilted = (0.0, 0.3826834, 0.0, 0.9238795)
    readings = imu_samples(airborne(drag=0.0, initial_attitude=tilted), throttle=0.3)
    lift = 4.0 * np.polyval(SimulatorConfig().thrust_curve, 0.3) / SimulatorConfig().mass
    expected = np.tile([0.0, 0.0, lift], (len(readings) - 4, 1))
    np.testing.assert_allclose([each.f_B for each in readings[4:]], expected, atol=1e-6)
