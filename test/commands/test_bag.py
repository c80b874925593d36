# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc bag``: what it prints, also for files that are not bags."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from quad_mpc_ros.cli import main
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.writer import BagWriter

CLOCK = "rosgraph_msgs/msg/Clock"


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


def test_accepts_the_folder_of_a_run(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut(bag)
    assert main(["bag", "repair", str(bag.parent)]) == 0
    assert "metadata.yaml written" in capsys.readouterr().out


def test_repairs_a_bag_once(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut(bag)
    assert main(["bag", "repair", str(bag)]) == 0

    printed = capsys.readouterr().out
    assert "bag_0.mcap: 4 messages kept" in printed
    assert "bag_0.mcap.broken" in printed
    assert "metadata.yaml written" in printed
    with AnyReader([bag]) as reader:
        assert reader.message_count == 4
    assert main(["bag", "repair", str(bag)]) == 0
    assert capsys.readouterr().out.startswith("nothing to repair")


def test_repairs_a_single_file(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "trunc.mcap"
    damaged = (bag / "bag_0.mcap").read_bytes()[:-30]
    file.write_bytes(damaged)

    assert main(["bag", "repair", str(file)]) == 0

    assert "4 messages kept" in capsys.readouterr().out
    assert len(list(BagReader(file).messages())) == 4
    assert file.with_name("trunc.mcap.broken").read_bytes() == damaged
    assert main(["bag", "repair", str(file)]) == 0
    assert capsys.readouterr().out.startswith("nothing to repair")


def test_an_earlier_original_is_not_overwritten(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut(bag)
    broken = bag / "bag_0.mcap.broken"
    broken.write_text("from an earlier repair")
    assert main(["bag", "repair", str(bag)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert broken.read_text() == "from an earlier repair"


def test_refuses_a_single_file_of_a_bag(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "repair", str(bag / "bag_0.mcap")]) == 2
    assert f"quad_mpc bag repair {bag}" in capsys.readouterr().err
