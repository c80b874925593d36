"""``quad_mpc bag``: what it prints, also for files that are not bags."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from quad_mpc_ros.cli import main
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.writer import BagWriter

CLOCK = "rosgraph_msgs/msg/Clock"
COUNT = 15_000  # so that a chunk has several blocks of zstd, each whole or not


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    directory = tmp_path / "bag"
    with BagWriter(directory) as writer:
        writer.add_topic("/clock", CLOCK)
        writer.add_topic("/quiet", CLOCK)
        for number in range(4):
            data = b"\x00\x01\x00\x00" + bytes(8)
            time_ns = 1_700_000_000_000_000_000 + number * 500_000_000
            writer.write("/clock", data, log_time_ns=time_ns, publish_time_ns=0)
    return directory


def cut(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-30])


def test_the_folder_of_a_run_has_its_bag(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut(bag)
    assert main(["bag", "repair", str(bag.parent)]) == 0
    assert "metadata.yaml written" in capsys.readouterr().out


def test_repairs_a_bag_once(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut(bag)
    assert f"quad_mpc bag repair {bag}" in BagReader(bag).warning

    assert main(["bag", "repair", str(bag)]) == 0

    printed = capsys.readouterr().out
    assert "bag_0.mcap: 4 messages kept" in printed
    assert "bag_0.mcap.broken" in printed
    assert "metadata.yaml written" in printed
    with AnyReader([bag]) as reader:
        assert reader.message_count == 4
    assert main(["bag", "repair", str(bag)]) == 0
    assert capsys.readouterr().out.startswith("nothing to repair")


@pytest.mark.parametrize("kind", ["missing", "empty folder", "text", "metadata of nothing"])
def test_what_is_not_a_bag_is_one_line_and_exit_code_2(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bag"
    if kind != "missing":
        path.mkdir()
    if kind == "text":
        (path / "x_0.mcap").write_text("flight notes")
    if kind == "metadata of nothing":
        (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")

    assert main(["bag", "repair", str(path)]) == 2

    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert str(path) in printed.err
    assert len(printed.err.strip().splitlines()) == 1


def lone_cut_file(tmp_path: Path) -> Path:
    """Return a file of many messages that ends in the middle of its only chunk."""
    directory = tmp_path / "long"
    with BagWriter(directory) as writer:
        writer.add_topic("/clock", CLOCK)
        source = random.Random(1)
        for number in range(COUNT):
            data = b"\x00\x01\x00\x00" + source.randbytes(8)
            writer.write("/clock", data, log_time_ns=10**9 * (number + 1), publish_time_ns=0)
    content = (directory / "long_0.mcap").read_bytes()
    (tmp_path / "alone").mkdir()
    file = tmp_path / "alone" / "trunc.mcap"
    file.write_bytes(content[: len(content) // 3])
    return file


def test_what_is_whole_of_a_cut_file_is_read_and_repaired_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = lone_cut_file(tmp_path)
    damaged = file.read_bytes()
    read = [message.data for message in BagReader(file).messages()]
    assert 1000 < len(read) < COUNT

    warning = BagReader(file).warning
    assert "is unfinished" in warning
    assert f"quad_mpc bag repair {file}" in warning

    assert main(["bag", "repair", str(file)]) == 0
    assert f"{len(read)} messages kept" in capsys.readouterr().out
    assert [message.data for message in BagReader(file).messages()] == read
    assert BagReader(file).complete
    assert file.with_name("trunc.mcap.broken").read_bytes() == damaged
    assert sorted(path.name for path in file.parent.iterdir()) == [
        file.name,
        f"{file.name}.broken",
    ]
    assert main(["bag", "repair", str(file)]) == 0
    assert capsys.readouterr().out.startswith("nothing to repair")


def test_an_earlier_original_is_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = lone_cut_file(tmp_path)
    broken = file.with_name("trunc.mcap.broken")
    broken.write_text("from an earlier repair")
    assert main(["bag", "repair", str(file)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert broken.read_text() == "from an earlier repair"


def test_a_file_of_a_bag_is_repaired_with_it(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bag", "repair", str(bag / "bag_0.mcap")]) == 2
    assert f"quad_mpc bag repair {bag}" in capsys.readouterr().err
