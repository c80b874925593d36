# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading bags of other writers, of interrupted recordings, and of broken files."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fixtures.messages import empty
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.schemas import schema_for
from quad_mpc_ros.recordings.mcap_file import TimeSpan, TopicInfo
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.recordings.repair import repair
from quad_mpc_ros.recordings.writer import BagWriter

WriteFlight = Callable[[BagWriter, int], None]
CLOCK = "rosgraph_msgs/msg/Clock"
START_NS = 1_700_000_000_000_000_000


def test_reads_topics_messages_and_metadata(flight_bag: Path) -> None:
    reader = BagReader(flight_bag)
    odometry = reader.topics["/odom"]
    assert odometry.type_name == "nav_msgs/msg/Odometry"
    assert odometry.message_count == 10
    assert "reliability: best_effort" in odometry.qos_profiles
    assert odometry.type_hash == schema_for("nav_msgs/msg/Odometry").type_hash
    assert reader.span is not None and reader.span.duration_ns == 9 * 20_000_000
    assert reader.metadata["parameters"] == {"mpc": "control_rate: 50.0"}
    messages = list(reader.messages())
    assert [m.log_time_ns for m in messages] == sorted(m.log_time_ns for m in messages)
    assert len(messages) == 15
    commands = list(reader.messages(["/command"]))
    assert [m.message.twist.linear.z for m in commands] == [0.001 * i for i in (0, 2, 4, 6, 8)]
    assert commands[1].publish_time_ns == START_NS + 2 * 20_000_000 + 1500
    assert commands[0].message is commands[0].message
    assert list(reader.messages(["/none"])) == []


def test_reads_a_single_file(flight_bag: Path) -> None:
    reader = BagReader(flight_bag / "flight_0.mcap")
    assert reader.topics == BagReader(flight_bag).topics


def test_the_last_metadata_of_a_name_wins(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write_metadata("parameters", {"mpc": "old", "gone": "x"})
        writer.write_metadata("parameters", {"mpc": "new"})
    assert BagReader(tmp_path / "bag").metadata["parameters"] == {"mpc": "new"}


@pytest.mark.parametrize("version", [8, 9])
def test_reads_a_bag_of_another_writer(tmp_path: Path, version: int) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(
        tmp_path / "theirs",
        version=version,  # type: ignore[arg-type]
        storage_plugin=StoragePlugin.MCAP,
    ) as writer:
        connection = writer.add_connection("/clock", CLOCK, typestore=store)
        time_class, clock_class = store.types["builtin_interfaces/msg/Time"], store.types[CLOCK]
        for second in (3, 1, 2):
            message = clock_class(clock=time_class(sec=second, nanosec=0))
            writer.write(connection, second * 10**9, store.serialize_cdr(message, CLOCK))
    reader = BagReader(tmp_path / "theirs")
    assert reader.topics["/clock"].message_count == 3
    assert [m.message.clock.sec for m in reader.messages()] == [1, 2, 3]
    assert reader.span == TimeSpan(start_ns=10**9, end_ns=3 * 10**9)


def write_mcap(
    path: Path,
    times: list[int],
    *,
    type_name: str = CLOCK,
    text: str | None = None,
    data: bytes | None = None,
) -> None:
    """Write messages with the plain MCAP library, as some other recorder might."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        text = schema_for(type_name).text if text is None else text
        schema = writer.register_schema(type_name, "ros2msg", text.encode())
        channel = writer.register_channel("/topic", "cdr", schema)
        for time in times:
            clock = b"\x00\x01\x00\x00" + time.to_bytes(4, "little") + bytes(4)
            writer.add_message(channel, time, clock if data is None else data, time)
        writer.finish()


def test_reads_a_split_bag_as_one(tmp_path: Path) -> None:
    """Files overlap in time; a repair lists them by number, not by name."""
    write_mcap(tmp_path / "run_10.mcap", [2, 4], data=b"ten")
    write_mcap(tmp_path / "run_2.mcap", [1, 4, 9], data=b"two")
    write_mcap(tmp_path / "run_0.mcap", [3], data=b"zero")
    repair(tmp_path)
    reader = BagReader(tmp_path)
    assert [(m.log_time_ns, m.data) for m in reader.messages()] == [
        (1, b"two"),
        (2, b"ten"),
        (3, b"zero"),
        (4, b"two"),
        (4, b"ten"),
        (9, b"two"),
    ]
    assert reader.topics["/topic"] == TopicInfo(
        type_name=CLOCK, encoding="cdr", message_count=6, qos_profiles="", type_hash=""
    )
    assert reader.span == TimeSpan(start_ns=1, end_ns=9)
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  storage_identifier: mcap\n  compression_mode: ''\n"
        "  relative_file_paths: [run_0.mcap, run_2.mcap]\n"
    )
    assert [m.log_time_ns for m in BagReader(tmp_path).messages()] == [1, 3, 4, 9]


def test_decodes_by_the_definition_in_the_bag(
    tmp_path: Path,
) -> None:
    text = f"lab_msgs/Gain gain\n\n{'=' * 80}\nMSG: lab_msgs/Gain\nuint8 k\nstring name\n"
    data = b"\x00\x01\x00\x00" + b"\x07\x00\x00\x00" + b"\x02\x00\x00\x00p\x00"
    write_mcap(tmp_path / "lab.mcap", [1, 2], type_name="lab_msgs/msg/Gains", text=text, data=data)
    read = [m.message.gain for m in BagReader(tmp_path / "lab.mcap").messages()]
    assert [(gain.k, gain.name) for gain in read] == [(7, "p")] * 2


@pytest.mark.parametrize(
    ("type_name", "text", "data", "reason"),
    [
        (CLOCK, None, b"\x00\x01\x00\x00", "cannot decode"),
        (CLOCK, None, b"", "cannot decode"),
        (CLOCK, "uint8 other\n", None, "schema of rosgraph_msgs/msg/Clock"),
        ("lab_msgs/msg/Gains", "no such[ syntax", None, "schema of lab_msgs/msg/Gains"),
        (
            "lab_msgs/msg/Gains",
            "lab_msgs/Missing m\n",
            None,
            "cannot decode a lab_msgs/msg/Gains: .*lab_msgs/msg/Missing",
        ),
    ],
)
def test_undecodable_message_keeps_its_bytes(
    tmp_path: Path, type_name: str, text: str | None, data: bytes | None, reason: str
) -> None:
    write_mcap(tmp_path / "odd.mcap", [1, 2], type_name=type_name, text=text, data=data)
    for message in BagReader(tmp_path / "odd.mcap").messages():
        assert data is None or message.data == data
        with pytest.raises(BagError, match=reason) as caught:
            _ = message.message
        assert "\n" not in str(caught.value)


@pytest.fixture
def recorded(tmp_path: Path, write_flight: WriteFlight) -> bytes:
    """Return an MCAP file of 30 messages in two chunks."""
    with BagWriter(tmp_path / "whole", compression="zstd") as writer:
        write_flight(writer, 12)
        writer.flush_if_due(0.0)
        data = empty(CLOCK)
        writer.add_topic("/clock", CLOCK)
        for index in range(12):
            writer.write("/clock", data, log_time_ns=START_NS - index, publish_time_ns=0)
    return (tmp_path / "whole" / "whole_0.mcap").read_bytes()


def test_refuses_an_unfinished_bag_and_names_the_repair(flight_bag: Path) -> None:
    file, metadata = flight_bag / "flight_0.mcap", flight_bag / "metadata.yaml"
    file.write_bytes(file.read_bytes()[:-30])
    for path in (flight_bag, file):
        with pytest.raises(BagError, match=f"unfinished.*: quad_mpc bag repair {flight_bag}$"):
            BagReader(path)
    metadata.unlink()
    for path in (flight_bag, file):
        with pytest.raises(BagError, match=f"unfinished.*: quad_mpc bag repair {path}$"):
            BagReader(path)
    repair(flight_bag)
    assert len(list(BagReader(flight_bag).messages())) == 15


def test_damage_is_detected_or_harmless(tmp_path: Path, recorded: bytes) -> None:
    """A flipped byte never leads to a foreign exception, nor to altered messages."""
    (tmp_path / "bad.mcap").write_bytes(recorded)
    whole = {(m.log_time_ns, m.data) for m in BagReader(tmp_path / "bad.mcap").messages()}
    refused = 0
    for index in range(0, len(recorded), 29):
        damaged = bytearray(recorded)
        damaged[index] ^= 0x41
        (tmp_path / "bad.mcap").write_bytes(damaged)
        try:
            reader = BagReader(tmp_path / "bad.mcap")
            read = {(m.log_time_ns, m.data) for m in reader.messages()}
        except BagError as error:
            refused += 1
            assert str(tmp_path / "bad.mcap") in str(error)
            assert "\n" not in str(error)
        else:
            assert read <= whole
    assert refused > 10


LISTED = {"storage_identifier": "mcap", "relative_file_paths": ["x_0.mcap"]}


def metadata_yaml(**information: object) -> dict[str, bytes]:
    return {"metadata.yaml": json.dumps({"rosbag2_bagfile_information": information}).encode()}


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ({}, "not a bag: neither metadata.yaml nor an .mcap file"),
        ({"x_0.mcap": b"", **metadata_yaml(**LISTED)}, "x_0.mcap: is empty"),
        (
            {"x_0.mcap": b"not an MCAP file", **metadata_yaml(**LISTED)},
            "x_0.mcap: is not an MCAP file",
        ),
        (metadata_yaml(storage_identifier="mcap"), "relative_file_paths is empty"),
        (
            metadata_yaml(storage_identifier="mcap", relative_file_paths=["y.mcap"]),
            "metadata.yaml: lists y.mcap, which does not exist",
        ),
        (
            metadata_yaml(storage_identifier="sqlite3", relative_file_paths=["y.db3"]),
            "storage is 'sqlite3', expected MCAP; convert it: rosbags-convert --src",
        ),
        ({"metadata.yaml": b"- 1"}, "rosbag2_bagfile_information is missing"),
        ({"metadata.yaml": b"a: [\n\tb"}, "metadata.yaml: not YAML"),
        ({"metadata.yaml": b"\xff\xfe\x00\xd8"}, "metadata.yaml: not UTF-8"),
    ],
)
def test_refuses_files_that_are_no_bag_in_one_line(
    tmp_path: Path, files: dict[str, bytes], reason: str
) -> None:
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BagError, match=reason) as caught:
        BagReader(tmp_path)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("x_0.db3", b"SQLite format 3\0", "holds a bag of another format, expected MCAP"),
        ("x.bag", b"#ROSBAG V2.0\n", "holds a bag of another format, expected MCAP"),
    ],
)
def test_names_other_formats_and_their_converter(
    tmp_path: Path, name: str, content: bytes, reason: str
) -> None:
    (tmp_path / name).write_bytes(content)
    command = f"convert it: rosbags-convert --src {tmp_path / name} --dst"
    for path, expected in ((tmp_path, reason), (tmp_path / name, "is a")):
        with pytest.raises(BagError) as caught:
            BagReader(path)
        assert expected in str(caught.value) and command in str(caught.value)


def write_clocks_with_rosbags(
    bag: Path, plugin: StoragePlugin, compression: CompressionMode = CompressionMode.NONE
) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = RosbagsWriter(bag, version=9, storage_plugin=plugin)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/clock", CLOCK, typestore=store)
        for second in range(100):
            data = b"\x00\x01\x00\x00" + second.to_bytes(4, "little") + bytes(4)
            writer.write(connection, second, data)


@pytest.mark.parametrize(
    ("plugin", "compression"),
    [
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    ],
)
def test_the_named_command_converts(
    tmp_path: Path, plugin: StoragePlugin, compression: CompressionMode
) -> None:
    bag = tmp_path / "bag"
    write_clocks_with_rosbags(bag, plugin, compression)
    if plugin == StoragePlugin.SQLITE3:
        (bag / "metadata.yaml").unlink()
    with pytest.raises(BagError) as caught:
        BagReader(bag)
    command = str(caught.value).partition("convert it: ")[2]
    assert command.startswith("rosbags-convert ")
    scripts = Path(sys.executable).parent
    subprocess.run([scripts / command.split()[0], *command.split()[1:]], check=True)
    converted = BagReader(Path(command.split()[4]))
    assert [m.message.clock.sec for m in converted.messages()] == list(range(100))


def test_refuses_compressed_messages_also_in_repair(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    write_clocks_with_rosbags(bag, StoragePlugin.MCAP, CompressionMode.MESSAGE)
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    for use in (repair, BagReader):
        for path in (bag, bag / "bag.mcap") if use is BagReader else (bag,):
            with pytest.raises(BagError, match=f"convert it: rosbags-convert --src {bag} "):
                use(path)
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_a_topic_of_another_encoding_is_named(tmp_path: Path) -> None:
    for encoding, expected in (("json", "as 'json', expected 'cdr'"), ("ros1", "rosbags-convert")):
        file = tmp_path / f"{encoding}.mcap"
        with file.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="")
            channel = writer.register_channel("/odom", encoding, 0)
            writer.add_message(channel, 1, b"{}", 1)
            writer.finish()
        with pytest.raises(BagError, match=expected):
            BagReader(file).require_cdr(["/odom"])
        with pytest.raises(BagError, match=expected):
            Recording(file).flight()
        with pytest.raises(BagError, match=expected):
            Recording(file).run()


def test_refuses_a_missing_bag(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="nowhere: does not exist"):
        BagReader(tmp_path / "nowhere")


def test_refuses_a_file_that_was_removed(flight_bag: Path) -> None:
    reader = BagReader(flight_bag)
    shutil.rmtree(flight_bag)
    with pytest.raises(BagError, match=r"flight_0.mcap: cannot be read"):
        list(reader.messages())
