"""The recorder as a process, with publishers of the test."""

from __future__ import annotations

import random
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
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.processes import PATIENCE, node_of
from fixtures.scripts import script_module
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from std_msgs.msg import Header, Int32, String

from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.recordings.reader import BagReader
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


def test_records_all_topics_but_the_excluded_ones(start: Start, peer: Any, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    publishers = {
        topic: peer.node.create_publisher(Int32, topic, RELIABLE)
        for topic in ("/uav1/numbers", "/secret/numbers", "/_hidden")
    }
    recorder = start(
        "recorder",
        *("-p", f"directory:={bag}", "-p", "all:=true"),
        *("-p", "topics_exclude_regex:=secret|rosout"),
    )
    assert peer.wait(publishers["/uav1/numbers"].get_subscription_count)
    late = peer.node.create_publisher(String, "/late", RELIABLE)
    assert peer.wait(late.get_subscription_count)
    for publisher in publishers.values():
        publisher.publish(Int32(data=7))
    late.publish(String(data="of another type"))
    peer.deliver(publishers["/uav1/numbers"], late)
    assert end(recorder, signal.SIGTERM) == 0
    topics = BagReader(bag).topics
    assert {"/uav1/numbers", "/late", "/diagnostics"} <= set(topics)
    assert not {"/secret/numbers", "/_hidden", "/rosout"} & set(topics)
    assert numbers(bag, "/uav1/numbers") == [7]
    assert topics["/late"].type_name == "std_msgs/msg/String"


def test_records_topics_by_name_and_by_regex(start: Start, peer: Any, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    publishers = {
        topic: peer.node.create_publisher(Int32, topic, RELIABLE)
        for topic in ("/named", "/uav1/a", "/uav1/b", "/other")
    }
    recorder = start(
        "recorder",
        *("-p", f"directory:={bag}", "-p", "topics:=[named]", "-p", "topics_regex:=^/uav1/"),
    )
    wanted = [publishers[topic] for topic in ("/named", "/uav1/a", "/uav1/b")]
    assert peer.wait(lambda: all(publisher.get_subscription_count() for publisher in wanted))
    log = tmp_path / "recorder.log"  # before it says so it has not started, which ends with 130
    assert peer.wait(lambda: "active" in log.read_text().split())
    assert end(recorder) == 0
    assert set(BagReader(bag).topics) == {"/named", "/uav1/a", "/uav1/b"}


@pytest.mark.parametrize("apart", [0.0, 0.002, 0.01, 0.03])
def test_further_signals_while_it_ends_leave_a_whole_bag(
    start: Start, peer: Any, tmp_path: Path, apart: float
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
            time.sleep(apart)
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


@pytest.mark.slow
def test_a_split_recording_is_one_bag(start: Start, peer: Any, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    publisher = peer.node.create_publisher(Int32, "/numbers", RELIABLE)
    recorder = start(
        "recorder",
        *("-p", f"directory:={bag}", "-p", "topics:=[/numbers]", "-p", "max_bag_duration:=0.5"),
    )
    assert peer.wait(publisher.get_subscription_count)
    peer.spin(0.3)
    for number in range(150):
        publisher.publish(Int32(data=number))
        peer.spin(0.01)
    peer.deliver(publisher)
    assert end(recorder) == 0
    assert numbers(bag, "/numbers") == list(range(150))
    assert len(list(bag.glob("bag_*.mcap"))) >= 3


def test_a_full_disk_ends_the_recording_and_nothing_else(
    start: Start, peer: Any, tmp_path: Path
) -> None:
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
def test_the_flight_goes_on_when_the_disk_is_full(tmp_path: Path) -> None:
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


@pytest.mark.slow
def test_nothing_is_lost_and_memory_is_flat(tmp_path: Path) -> None:
    """Ten seconds of a flight's traffic; ``bench/record.py --duration 600`` is the long one."""
    recording = script_module("bench/record.py").record(tmp_path / "bag", duration=10.0, rate=50.0)
    assert recording.complete
    memory = recording.load.memory_mib
    assert memory[-1] - memory[len(memory) // 2] < 2.0


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_killed_at_any_moment_at_most_the_last_second_is_lost(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    """Counted from when the recorder reports its publishers, after discovery."""
    moments = random.Random(2)
    received: list[int] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/recorder":
                received.extend(int(v.value) for v in status.values if v.key == "messages")

    peer.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    for attempt in range(20):
        # A topic each: a killed subscription is missed only after its lease of 20 s.
        bag, topic = tmp_path / f"bag{attempt}", f"/numbers{attempt}"
        publisher = peer.node.create_publisher(Int32, topic, RELIABLE)
        recorder = start("recorder", "-p", f"directory:={bag}", "-p", f"topics:=[{topic}]")
        received.clear()
        sent: list[float] = []
        deadline = time.monotonic() + 30.0
        until = None
        while until is None or time.monotonic() < until:
            publisher.publish(Int32(data=len(sent)))
            sent.append(time.monotonic())
            peer.spin(0.01)
            if until is None and any(received):
                until = time.monotonic() + moments.uniform(1.0, 3.0)
            assert time.monotonic() < deadline
        recorder.kill()
        recorder.wait()
        killed = time.monotonic()

        repair(bag)

        kept = numbers(bag, topic)
        assert kept, "a second before it was killed the recorder had some"
        assert kept == list(range(kept[0], kept[-1] + 1))
        assert all(killed - moment < 1.0 for moment in sent[kept[-1] + 1 :])
        peer.node.destroy_publisher(publisher)
        peer.spin(0.2)


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
