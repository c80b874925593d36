# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Repair of cut and damaged bags, judged by other people's readers and by what was written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.highlevel import AnyReader

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.recordings.bag_metadata import write_metadata
from quad_mpc_ros.recordings.mcap_file import McapFile
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.repair import repair
from quad_mpc_ros.recordings.writer import BagWriter, Compression

WriteFlight = Callable[[BagWriter, int], None]
CLOCK = "rosgraph_msgs/msg/Clock"


def clock_data(number: int) -> bytes:
    return b"\x00\x01\x00\x00" + number.to_bytes(4, "little") + bytes(4)


def write_clocks(
    directory: Path, count: int, *, compression: Compression = "zstd", start: int = 0
) -> None:
    """Write numbered messages in chunks of ten; each carries its number as its time too."""
    with BagWriter(directory, compression=compression) as writer:
        writer.add_topic("/clock", CLOCK)
        for number in range(start, start + count):
            writer.write("/clock", clock_data(number), log_time_ns=number, publish_time_ns=number)
            if number % 10 == 9:
                writer.flush_if_due(float(number))


def write_split_clocks(directory: Path) -> None:
    """Write a bag of 60 messages in three files, as rosbag2 does with a maximum duration."""
    directory.mkdir()
    for index in range(3):
        part = directory.with_name(f"part{index}")
        write_clocks(part, 20, start=20 * index)
        (part / f"{part.name}_0.mcap").rename(directory / f"{directory.name}_{index}.mcap")
    write_metadata(directory, [McapFile(file) for file in sorted(directory.glob("*.mcap"))])


def cut(directory: Path, length: int) -> None:
    """Leave what a recorder leaves that is killed when so many bytes are written."""
    (directory / "metadata.yaml").unlink()
    file = directory / f"{directory.name}_0.mcap"
    file.write_bytes(file.read_bytes()[:length])


def numbers(directory: Path) -> list[int]:
    """Return the messages of a bag as rosbags reads them, which needs index and metadata."""
    with AnyReader([directory]) as reader:
        found = [
            reader.deserialize(data, connection.msgtype).clock.sec
            for connection, _, data in reader.messages()
        ]
        assert reader.message_count == len(found)
    return found


def names(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir())


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_keeps_every_whole_message_of_a_cut_file(tmp_path: Path, compression: Compression) -> None:
    write_clocks(tmp_path / "whole", 35, compression=compression)
    content = (tmp_path / "whole" / "whole_0.mcap").read_bytes()
    kept_before = 0
    kept_counts = set()
    for length in range(0, len(content), 131):
        bag = tmp_path / f"cut{length}"
        write_clocks(bag, 35, compression=compression)
        (bag / f"{bag.name}_0.mcap").write_bytes(content)
        cut(bag, length)

        repair(bag)

        kept = numbers(bag)
        assert kept == list(range(len(kept)))
        assert len(kept) >= kept_before, "a longer beginning holds less"
        kept_before = len(kept)
        kept_counts.add(len(kept))
        (mcap,) = bag.glob("*.mcap")
        with mcap.open("rb") as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(kept)
        assert (bag / f"{mcap.name}.broken").read_bytes() == content[:length]
    assert kept_counts == {0, 10, 20, 30, 35}


def test_leaves_a_complete_bag_unchanged(flight_bag: Path) -> None:
    before = {path.name: path.read_bytes() for path in flight_bag.iterdir()}
    assert repair(flight_bag) is None
    assert {path.name: path.read_bytes() for path in flight_bag.iterdir()} == before


def test_keeps_schemas_metadata_and_attachments(tmp_path: Path, write_flight: WriteFlight) -> None:
    directory = tmp_path / "flight"
    with BagWriter(directory) as writer:
        write_flight(writer, 10)
        writer.write_metadata("parameters", {"mpc": "control_rate: 50.0"})
        writer.flush_if_due(0.0)
    metadata = yaml.safe_load((directory / "metadata.yaml").read_text())
    before = BagReader(directory)
    file = directory / "flight_0.mcap"
    cut(directory, file.stat().st_size - 20)

    repair(directory)

    after = BagReader(directory)
    assert after.topics == before.topics
    assert after.metadata["parameters"] == {"mpc": "control_rate: 50.0"}
    assert [(m.log_time_ns, m.publish_time_ns, m.topic, m.data) for m in after.messages()] == [
        (m.log_time_ns, m.publish_time_ns, m.topic, m.data)
        for m in BagReader(directory / "flight_0.mcap").messages()
    ]
    assert yaml.safe_load((directory / "metadata.yaml").read_text()) == metadata


def test_drops_only_the_damaged_chunk(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    write_clocks(bag, 40, compression="none")
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(clock_data(15)) + 5] ^= 0x10
    file.write_bytes(content)

    (repaired,) = repair(bag) or ()

    assert repaired.damaged_chunks == 1
    assert numbers(bag) == [*range(10), *range(20, 40)]
    assert (bag / "metadata.yaml.broken").exists()
    assert repaired.original.read_bytes() == content


@pytest.mark.parametrize("zeros", [1, 9, 5000])
def test_ignores_zeros_after_a_power_failure(tmp_path: Path, zeros: int) -> None:
    """Some file systems keep the length of a file whose last blocks were never written."""
    write_clocks(tmp_path / "whole", 30, compression="none")
    content = (tmp_path / "whole" / "whole_0.mcap").read_bytes()
    for start in range(600, len(content) - 100, 151):
        bag = tmp_path / f"bag{start}"
        write_clocks(bag, 1)
        cut(bag, 0)
        (bag / f"bag{start}_0.mcap").write_bytes(content[:start] + bytes(zeros))
        repair(bag)
        kept = numbers(bag)
        assert kept == list(range(len(kept)))


def test_resumes_an_interrupted_repair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the two renamings."""
    bag = tmp_path / "bag"
    write_clocks(bag, 35, compression="none")
    last_chunk = (bag / "bag_0.mcap").read_bytes().rindex(clock_data(30))
    cut(bag, last_chunk)
    content = (bag / "bag_0.mcap").read_bytes()

    def killed(self: Path, target: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            repair(bag)
    assert (bag / "bag_0.mcap.broken").read_bytes() == content
    assert not (bag / "bag_0.mcap").exists()

    repair(bag)

    assert numbers(bag) == list(range(30))
    assert (bag / "bag_0.mcap.broken").read_bytes() == content
    assert names(bag) == ["bag_0.mcap", "bag_0.mcap.broken", "metadata.yaml"]


def test_repairs_a_bag_without_chunks(tmp_path: Path) -> None:
    with (tmp_path / "run_0.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, use_chunking=False)
        writer.start(profile="ros2")
        schema = writer.register_schema("lab_msgs/msg/Gain", "ros2msg", b"uint8 k\n")
        channel = writer.register_channel("/gain", "cdr", schema)
        for number in range(5):
            data = b"\x00\x01\x00\x00" + bytes([number])
            writer.add_message(channel, number, data, number, sequence=number)
        writer.add_attachment(1, 2, "notes.txt", "text/plain", b"remember")
        writer.finish()
    file = tmp_path / "run_0.mcap"
    file.write_bytes(file.read_bytes()[:-30])

    repair(tmp_path)

    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [(m.sequence, m.data[4]) for _, _, m in reader.iter_messages()] == [
            (number, number) for number in range(5)
        ]
        assert [a.data for a in reader.iter_attachments()] == [b"remember"]
    with AnyReader([tmp_path]) as bag:
        assert bag.topics["/gain"].msgcount == 5


@pytest.mark.parametrize("finished", [True, False])
def test_flipped_byte_creates_no_message(tmp_path: Path, finished: bool) -> None:
    write_clocks(tmp_path / "whole", 35)
    content = (tmp_path / "whole" / "whole_0.mcap").read_bytes()
    if not finished:
        content = content[: content.rindex(b"zstd") + 60]
    least = 35
    for index in range(8, len(content), 29):
        bag = tmp_path / f"bag{index}"
        bag.mkdir()
        damaged = bytearray(content)
        damaged[index] ^= 0x41
        file = bag / f"{bag.name}_0.mcap"
        file.write_bytes(damaged)

        repair(bag)

        kept = numbers(bag)
        assert set(kept) <= set(range(35))
        assert len(set(kept)) == len(kept)
        least = min(least, len(kept))
        if not file.with_name(f"{file.name}.broken").exists():
            assert file.read_bytes() == damaged
    assert least < 30, "no flip did any damage"


REFUSED = {
    "no such folder": (None, "is neither a bag directory nor an .mcap file"),
    "empty folder": ({}, "neither metadata.yaml nor an .mcap file"),
    "some text": ({"x_0.mcap": b"flight notes\n"}, "x_0.mcap: is not an MCAP file"),
    "repaired before": ({"x_0.mcap": b"\x89MCAP0\r\n", "x_0.mcap.broken": b"old"}, "exists"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refuses_what_cannot_be_repaired(tmp_path: Path, case: str) -> None:
    files, reason = REFUSED[case]
    bag = tmp_path / "bag"
    if files is not None:
        bag.mkdir()
        for name, content in files.items():
            (bag / name).write_bytes(content)
    with pytest.raises(BagError, match=reason) as caught:
        repair(bag)
    assert "\n" not in str(caught.value)
    if files is not None:
        assert {path.name: path.read_bytes() for path in bag.iterdir()} == files


def test_completes_metadata_with_an_empty_storage_identifier(flight_bag: Path) -> None:
    """rosbag2#2175: ``ros2 bag reindex`` of Humble leaves it empty."""
    metadata = flight_bag / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace("storage_identifier: mcap", 'storage_identifier: ""')
    )
    with pytest.raises(BagError, match=r"storage_identifier is empty.*: quad_mpc bag repair"):
        BagReader(flight_bag)
    assert repair(flight_bag) == []
    assert len(list(BagReader(flight_bag).messages())) == 15
    with AnyReader([flight_bag]) as reader:
        assert reader.message_count == 15


def test_lists_files_that_were_renamed(flight_bag: Path) -> None:
    (flight_bag / "flight_0.mcap").rename(flight_bag / "square_0.mcap")
    with pytest.raises(BagError, match=r"lists flight_0\.mcap, which does not exist.*bag repair"):
        BagReader(flight_bag)
    repair(flight_bag)
    assert [file.name for file in BagReader(flight_bag).files] == ["square_0.mcap"]


def test_indexes_the_messages_of_a_reindexed_bag(tmp_path: Path) -> None:
    """rosbag2#2003: recorded without an end, then given metadata.yaml by ``ros2 bag reindex``."""
    bag = tmp_path / "killed"
    write_clocks(bag, 35)
    metadata = (bag / "metadata.yaml").read_bytes()
    cut(bag, 1200)
    (bag / "metadata.yaml").write_bytes(metadata)
    with pytest.raises(BagError, match=f"is unfinished; complete it: quad_mpc bag repair {bag}"):
        BagReader(bag)
    repair(bag)
    assert has_message_indexes(bag / "killed_0.mcap")


def test_indexes_messages_of_a_finished_file_that_has_no_index_of_them(tmp_path: Path) -> None:
    """``ros2 bag play`` cannot put its messages in order."""
    bag = tmp_path / "bag"
    bag.mkdir()
    with (bag / "bag_0.mcap").open("wb") as stream:
        writer = Writer(stream, index_types=IndexType.ALL ^ IndexType.MESSAGE)
        writer.start(profile="ros2")
        channel = writer.register_channel("/clock", "cdr", 0)
        for number in range(20):
            writer.add_message(channel, number, clock_data(number), number)
        writer.finish()
    assert not has_message_indexes(bag / "bag_0.mcap")
    repair(bag)
    assert has_message_indexes(bag / "bag_0.mcap")
    assert len(list(BagReader(bag).messages())) == 20


def has_message_indexes(file: Path) -> bool:
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return all(chunk.message_index_offsets for chunk in summary.chunk_indexes)


def test_repairs_a_corrupt_file_among_sound_ones(tmp_path: Path) -> None:
    """rosbag2#2389: one file of a split bag is corrupt in a chunk, and not in metadata.yaml."""
    bag = tmp_path / "split"
    write_split_clocks(bag)
    file = bag / "split_1.mcap"
    content = bytearray(file.read_bytes())
    place = content.index(b"zstd") + 30
    content[place : place + 20] = bytes(20)
    file.write_bytes(content[:-100])
    metadata = bag / "metadata.yaml"
    lines = metadata.read_text().splitlines(keepends=True)
    metadata.write_text("".join(line for line in lines if "- split_1.mcap" not in line))
    damaged = repair(bag) or []
    assert [each.path for each in damaged] == [file]
    kept = numbers(bag)
    assert kept == sorted(set(kept)) and {*range(20), *range(42, 60)} <= {*kept}
