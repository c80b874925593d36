# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Replay a bag and record it again: is every byte there, and how true is the timing.

python bench/replay.py BAG [--rate X]

The player and the recorder run as processes of their own. Prints, over all topics but
/diagnostics, how far the intervals between messages of a topic are from the recorded ones, and
how far a message is from where it belongs in the whole. Exit code 1 when a message is missing.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.messages.topics import DIAGNOSTICS
from quad_mpc_ros.recordings.reader import BagReader

_WAIT_S = 20.0


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Topics whose messages differ, and errors in time of what was replayed [s]."""

    different: list[str]
    interval_error: NDArray[np.float64]
    position_error: NDArray[np.float64]


def replay_and_record(bag: Path, again: Path, *, rate: float = 1.0) -> Comparison:
    """Replay ``bag``, record it into ``again``, and compare."""
    topics = sorted(set(BagReader(bag).topics) - {DIAGNOSTICS.name})
    recorder = _node("recorder", f"directory:={again}", f"topics:=[{', '.join(topics)}]")
    player = _node("player", f"bag:={bag}", f"rate:={rate}", "delay:=4.0")
    try:
        player.wait()
    finally:
        for process in (player, recorder):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            process.wait(_WAIT_S)
    return compare(bag, again, topics=topics, rate=rate)


def compare(bag: Path, again: Path, *, topics: list[str], rate: float) -> Comparison:
    """Compare the messages of some topics by content, and by the time of publication."""
    before, after = _content(bag, topics, by_log_time=True), _content(again, topics)
    different = [topic for topic in topics if before[topic][1] != after[topic][1]]
    pairs = [
        (np.array(before[topic][0]) / rate, np.array(after[topic][0]))
        for topic in topics
        if topic not in different
    ]
    intervals = [np.diff(new) - np.diff(old) for old, new in pairs]
    offsets = np.concatenate([new - old for old, new in pairs]) if pairs else np.zeros(1)
    return Comparison(
        different=different,
        interval_error=np.abs(np.concatenate(intervals)) if intervals else np.zeros(1),
        position_error=np.abs(offsets - np.median(offsets)),
    )


def _content(
    bag: Path, topics: list[str], *, by_log_time: bool = False
) -> dict[str, tuple[list[float], list[bytes]]]:
    """Return times [s] and data of the messages of each topic, in the order of their times."""
    found: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in topics}
    for message in BagReader(bag).messages(topics):
        time_ns = message.log_time_ns if by_log_time else message.publish_time_ns
        found[message.topic].append((time_ns, message.data))
    origin_ns = min((items[0][0] for items in found.values() if items), default=0)
    return {
        topic: ([(time_ns - origin_ns) * 1e-9 for time_ns, _ in items], [d for _, d in items])
        for topic, items in found.items()
    }


def _node(name: str, *parameters: str) -> subprocess.Popen[bytes]:
    arguments = [argument for parameter in parameters for argument in ("-p", parameter)]
    module = f"quad_mpc_ros.ros.nodes.{name}_node"
    return subprocess.Popen([sys.executable, "-P", "-m", module, "--ros-args", *arguments])


def main() -> int:
    """Replay, record and print; the exit code is 1 if messages are missing."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("--rate", type=float, default=1.0)
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with tempfile.TemporaryDirectory() as folder:
        result = replay_and_record(options.bag, Path(folder, "again"), rate=options.rate)
    for topic in result.different:
        print(f"{topic}: not the messages that were recorded")
    for name, errors in (
        ("interval", result.interval_error),
        ("position in time", result.position_error),
    ):
        p50, p99, most = 1e3 * np.percentile(errors, [50, 99, 100])
        print(f"{name}: error p50 {p50:.3f} ms, p99 {p99:.3f} ms, max {most:.3f} ms")
    return 1 if result.different else 0


if __name__ == "__main__":
    sys.exit(main())
