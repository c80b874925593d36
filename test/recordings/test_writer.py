# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Written bags as other people's readers see them, and what happens when writing fails."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from fixtures.messages import RECORDED_TYPES, empty
from mcap.reader import make_reader
from mcap.records import Message
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosHistory, QosReliability

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.schemas import schema_for
from quad_mpc_ros.recordings.qos import offered_qos
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.repair import WholeRecords, repair
from quad_mpc_ros.recordings.writer import FLUSH_PERIOD_S, BagWriter

WriteFlight = Callable[[BagWriter, int], None]
CLOCK = "rosgraph_msgs/msg/Clock"
START_NS = 1_700_000_000_000_000_000


def clock_data(seconds: int = 0) -> bytes:
    return b"\x00\x01\x00\x00" + seconds.to_bytes(4, "little") + bytes(4)


def test_rosbags_reads_what_was_written(flight_bag: Path) -> None:
    with AnyReader([flight_bag]) as reader:
        odometry, command = sorted(reader.connections, key=lambda c: c.topic, reverse=True)
        assert (odometry.topic, odometry.msgtype, odometry.msgcount) == (
            "/odom",
            "nav_msgs/msg/Odometry",
            10,
        )
        assert (command.topic, command.msgcount) == ("/command", 5)
        assert odometry.digest == schema_for("nav_msgs/msg/Odometry").type_hash
        (qos,) = odometry.ext.offered_qos_profiles  # type: ignore[union-attr]
        assert (qos.reliability, qos.depth) == (QosReliability.BEST_EFFORT, 1)
        assert reader.message_count == 15
        assert reader.start_time == START_NS + 1000
        messages = list(reader.messages())
        times = [time for _, time, _ in messages]
        assert times == sorted(times)
        positions = [
            reader.deserialize(data, connection.msgtype).pose.pose.position.x  # type: ignore
            for connection, _, data in messages
            if connection.topic == "/odom"
        ]
        assert positions == [float(index) for index in range(10)]


def test_mcaps_own_decoder_reads_what_was_written(flight_bag: Path) -> None:
    with (flight_bag / "flight_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        header = reader.get_header()
        assert header.profile == "ros2"
        assert header.library.startswith("quad_mpc_ros ")
        decoded = [
            (channel.topic, message.log_time, message.publish_time, content)
            for _, channel, message, content in reader.iter_decoded_messages()
        ]
    odometry = [entry for entry in decoded if entry[0] == "/odom"]
    commands = [entry for entry in decoded if entry[0] == "/command"]
    for index, (_, log_time, publish_time, content) in enumerate(odometry):
        stamp = START_NS + index * 20_000_000
        assert (log_time, publish_time) == (stamp + 1000, stamp)
        assert content.header.stamp.sec * 10**9 + content.header.stamp.nanosec == stamp
        assert content.header.frame_id == "odom"
        assert content.pose.pose.orientation.w == 1.0
    throttles = [content.twist.linear.z for *_, content in commands]
    assert throttles == pytest.approx([0.0, 0.002, 0.004, 0.006, 0.008])


# The keys of a metadata.yaml recorded by `ros2 bag record` of Jazzy.
METADATA = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration:
    nanoseconds: 5
  starting_time:
    nanoseconds_since_epoch: 1700000000000000000
  message_count: 2
  topics_with_message_count:
    - topic_metadata:
        name: /clock
        type: rosgraph_msgs/msg/Clock
        serialization_format: cdr
        offered_qos_profiles:
          - history: unknown
            depth: 0
            reliability: reliable
            durability: volatile
            deadline:
              sec: 9223372036
              nsec: 854775807
            lifespan:
              sec: 9223372036
              nsec: 854775807
            liveliness: automatic
            liveliness_lease_duration:
              sec: 9223372036
              nsec: 854775807
            avoid_ros_namespace_conventions: false
        type_description_hash: \
RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564
      message_count: 2
    - topic_metadata:
        name: /quiet
        type: rosgraph_msgs/msg/Clock
        serialization_format: cdr
        offered_qos_profiles: []
        type_description_hash: \
RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564
      message_count: 0
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - run_0.mcap
  files:
    - path: run_0.mcap
      starting_time:
        nanoseconds_since_epoch: 1700000000000000000
      duration:
        nanoseconds: 5
      message_count: 2
  custom_data: ~
  ros_distro: jazzy"""


def write_clock_bag(directory: Path) -> None:
    discovered = offered_qos(depth=0)._replace(history=QosHistory.UNKNOWN)
    with BagWriter(directory) as writer:
        writer.add_topic("/clock", CLOCK, qos_profiles=[discovered])
        writer.add_topic("/quiet", CLOCK)
        for log_time_ns in (START_NS + 5, START_NS):
            writer.write(
                "/clock", clock_data(), log_time_ns=log_time_ns, publish_time_ns=log_time_ns
            )


def test_metadata_yaml_is_that_of_rosbag2(tmp_path: Path) -> None:
    write_clock_bag(tmp_path / "run")
    written = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())
    assert written == yaml.safe_load(METADATA)
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        "metadata.yaml",
        "run_0.mcap",
    ]


def test_the_mcap_file_has_the_version_of_the_metadata(tmp_path: Path) -> None:
    """rosbag2 needs it to read the quality of service; it counts messages by the index."""
    write_clock_bag(tmp_path / "run")
    record = BagReader(tmp_path / "run" / "run_0.mcap").metadata["rosbag2"]
    information = yaml.safe_load(record["serialized_metadata"])
    assert information.keys() == yaml.safe_load(METADATA)["rosbag2_bagfile_information"].keys()
    assert information["version"] == 9


def test_writes_a_bag_without_messages(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "empty") as writer:
        writer.add_topic("/clock", CLOCK)
    with AnyReader([tmp_path / "empty"]) as reader:
        assert reader.message_count == 0
        assert list(reader.messages()) == []
    assert BagReader(tmp_path / "empty").span is None


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_compressions(tmp_path: Path, compression: str, write_flight: WriteFlight) -> None:
    directory = tmp_path / compression
    with BagWriter(directory, compression=compression) as writer:  # type: ignore[arg-type]
        write_flight(writer, 20)
    with (directory / f"{compression}_0.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        used = {chunk.compression for chunk in summary.chunk_indexes}
        assert used == {"" if compression == "none" else compression}
    with AnyReader([directory]) as reader:
        assert reader.message_count == 30
        assert len(list(reader.messages())) == 30


def test_writes_every_recorded_type_into_an_unusual_directory(
    tmp_path: Path,
) -> None:
    directory = tmp_path / "deep" / "er" / "ü: #1 'x'"
    with BagWriter(directory) as writer:
        for type_name in RECORDED_TYPES:
            topic = "/" + type_name.rpartition("/")[2]
            writer.add_topic(topic, type_name)
            writer.write(topic, empty(type_name), log_time_ns=1, publish_time_ns=0)
    with AnyReader([directory]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
        assert reader.message_count == len(RECORDED_TYPES)


@pytest.mark.parametrize("is_directory", [True, False])
def test_refuses_a_path_that_exists(tmp_path: Path, is_directory: bool) -> None:
    path = tmp_path / "flight"
    note = path / "note" if is_directory else path
    note.parent.mkdir(exist_ok=True)
    note.write_text("mine")
    with pytest.raises(BagError, match="exists already"):
        BagWriter(path)
    assert note.read_text() == "mine"
    assert [each for each in tmp_path.rglob("*") if each.is_file()] == [note]


@pytest.mark.parametrize("parent", ["file", "/proc/none", "n" * 300])
def test_refuses_an_unwritable_place(tmp_path: Path, parent: str) -> None:
    (tmp_path / "file").write_text("")
    directory = tmp_path / parent / "flight"
    with pytest.raises(BagError, match="cannot be created") as caught:
        BagWriter(directory)
    assert "\n" not in str(caught.value)
    assert str(directory) in str(caught.value)


def test_refuses_misuse(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "flight")
    writer.add_topic("/clock", CLOCK)
    with pytest.raises(BagError, match="no_msgs/msg/None"):
        writer.add_topic("/none", "no_msgs/msg/None")
    with pytest.raises(BagError, match="/other was not added"):
        writer.write("/other", b"", log_time_ns=0, publish_time_ns=0)
    for time_ns in (-1, 2**63):
        with pytest.raises(BagError, match="outside"):
            writer.write("/clock", b"", log_time_ns=time_ns, publish_time_ns=0)
    writer.write("/clock", clock_data(), log_time_ns=0, publish_time_ns=0)
    writer.close()
    content = (tmp_path / "flight" / "flight_0.mcap").read_bytes()
    writer.close()
    assert (tmp_path / "flight" / "flight_0.mcap").read_bytes() == content
    with pytest.raises(BagError, match="the bag is closed"):
        writer.write("/clock", clock_data(), log_time_ns=0, publish_time_ns=0)
    assert BagReader(tmp_path / "flight").topics["/clock"].message_count == 1


def test_exception_leaves_a_complete_bag(tmp_path: Path, write_flight: WriteFlight) -> None:
    with (
        pytest.raises(ZeroDivisionError),
        BagWriter(tmp_path / "flight") as writer,
    ):
        write_flight(writer, 4)
        raise ZeroDivisionError
    with AnyReader([tmp_path / "flight"]) as reader:
        assert reader.message_count == 6


def test_flushes_when_due_even_in_slow_traffic(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "slow") as writer:
        file = tmp_path / "slow" / "slow_0.mcap"

        def recorded() -> int:
            with file.open("rb") as stream:
                return sum(isinstance(record, Message) for record in WholeRecords(stream))

        writer.add_topic("/clock", CLOCK)
        writer.flush_if_due(100.0)
        assert recorded() == 0
        writer.write("/clock", clock_data(), log_time_ns=1, publish_time_ns=1)
        writer.flush_if_due(100.25)
        assert recorded() == 1
        writer.write("/clock", clock_data(), log_time_ns=2, publish_time_ns=2)
        writer.flush_if_due(100.25 + 0.9 * FLUSH_PERIOD_S)
        assert recorded() == 1
        writer.flush_if_due(100.25 + FLUSH_PERIOD_S)
        assert recorded() == 2
        size = file.stat().st_size
        writer.flush_if_due(200.0)
        assert file.stat().st_size == size
        assert not (tmp_path / "slow" / "metadata.yaml").exists()


KILLED_RECORDER = """
import sys, time
from pathlib import Path
from quad_mpc_ros.recordings.writer import BagWriter
writer = BagWriter(Path(sys.argv[1]))
writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
writer.write_metadata("parameters", {"mpc": "control_rate: 50.0"})
data = b"\\0\\1\\0\\0" + bytes(8)
for index in range(500):
    writer.write("/clock", data, log_time_ns=index, publish_time_ns=index)
writer.flush_if_due(time.monotonic())
for index in range(500, 700):
    writer.write("/clock", data, log_time_ns=index, publish_time_ns=index)
print("flushed", flush=True)
time.sleep(60)
"""


def test_what_was_flushed_survives_sigkill(tmp_path: Path) -> None:
    directory = tmp_path / "killed"
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED_RECORDER, str(directory)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"flushed\n"
        process.send_signal(signal.SIGKILL)
    assert not (directory / "metadata.yaml").exists()
    repair(directory)
    reader = BagReader(directory)
    assert [message.log_time_ns for message in reader.messages()] == list(range(500))
    assert reader.topics["/clock"].message_count == 500
    assert reader.metadata["parameters"] == {"mpc": "control_rate: 50.0"}
    assert yaml.safe_load(reader.metadata["rosbag2"]["serialized_metadata"])["version"] == 9


def test_full_disk_closes_the_bag_with_an_error(tmp_path: Path, write_flight: WriteFlight) -> None:
    directory = tmp_path / "full"
    writer = BagWriter(directory, compression="none")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    write_flight(writer, 20)
    writer.flush_if_due(0.0)
    written = (directory / "full_0.mcap").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (written + 50, limits[1]))
    try:
        with pytest.raises(BagError, match="cannot write") as caught:
            for index in range(10**5):
                writer.write("/odom", bytes(1000), log_time_ns=index, publish_time_ns=0)
        assert "full_0.mcap" in str(caught.value)
        assert "\n" not in str(caught.value)
        with pytest.raises(BagError, match="closed after a disk error"):
            writer.write("/odom", b"", log_time_ns=0, publish_time_ns=0)
        writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not (directory / "metadata.yaml").exists()
    repair(directory)
    assert len(list(BagReader(directory).messages())) == 30
