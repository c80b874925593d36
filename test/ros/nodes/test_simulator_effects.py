# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node with lags, delays, wind, noise and losses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.bag_payloads import payloads
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState
from std_srvs.srv import Trigger

from quad_mpc_ros.cli import main

EFFECTS = {
    "rate_time_constant": 0.02,
    "thrust_time_constant": 0.02,
    "command_delay": 0.0071,
    "wind": [1.0, 0.0, 0.0],
    "gust_intensity": 0.5,
    "position_noise": 0.002,
    "attitude_noise": 0.002,
    "velocity_noise": 0.01,
    "rate_noise": 0.01,
    "odom_delay": 0.0043,
    "odom_dropout": 0.05,
    "odom_jitter": 0.001,
    "imu_rate": 200,
    "imu_noise": 0.3,
    "seed": 11,
}


def test_lockstep_and_simulate_agree_with_every_effect(tmp_path: Path) -> None:
    options = ["--reference", "lemniscate", "--duration", "4"]
    options += ["--set", "mpc.advanced.accelerometer_noise=0.5"]
    options += [f"--set=simulator.{name}={json.dumps(value)}" for name, value in EFFECTS.items()]
    flown, simulated, again = tmp_path / "flown", tmp_path / "simulated", tmp_path / "again"
    assert main(["fly", "--lockstep", *options, "--out", str(flown)]) == 0
    assert main(["simulate", *options, "--out", str(simulated)]) == 0
    assert main(["resolve", str(flown), "--out", str(again)]) == 0
    for topic in ("/odom", "/command", "/imu"):
        assert len(payloads(flown / "bag", topic)) > 160
        assert payloads(flown / "bag", topic) == payloads(simulated / "bag", topic), topic
    assert payloads(again / "bag", "/command") == payloads(flown / "bag", "/command")


def fly(start: Callable[..., Any], peer: Any, subscription: Any, parameters: Path) -> None:
    """Run the simulator from the moment at which a subscription is matched to its end."""
    process = start("simulator", "--params-file", str(parameters))
    client = peer.node.create_client(Trigger, "simulator/start")
    assert peer.wait(lambda: subscription.get_publisher_count() > 0)
    assert peer.call(client, Trigger.Request()).success
    assert peer.wait(lambda: process.poll() is not None)
    assert process.returncode == 0


def test_real_time_odometry_has_delay_jitter_and_dropouts(
    tmp_path: Path, start: Callable[..., Any], peer: Any
) -> None:
    parameters = tmp_path / "simulator.yaml"
    parameters.write_text(
        "simulator:\n  ros__parameters:\n    odom_rate: 100.0\n    odom_delay: 0.05\n"
        "    odom_jitter: 0.002\n    odom_dropout: 0.3\n    position_noise: 0.5\n"
        "    autostart: false\n    duration: 2.0\n"
    )
    received: list[tuple[int, int, float]] = []

    def take(message: Odometry) -> None:
        now_ns = int(peer.node.get_clock().now().nanoseconds)
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        received.append((stamp_ns, now_ns, message.pose.pose.position.x))

    subscription = peer.node.create_subscription(Odometry, "odom", take, qos_profile_sensor_data)
    fly(start, peer, subscription, parameters)

    stamps, arrivals, x = (np.array(column) for column in zip(*received, strict=True))
    assert 100 <= len(stamps) <= 180  # of 200, three in ten dropped, a few lost
    spacing = np.diff(stamps)
    assert spacing.min() > 0
    regular = 10_000_000 * np.round((stamps - stamps[0]) / 10_000_000)
    assert np.std(stamps - stamps[0] - regular) == pytest.approx(2e6, rel=0.3)
    assert np.median(arrivals - stamps) == pytest.approx(51e6, abs=5e6)
    assert (arrivals - stamps).min() >= 50e6
    assert np.std(x) == pytest.approx(0.5, rel=0.25)


def test_publishes_sagging_battery_voltage(
    tmp_path: Path, start: Callable[..., Any], peer: Any
) -> None:
    parameters = tmp_path / "simulator.yaml"
    parameters.write_text(
        "simulator:\n  ros__parameters:\n    plant: rotors\n    autostart: false\n"
        "    initial_throttle: 0.29\n    duration: 3.0\n    battery.capacity: 0.001\n"
    )
    volts: list[float] = []
    subscription = peer.node.create_subscription(
        BatteryState, "battery", lambda m: volts.append(m.voltage), qos_profile_sensor_data
    )
    fly(start, peer, subscription, parameters)
    assert 5 <= len(volts) <= 15
    assert 13.2 < volts[-1] < volts[0] <= 16.8
