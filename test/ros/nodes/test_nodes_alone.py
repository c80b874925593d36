# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Each node by itself, as ``ros2 run`` starts it."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.processes import PATIENCE
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from rosbags.highlevel import AnyReader
from std_srvs.srv import Trigger

from quad_mpc_ros.messages import conversions

Start = Callable[..., "subprocess.Popen[bytes]"]


def test_nodes_end_cleanly_on_a_signal_in_the_middle_of_a_flight(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    numbers = {
        "mpc": signal.SIGINT,
        "recorder": signal.SIGTERM,
        "reference": signal.SIGTERM,
        "simulator": signal.SIGINT,
    }
    bag = ("-p", f"directory:={tmp_path / 'bag'}")
    processes = {name: start(name, *(bag if name == "recorder" else ())) for name in numbers}
    logs = {name: tmp_path / f"{name}.log" for name in numbers}
    assert peer.wait(lambda: "the MPC flies" in logs["mpc"].read_text())
    assert peer.wait(lambda: "active" in logs["recorder"].read_text().split())
    for name, number in numbers.items():
        processes[name].send_signal(number)
        assert processes[name].wait(PATIENCE) == 0
        log = logs[name].read_text()
        assert "Traceback" not in log
        assert "FATAL" not in log


def test_warns_of_two_odometry_sources_and_zero_lags(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    mpc = managed("mpc")
    rivals = [
        peer.node.create_publisher(Odometry, "odom", qos_profile_sensor_data) for _ in range(2)
    ]
    lags = ("-p", "input_delay:=0.0", "-p", "rate_time_constant:=0.03")
    start("mpc", *lags, "-p", "envelope.tilt_max:=0.5")

    def warned() -> bool:
        return str(mpc.health.get("text")).startswith("2 publishers on odom,")

    assert peer.wait(warned)
    assert mpc.level == DiagnosticStatus.WARN
    peer.node.destroy_publisher(rivals[1])
    assert peer.wait(lambda: not warned())
    log = (tmp_path / "mpc.log").read_text()
    assert log.count("input_delay = 0: every real vehicle lags") == 1
    assert log.count("limits.tilt_max allows 0.61 rad in the plan, envelope.tilt_max is 0.5") == 1


def test_recorder_refuses_a_folder_that_exists(start: Start, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    process = start("recorder", "-p", f"directory:={tmp_path / 'bag'}")
    assert process.wait(PATIENCE) == 2
    assert str(tmp_path / "bag") in (tmp_path / "recorder.log").read_text()


def test_simulator_publishes_odometry_in_its_namespace_and_remapped(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text(
        "/uav1/simulator:\n  ros__parameters:\n"
        "    initial_position: [1, 2, 3]\n    odom_rate: 100\n    frame_id: map\n"
    )
    received: list[Odometry] = []
    peer.node.create_subscription(
        Odometry, "/uav1/truth", received.append, qos_profile_sensor_data
    )

    start("simulator", "--params-file", str(parameters), "-r", "__ns:=/uav1", "-r", "odom:=truth")

    assert peer.wait(lambda: len(received) > 20)
    assert received[0].header.frame_id == "map"
    assert received[0].pose.pose.position.x == 1.0
    stamps = np.array([conversions.nanoseconds(m.header.stamp) for m in received])
    assert np.median(np.diff(stamps)) == pytest.approx(10e6, rel=0.3)


def test_recorder_subscribes_before_a_topic_has_a_publisher(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    start("recorder", "-p", f"directory:={tmp_path / 'bag'}", "-p", "topics:=[odom, imu]")
    expected = "/odom", "/imu"
    assert peer.wait(lambda: all(map(peer.node.count_subscribers, expected)))
    assert not any(map(peer.node.count_publishers, expected))


def test_a_lockstep_flight_waits_for_a_stopped_recorder(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    flown: list[Odometry] = []
    peer.node.create_subscription(Odometry, "odom", flown.append, qos_profile_sensor_data)
    follows = ("-p", "lockstep:=true", "-p", "use_sim_time:=true")
    bag, log = tmp_path / "bag", tmp_path / "simulator.log"
    recorder = start("recorder", "-p", f"directory:={bag}", "-p", "use_sim_time:=true")
    start("mpc", *follows)
    start("reference", *follows)
    ends = ("-p", "duration:=8.0", "-p", "imu_rate:=200.0", "-p", "autostart:=false")
    simulator = start("simulator", "-p", "lockstep:=true", *ends)
    begin = peer.node.create_client(Trigger, "simulator/start")
    topics = ("odom", "imu", "reference", "command", "mpc/stats")
    matched = {f"peers./{topic}": "1" for topic in topics}
    reported = managed("recorder")
    assert peer.wait(lambda: matched.items() <= reported.health.items())
    assert peer.call(begin, Trigger.Request()).success
    assert peer.wait(lambda: len(flown) > 50)

    recorder.send_signal(signal.SIGSTOP)
    assert peer.wait(
        lambda: "a slow subscriber of /odom" in log.read_text() or simulator.poll() is not None
    )
    recorder.send_signal(signal.SIGCONT)
    for _ in range(10):  # also before it has the answers to the odometries that it has
        peer.spin(0.02)
        recorder.send_signal(signal.SIGSTOP)
        peer.spin(0.1)
        recorder.send_signal(signal.SIGCONT)
    assert peer.wait(lambda: simulator.poll() == 0)
    # It ends with the last command, after which the MPC publishes its statistics. A last message
    # that is lost comes with a heartbeat, up to 3 s later.
    peer.spin(4.0)
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(PATIENCE) == 0

    with AnyReader([bag]) as reader:  # an odometry is repeated if it is not answered in a second
        recorded = {(each.topic[1:], each.msgtype, data) for each, _, data in reader.messages()}
        stamps: dict[str, list[int]] = {topic: [] for topic in topics}
        for topic, msgtype, data in recorded:
            if topic in stamps:
                stamp = reader.deserialize(data, msgtype).header.stamp
                stamps[topic].append(conversions.nanoseconds(stamp))
    assert len(stamps["imu"]) == 4 * 399
    assert len(stamps["odom"]) == 400
    for topic in ("reference", "command", "mpc/stats"):
        missing = sorted(set(stamps["odom"]) - set(stamps[topic]))
        assert not missing, (topic, missing)
        assert len(stamps[topic]) == 400, topic


def test_lockstep_waits_for_compiling_node(start: Start, peer: Any, tmp_path: Path) -> None:
    compiling = rclpy.create_node("mpc")
    # A lost announcement of the node comes again after 3 s.
    process = start("simulator", "-p", "lockstep:=true", "-p", "advanced.lockstep_timeout:=5.0")
    log = tmp_path / "simulator.log"
    assert peer.wait(lambda: "waiting for mpc" in log.read_text() or process.poll() is not None)
    peer.spin(5.5)
    assert process.poll() is None, log.read_text()
    compiling.destroy_node()
    assert process.wait(PATIENCE) == 1
    assert "lockstep_timeout" in log.read_text()
