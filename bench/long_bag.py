# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Play a recorded flight over and over into one long bag, to test tools with an hour of data.

python bench/long_bag.py runs/…/bag long_bag --hours 1
quad_mpc report long_bag; quad_mpc identify long_bag

Every time is later by the length of the flight in each round: those of the log, those of
publication, and the stamps of the messages. Messages without a leading stamp are copied unchanged.
"""

from __future__ import annotations

import argparse
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from quad_mpc_ros.messages.diagnostics import written_stats
from quad_mpc_ros.messages.topics import ODOMETRY, STATS
from quad_mpc_ros.recordings.logs import tick_stats
from quad_mpc_ros.recordings.parameters import write_parameters
from quad_mpc_ros.recordings.qos import parse_qos_text
from quad_mpc_ros.recordings.reader import RecordedMessage
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.recordings.writer import BagWriter

Shift = Callable[[RecordedMessage, int], bytes]

_STAMP = struct.Struct("<iI")
_STAMP_AT = 4  # after the header of CDR, in types that begin with a std_msgs/Header
_FLUSH_NS = 500_000_000


def repeat(bag: Path, out: Path, *, duration: float) -> int:
    """Write ``duration`` seconds of a flight over and over; return the number of messages."""
    recording = Recording(bag)
    messages = list(recording.bag.messages())
    lap_ns = _lap_ns(messages)
    shift = _shift_of(recording)
    count = 0
    with BagWriter(out) as writer:
        for name, info in recording.bag.topics.items():
            profiles = parse_qos_text(info.qos_profiles)
            writer.add_topic(name, info.type_name, qos_profiles=profiles)
        for node, values in recording.parameters.items():
            write_parameters(writer, node, values)
        flushed_ns = 0
        for lap in range(-(-round(duration * 1e9) // lap_ns)):
            later_ns = lap * lap_ns
            for message in messages:
                log_time_ns = message.log_time_ns + later_ns
                writer.write(
                    message.topic,
                    shift(message, later_ns),
                    log_time_ns=log_time_ns,
                    publish_time_ns=message.publish_time_ns + later_ns,
                )
                count += 1
                if log_time_ns - flushed_ns >= _FLUSH_NS:  # chunks as a recorder makes them
                    writer.flush()
                    flushed_ns = log_time_ns
    return count


def _lap_ns(messages: list[RecordedMessage]) -> int:
    """Return the length of the flight and of one odometry period."""
    times = [m.log_time_ns for m in messages if m.topic.endswith(f"/{ODOMETRY.name}")]
    return times[-1] - times[0] + int(np.median(np.diff(times)))


def _shift_of(recording: Recording) -> Shift:
    """Return a function that converts the data of a message for a later round."""
    stamped = {
        name
        for name, info in recording.bag.topics.items()
        if info.type_name.split("/")[0] in ("nav_msgs", "geometry_msgs", "trajectory_msgs")
    }
    stats = {name for name in recording.bag.topics if name.endswith(f"/{STATS.name}")}

    def shift(message: RecordedMessage, later_ns: int) -> bytes:
        if message.topic in stats:  # their stamp is a figure, too
            return _later_stats(message, later_ns)
        if message.topic not in stamped:
            return message.data
        data = bytearray(message.data)
        seconds, nanoseconds_ = _STAMP.unpack_from(data, _STAMP_AT)
        stamp_ns = seconds * 1_000_000_000 + nanoseconds_ + later_ns
        _STAMP.pack_into(data, _STAMP_AT, *divmod(stamp_ns, 1_000_000_000))
        return bytes(data)

    return shift


def _later_stats(message: RecordedMessage, later_ns: int) -> bytes:
    stats = tick_stats(message.message)
    return written_stats(replace(stats, stamp_ns=stats.stamp_ns + later_ns))


def main() -> int:
    """Write the bag and print its contents."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("bag", type=Path, help="bag, or the folder of a run")
    parser.add_argument("out", type=Path, help="folder of the long bag, which must not exist")
    parser.add_argument("--hours", type=float, default=1.0)
    options = parser.parse_args()
    count = repeat(options.bag, options.out, duration=3600.0 * options.hours)
    print(f"{count} messages over {options.hours:g} h into {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
