# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Record the traffic of a flight for a while: lost messages, processor time, growth of memory.

python bench/record.py --duration 600

Two processes publish odometry, reference, command, plan and statistics as a flight does, each
message numbered; the recorder runs as a process of its own. Prints the messages published and
recorded by topic, the recorder's share of one core, and its resident memory over time. Exit code
1 when a message is missing.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quad_mpc_ros.messages.topics import (
    COMMAND,
    ODOMETRY,
    PREDICTED_PATH,
    REFERENCE,
    STATS,
    Topic,
)
from quad_mpc_ros.recordings.reader import BagReader

SENDERS: dict[str, tuple[Topic, ...]] = {
    "simulator": (ODOMETRY,),
    "controller": (REFERENCE, COMMAND, PREDICTED_PATH, STATS),
}
_WAIT_S = 20.0


@dataclass(frozen=True, kw_only=True)
class Load:
    """Usage of a process: its share of one core, and resident memory [MiB] once a second."""

    cpu_share: float
    memory_mib: Sequence[float]


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Numbers of the messages recorded by topic, how many were sent of each, and the load."""

    sent: int
    recorded: dict[str, list[int]]
    load: Load

    @property
    def complete(self) -> bool:
        """Whether every message is there once and in order."""
        expected = list(range(self.sent))
        return all(numbers == expected for numbers in self.recorded.values())


def record(bag: Path, *, duration: float, rate: float, arguments: Sequence[str] = ()) -> Recording:
    """Record ``duration`` seconds of every topic at ``rate`` [Hz] into ``bag``."""
    count = round(duration * rate)
    module = "quad_mpc_ros.ros.nodes.recorder_node"
    ros_arguments = ["--ros-args", "-p", f"directory:={bag}", *arguments]
    recorder = subprocess.Popen([sys.executable, "-P", "-m", module, *ros_arguments])
    senders = [
        subprocess.Popen([sys.executable, "-P", __file__, "--send", name, str(count), str(rate)])
        for name in SENDERS
    ]
    try:
        load = _watch(recorder, senders)
    finally:
        for process in (*senders, recorder):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            process.wait(_WAIT_S)
    return Recording(sent=count, recorded=_numbers(bag), load=load)


def _watch(recorder: subprocess.Popen[bytes], senders: Sequence[subprocess.Popen[bytes]]) -> Load:
    """Sample the recorder once a second while messages are sent."""
    time.sleep(3.0)  # what starting takes is not of interest
    memory = []
    started, cpu_before = time.monotonic(), _cpu_s(recorder.pid)
    while any(sender.poll() is None for sender in senders):
        memory.append(_memory_mib(recorder.pid))
        time.sleep(1.0)
    share = (_cpu_s(recorder.pid) - cpu_before) / (time.monotonic() - started)
    time.sleep(0.5)
    return Load(cpu_share=share, memory_mib=memory)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mib(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _numbers(bag: Path) -> dict[str, list[int]]:
    topics = [f"/{topic.name}" for topics in SENDERS.values() for topic in topics]
    found: dict[str, list[int]] = {topic: [] for topic in topics}
    for message in BagReader(bag).messages(topics):
        # CDR: four bytes of header, then header.stamp.sec, for all of these types.
        found[message.topic].append(int.from_bytes(message.data[4:8], "little"))
    return found


def _send(name: str, *, count: int, rate: float) -> None:
    """Publish ``count`` numbered messages of every topic of a sender."""
    import rclpy

    from quad_mpc_ros.ros.messages import message_class, qos_of

    rclpy.init()
    node = rclpy.create_node(name)
    messages = {
        node.create_publisher(message_class(topic.type_name), topic.name, qos_of(topic)): _like(
            topic
        )
        for topic in SENDERS[name]
    }
    deadline = time.monotonic() + _WAIT_S
    while not all(publisher.get_subscription_count() for publisher in messages):
        if time.monotonic() > deadline:
            sys.exit(f"{name}: no subscriber")
        time.sleep(0.05)
    time.sleep(0.5)
    started = time.monotonic()
    for number in range(count):
        time.sleep(max(0.0, started + number / rate - time.monotonic()))
        for publisher, message in messages.items():
            message.header.stamp.sec = number
            publisher.publish(message)
    time.sleep(1.0)
    node.destroy_node()
    rclpy.shutdown()


def _like(topic: Topic) -> Any:
    """Return a message as large as a flight has it."""
    from quad_mpc_ros.ros.messages import new_message

    message = new_message(topic.type_name)
    message.header.frame_id = "odom"
    if topic is REFERENCE:
        for _ in range(11):
            point = new_message("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
            point.transforms = [new_message("geometry_msgs/msg/Transform")]
            point.velocities = [new_message("geometry_msgs/msg/Twist")]
            point.accelerations = [new_message("geometry_msgs/msg/Twist")]
            message.points.append(point)
    elif topic is PREDICTED_PATH:
        message.poses = [new_message("geometry_msgs/msg/PoseStamped") for _ in range(11)]
    elif topic is STATS:
        status = new_message("diagnostic_msgs/msg/DiagnosticStatus")
        for number in range(20):
            pair = new_message("diagnostic_msgs/msg/KeyValue")
            pair.key, pair.value = f"statistic_{number}", f"{number / 7.0}"
            status.values.append(pair)
        message.status = [status]
    return message


def main() -> int:
    """Record and print; the exit code is 1 if messages are missing."""
    if sys.argv[1:2] == ["--send"]:
        name, count, rate = sys.argv[2:]
        _send(name, count=int(count), rate=float(rate))
        return 0
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=60.0, help="seconds of traffic")
    parser.add_argument("--rate", type=float, default=50.0, help="messages a second of each topic")
    parser.add_argument("recorder", nargs="*", help="ROS arguments of the recorder")
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, "bag")
        recording = record(
            bag, duration=options.duration, rate=options.rate, arguments=options.recorder
        )
        size = sum(path.stat().st_size for path in bag.iterdir()) / 2**20
    for topic, numbers in recording.recorded.items():
        print(f"{topic}: {len(numbers)} of {recording.sent}")
    load, memory = recording.load, recording.load.memory_mib
    print(f"recorder: {100.0 * load.cpu_share:.1f} % of a core, bag {size:.1f} MiB")
    marks = [memory[round(part * (len(memory) - 1) / 10)] for part in range(11)]
    print("memory [MiB]: " + " ".join(f"{mark:.1f}" for mark in marks))
    return 0 if recording.complete else 1


if __name__ == "__main__":
    sys.exit(main())
