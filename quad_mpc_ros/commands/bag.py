"""``quad_mpc bag``: look into a bag, repair one."""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path

from quad_mpc_ros.commands.recording import WHICH_BAG
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.recordings.bag_metadata import TimeSpan
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.repair import RepairedFile, repair

_MIB = 2**20


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what can be done with a bag directory."""
    parser.description = "Look into a bag, or repair one."
    commands = parser.add_subparsers(metavar="COMMAND", required=True, dest="command")
    info = commands.add_parser("info", help="what is in a bag: topics, counts, duration")
    info.add_argument("bag", type=Path, metavar="BAG", help=WHICH_BAG)
    repairing = commands.add_parser(
        "repair",
        help="complete a recording that was cut short",
        description="Restore the index and metadata.yaml after the recorder was killed or lost "
        "power, after files were renamed, and correct log times of a clock that was not set. "
        "Damaged files stay beside the repaired ones as <name>.broken. A sound bag is left alone.",
    )
    repairing.add_argument("bag", type=Path, metavar="BAG", help=WHICH_BAG)


def run(options: argparse.Namespace) -> int:
    """Do what was asked for; return the exit code."""
    if options.command == "repair":
        _repair(options.bag)
    print(_info(options.bag))
    return 0


def _repair(directory: Path) -> None:
    done = repair(directory)
    for file in done.files:
        print(_repaired(file))
    wrote = "metadata.yaml written\n" if directory.is_dir() else ""
    print(wrote if done.needed else "nothing to repair\n")


def _repaired(file: RepairedFile) -> str:
    left = [f"{file.unreadable_bytes} bytes after the last whole record"]
    if file.damaged_chunks:
        left.append(f"{file.damaged_chunks} damaged chunks")
    corrected = f", {file.corrected_times} log times corrected" if file.corrected_times else ""
    return (
        f"{file.path.name}: {file.message_count} messages kept, left out {' and '.join(left)}"
        f"{corrected}; "
        f"the original is {file.original.name}"
    )


def _info(path: Path) -> str:
    reader = BagReader(path)
    count = sum(info.message_count for info in reader.topics.values())
    size = sum(file.stat().st_size for file in reader.files)
    lines = [
        f"bag       {reader.path}",
        f"files     {', '.join(file.name for file in reader.files)} ({size / _MIB:.1f} MiB)",
        f"duration  {reader.duration_ns * 1e-9:.3f} s{_start(reader.span)}",
        f"messages  {count}",
    ]
    if reader.warning:
        lines.append(reader.warning)
    topics = [
        (f"  {topic}", f"{info.message_count}", info.type_name)
        for topic, info in sorted(reader.topics.items())
    ]
    lines += text_table(topics, align="lrl", widths=(0, 8, 0))
    return "\n".join(lines)


def _start(span: TimeSpan | None) -> str:
    if span is None:
        return ""
    start = datetime.datetime.fromtimestamp(span.start_ns * 1e-9, datetime.UTC)
    return f" from {start:%Y-%m-%d %H:%M:%S} UTC"
