# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The player as a process; a node of the test and the recorder receive its messages."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.processes import PATIENCE
from fixtures.scripts import script_module
from mcap.writer import Writer
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int32

from quad_mpc_ros.cli import main
from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.recordings.config import PlayerConfig
from quad_mpc_ros.recordings.qos import offered_qos
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.writer import BagWriter
from quad_mpc_ros.ros.nodes.player_node import played_topics

Start = Callable[..., "subprocess.Popen[bytes]"]
INT = "std_msgs/msg/Int32"
MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def int_data(number: int) -> bytes:
    return b"\x00\x01\x00\x00" + number.to_bytes(4, "little")


def write_numbers(bag: Path, count: int = 50) -> Path:
    """Write numbers every 20 ms on a best-effort topic, every tenth on a reliable one."""
    with BagWriter(bag) as writer:
        writer.add_topic("/latched", INT, qos_profiles=[offered_qos(latched=True)])
        writer.add_topic("/fast", INT, qos_profiles=[offered_qos(reliable=False)])
        writer.add_topic("/slow", INT, qos_profiles=[offered_qos()])
        writer.write("/latched", int_data(99), log_time_ns=START_NS, publish_time_ns=START_NS)
        for number in range(count):
            time_ns = START_NS + number * 20 * MS
            for topic in ("/fast", "/slow"):
                if topic == "/fast" or number % 10 == 0:
                    data = int_data(number)
                    writer.write(topic, data, log_time_ns=time_ns, publish_time_ns=time_ns)
    return bag


class Listener:
    """Subscribes to topics."""

    def __init__(self, peer: Any, *topics: str) -> None:
        self._peer = peer
        self.received: dict[str, list[int]] = {topic: [] for topic in topics}
        self._subscriptions = {
            topic: peer.node.create_subscription(Int32, topic, self._callback(topic), BEST_EFFORT)
            for topic in topics
        }

    def _callback(self, topic: str) -> Callable[[Int32], None]:
        return lambda message: self.received[topic].append(message.data)


def test_replayed_bag_records_the_same_messages(tmp_path: Path) -> None:
    bag = write_numbers(tmp_path / "bag", 150)
    result = script_module("bench/replay.py").replay_and_record(bag, tmp_path / "again")
    assert result.different == []
    assert np.median(result.interval_error) < 5e-3
    before, after = BagReader(bag).topics, BagReader(tmp_path / "again").topics
    for topic in ("/latched", "/fast", "/slow"):
        assert after[topic].type_hash == before[topic].type_hash
        for word in ("transient_local", "best_effort"):
            assert (word in after[topic].qos_profiles) == (word in before[topic].qos_profiles)


def test_clock_start_rate_topics_and_remap(start: Start, peer: Any, tmp_path: Path) -> None:
    bag = write_numbers(tmp_path / "bag", 100)
    listener = Listener(peer, "/fast", "/renamed", "/slow")
    clock: list[int] = []
    peer.node.create_subscription(
        Clock, "/clock", lambda m: clock.append(m.clock.sec * 10**9 + m.clock.nanosec), BEST_EFFORT
    )
    player = start(
        "player",
        *("-p", f"bag:={bag}", "-p", "start:=1.0", "-p", "rate:=0.5", "-p", "clock_rate:=100"),
        *("-p", "topics:=[/fast]", "-r", "/fast:=/renamed", "-p", "delay:=5.0"),
    )
    assert peer.wait(lambda: player.poll() is not None)
    assert player.returncode == 0
    assert listener.received == {"/fast": [], "/renamed": list(range(50, 100)), "/slow": []}
    assert clock[0] == START_NS + 10**9
    steps = np.diff([time_ns for time_ns in clock if time_ns > clock[0]])
    assert np.all(steps > 0)
    assert np.median(steps) == pytest.approx(5 * MS, rel=0.2)
    assert START_NS + 1.9e9 < clock[-1] <= START_NS + 1.98e9


def damage(bag: Path) -> None:
    """Flip bits in the compressed data of the chunk."""
    (file,) = bag.glob("*.mcap")
    content = bytearray(file.read_bytes())
    content[content.index(b"zstd") + 40] ^= 0x55
    file.write_bytes(content)


def foreign(
    bag: Path, *, type_name: str = INT, encoding: str = "cdr", type_hash: str = ""
) -> None:
    with (bag / "bag_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(type_name, "jsonschema", b"{}")
        metadata = {"topic_type_hash": type_hash}
        channel = writer.register_channel("/x", encoding, schema, metadata)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()


@pytest.mark.parametrize(
    ("channel", "reason"),
    [
        ({"type_name": "Pose", "encoding": "json"}, "expected 'cdr'"),
        (
            {"type_name": "px4_msgs/msg/VehicleOdometry"},
            "'px4_msgs/msg/VehicleOdometry' is not installed",
        ),
        ({"type_hash": "RIHS01_0"}, "has changed since it was recorded"),
    ],
)
def test_rejects_messages_of_other_types(
    channel: dict[str, str], reason: str, tmp_path: Path
) -> None:
    bag = write_numbers(tmp_path / "bag")
    foreign(bag, **channel)
    with pytest.raises(BagError, match=f"{bag}: .*{reason}"):
        played_topics(BagReader(bag), PlayerConfig(bag=str(bag)))


MISTAKES = {
    "corrupt bag": (["{corrupt}"], "is corrupt"),
    "no bag": (["nowhere"], "nowhere: does not exist"),
    "rate": (["{bag}", "--rate", "0"], "--rate: given 0.0, expected a number > 0"),
    "start": (
        ["{bag}", "--start", "60"],
        "player.start: given 60.0, expected at most the 0.980 s",
    ),
    "topic": (["{bag}", "--topics", "/none"], "no topic /none in the bag: /fast, /latched, /slow"),
    "nothing left": (
        ["{bag}", "--start", "0.5", "--topics", "/latched"],
        "no message after 0.5 s on these topics",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_exit_code_2(
    mistake: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments, reason = MISTAKES[mistake]
    bag, corrupt = write_numbers(tmp_path / "bag"), write_numbers(tmp_path / "corrupt")
    damage(corrupt)
    given = [argument.format(bag=bag, corrupt=corrupt) for argument in arguments]

    assert main(["replay", *given]) == 2

    error = capfd.readouterr().err
    assert reason in error
    assert mistake != "corrupt bag" or str(corrupt) in error
    assert len(error.strip().splitlines()) == 1


def test_ends_cleanly_while_playing(start: Start, peer: Any, tmp_path: Path) -> None:
    bag = write_numbers(tmp_path / "bag")
    player = start("player", "-p", f"bag:={bag}", "-p", "rate:=0.1", "-p", "delay:=0.0")
    listener = Listener(peer, "/fast")
    assert peer.wait(lambda: listener.received["/fast"])
    player.send_signal(signal.SIGINT)
    assert player.wait(PATIENCE) == 0
    assert "Traceback" not in (tmp_path / "player.log").read_text()
