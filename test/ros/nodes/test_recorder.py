# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process, with publishers of the test."""

from __future__ import annotations

import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.processes import PATIENCE, node_of
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from std_msgs.msg import Header, Int32, String

from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.recordings.repair import repair
from quad_mpc_ros.ros.nodes.recorder import Recorder, new_bag

Start = Callable[..., "subprocess.Popen[bytes]"]

RELIABLE = QoSProfile(depth=100)
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def end(process: subprocess.Popen[bytes], number: int = signal.SIGINT) -> int:
    process.send_signal(number)
    return process.wait(PATIENCE)


def numbers(bag: Path, topic: str) -> list[int]:
    with AnyReader([bag]) as reader:
        return [
            reader.deserialize(data, connection.msgtype).data
            for connection, _, data in reader.messages()
            if connection.topic == topic
        ]


def test_further_signals_during_shutdown_keep_a_complete_bag(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    """``timeout -s INT … ros2 launch`` sends two, and who is impatient more."""
    bag = tmp_path / "bag"
    publisher = peer.node.create_publisher(String, "/words", RELIABLE)
    recorder = start("recorder", "-p", f"directory:={bag}", "-p", "topics:=[/words]")
    assert peer.wait(publisher.get_subscription_count)
    for _ in range(100):
        publisher.publish(String(data=10_000 * "x"))
        peer.spin(0.001)
    for _ in range(6):
        if recorder.poll() is None:
            recorder.send_signal(signal.SIGINT)
            time.sleep(0.01)
    assert recorder.wait(PATIENCE) == 0
    assert (bag / "metadata.yaml").is_file()
    with AnyReader([bag]) as reader:
        assert reader.message_count > 0


def test_records_publishers_of_every_quality_of_service(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    """A reliable publisher, then a best-effort one on the same topic: both without a gap."""
    bag = tmp_path / "bag"
    reliable = peer.node.create_publisher(Int32, "/mixed", RELIABLE)
    latched = peer.node.create_publisher(Int32, "/latched", LATCHED)
    latched.publish(Int32(data=5))  # before anybody listens
    recorder = start(
        "recorder", "-p", f"directory:={bag}", "-p", "topics:=[/mixed, /latched, /later]"
    )
    status = managed("recorder")
    assert peer.wait(reliable.get_subscription_count)
    peer.spin(0.3)
    count = 0

    def publish_for(seconds: float, *others: Any) -> None:
        nonlocal count
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            reliable.publish(Int32(data=count))
            for other in others:
                other.publish(Int32(data=-count))
            count += 1
            peer.spin(0.01)

    publish_for(0.5)
    best_effort = peer.node.create_publisher(Int32, "/mixed", BEST_EFFORT)
    give_up = time.monotonic() + PATIENCE
    while status.health.get("peers./mixed") != "2" and time.monotonic() < give_up:
        publish_for(0.1)
    first_recorded = count
    publish_for(1.0, best_effort)
    peer.deliver(reliable)
    assert end(recorder) == 0

    recorded = numbers(bag, "/mixed")
    assert sorted(n for n in recorded if n >= 0) == list(range(count))
    assert sorted(-n for n in recorded if n < 0) == list(range(first_recorded, count))
    assert numbers(bag, "/latched") == [5]
    with AnyReader([bag]) as reader:
        ((latched_qos,),) = [
            connection.ext.offered_qos_profiles  # type: ignore[union-attr]
            for connection in reader.connections
            if connection.topic == "/latched"
        ]
    assert latched_qos.durability == QosDurability.TRANSIENT_LOCAL
    assert latched_qos.reliability == QosReliability.RELIABLE


def test_a_restarted_publisher_loses_no_message_after_its_match(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    """Each start is that of another process: a participant with endpoints of its own."""
    bag = tmp_path / "bag"
    recorder = start("recorder", "-p", f"directory:={bag}", "-p", "topics:=[/words, /numbers]")
    status = managed("recorder")
    assert status.reports("active", "no publisher yet")

    def matched(count: str) -> bool:
        return bool(peer.wait(lambda: status.health.get("peers./numbers", "0") == count))

    for first in (0, 50, 100):
        context = rclpy.Context()
        rclpy.init(context=context)
        node = rclpy.create_node("source", context=context)
        publisher = node.create_publisher(Int32, "/numbers", RELIABLE)
        assert matched("1")
        assert peer.wait(publisher.get_subscription_count)
        for number in range(first, first + 50):
            publisher.publish(Int32(data=number))
        peer.deliver(publisher)
        node.destroy_node()
        rclpy.shutdown(context=context)
        assert matched("0")
    assert end(recorder) == 0
    assert numbers(bag, "/numbers") == list(range(150))


def test_records_every_acknowledged_message_when_it_is_stopped(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    """The middleware acknowledges what the recorder has not taken yet."""
    bag, status = tmp_path / "bag", managed("recorder")
    publisher = peer.node.create_publisher(String, "/words", RELIABLE)
    recorder = start("recorder", "-p", f"directory:={bag}", "-p", "topics:=[/words]")
    assert peer.wait(lambda: status.health.get("peers./words") == "1")
    assert peer.wait(publisher.get_subscription_count)  # either may know the other first
    for count in range(100):
        publisher.publish(String(data=f"{count} " + 20_000 * "x"))
    assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    recorder.send_signal(signal.SIGTERM)
    assert recorder.wait(PATIENCE) == 0
    with AnyReader([bag]) as reader:
        kept = [
            int(reader.deserialize(data, connection.msgtype).data.split()[0])
            for connection, _, data in reader.messages()
        ]
    assert kept == list(range(100))


def test_an_interrupt_ends_a_recorder_that_a_shell_started_in_the_background(
    start: Start, managed: Any, tmp_path: Path
) -> None:
    """Such a process inherits that SIGINT is ignored."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        recorder = start("recorder", "-p", f"directory:={tmp_path / 'bag'}")
    finally:
        signal.signal(signal.SIGINT, before)
    assert managed("recorder").reports("active")
    assert end(recorder) == 0


def test_reports_messages_lost_while_starved(start: Start, peer: Any, tmp_path: Path) -> None:
    """Stopped for longer than buffers last it loses messages, and knows how many."""
    bag, health = tmp_path / "bag", {"lost": 0}

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/recorder":
                health.update((v.key, int(v.value)) for v in status.values if v.key == "lost")

    peer.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    publisher = peer.node.create_publisher(String, "/words", QoSProfile(depth=10))
    recorder = start("recorder", "-p", f"directory:={bag}", "-p", "topics:=[/words]")
    assert peer.wait(publisher.get_subscription_count)
    peer.spin(0.3)
    for count in range(1150):
        if count == 50:
            recorder.send_signal(signal.SIGSTOP)
        if count == 1100:
            recorder.send_signal(signal.SIGCONT)
        publisher.publish(String(data=f"{count} " + 10_000 * "x"))
        time.sleep(0.0005 if 50 <= count < 1100 else 0.01)
    assert peer.wait(lambda: health["lost"] > 0)
    peer.deliver(publisher)
    assert end(recorder) == 0
    with AnyReader([bag]) as reader:
        kept = [
            int(reader.deserialize(data, connection.msgtype).data.split()[0])
            for connection, _, data in reader.messages()
        ]
    assert kept[-1] == 1149
    log = (tmp_path / "recorder.log").read_text()
    lost = sum(int(count) for count in re.findall(r"(\d+) messages were lost", log))
    assert lost == kept[-1] + 1 - kept[0] - len(kept)


def test_unrecordable_topic_does_not_stop_the_rest(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    """Two types on one topic, of which one comes first; and a topic as it should be."""
    bag = tmp_path / "bag"
    quarrel = peer.node.create_publisher(Int32, "/quarrel", RELIABLE)
    good = peer.node.create_publisher(Int32, "/good", RELIABLE)
    start("simulator", "-r", "odom:=/quarrel")
    assert peer.wait(lambda: "simulator" in peer.node.get_node_names())
    recorder = start("recorder", "-p", f"directory:={bag}", "-p", "topics:=[/quarrel, /good]")
    log = tmp_path / "recorder.log"
    assert peer.wait(lambda: "cannot record /quarrel of type" in log.read_text())
    assert peer.wait(good.get_subscription_count)
    quarrel.publish(Int32(data=0))
    good.publish(Int32(data=1))
    peer.deliver(good)
    assert end(recorder) == 0
    assert numbers(bag, "/good") == [1]
    assert log.read_text().count("cannot record") == 1
    assert "Traceback" not in log.read_text()


def test_a_full_disk_ends_only_the_recording(start: Start, peer: Any, tmp_path: Path) -> None:
    """A limit on the size of its files stands in for the disk: writing fails all the same."""
    bag = tmp_path / "bag"
    publisher = peer.node.create_publisher(Header, "/headers", RELIABLE)
    recorder = start(
        "recorder",
        *("-p", f"directory:={bag}", "-p", "topics:=[/headers]", "-p", "compression:=none"),
    )
    assert peer.wait(publisher.get_subscription_count)
    peer.spin(0.5)
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (60_000, 60_000))
    sent = 0
    while recorder.poll() is None and sent < 3000:
        publisher.publish(Header(frame_id=f"{sent:0200}"))
        sent += 1
        peer.spin(0.005)
    assert recorder.wait(PATIENCE) == 1
    log = (tmp_path / "recorder.log").read_text()
    assert "recording ended" in log
    assert "bag_0.mcap: cannot write: File too large" in log
    assert "Traceback" not in log

    repair(bag)

    with AnyReader([bag]) as reader:
        frames = [
            int(reader.deserialize(data, connection.msgtype).frame_id)
            for connection, _, data in reader.messages()
        ]
    assert len(frames) > 100
    assert frames == list(range(len(frames)))


@pytest.mark.slow
def test_the_flight_continues_when_the_disk_is_full(tmp_path: Path) -> None:
    run = tmp_path / "run"
    command = [sys.executable, "-P", "-m", "quad_mpc_ros.cli", "fly", "--config", "paper"]
    command += ["--set", "recorder.compression=none", "--duration", "5", "--out", str(run)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as flight:
        deadline = time.monotonic() + 30.0
        file = run / "bag" / "bag_0.mcap"
        while not file.exists() or file.stat().st_size < 100_000:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        pid = node_of(flight.pid, "recorder_node")
        assert pid is not None
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (200_000, 200_000))
        _, error = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "recorder ended by itself (exit code 1)" in error
    assert "cannot write: File too large" in error
    assert "the flight continues" in error
    assert "Traceback" not in error
    flown = [float(line.split()[0]) for line in error.splitlines() if " s of 5 s " in line]
    assert flown[-1] > 4.0
    assert (run / "summary.json").exists()


def test_recorders_started_in_the_same_second_use_separate_bags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    begin = threading.Barrier(4)

    def record() -> Path:
        begin.wait()
        with new_bag(RecorderConfig()) as bag:
            return bag.directory

    with ThreadPoolExecutor(4) as threads:
        directories = [future.result() for future in [threads.submit(record) for _ in range(4)]]
    assert len(set(directories)) == 4
    assert all((directory / "metadata.yaml").is_file() for directory in directories)


def test_does_not_warn_of_missing_optional_topics(peer: Any, tmp_path: Path) -> None:
    config = RecorderConfig.build({"directory": str(tmp_path / "bag")})
    missed = Recorder(peer.node, config, on_fault=lambda _: None).missing
    assert "/odom" in missed
    assert "/reference" in missed
    assert not {"/odom_reset", "/cmd_vel", "/engaged", "/landed", "/battery", "/clock"} & {*missed}
