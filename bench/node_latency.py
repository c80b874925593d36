# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Compare a flight over DDS in real time with a minimal relay: latency, processor, memory, start.

python bench/node_latency.py [--rate HZ] [--duration S] [--set NODE.PARAM=VALUE ...]

Starts what ``quad_mpc fly`` starts, and ``bench/relay.py``: an ordinary rclpy node with its
default executor that answers each odometry with an empty command. Both receive the same odometries
on the same machine at the same time: what the machine costs is in both. Latency is from the
publication of the odometry to that of the command, as DDS stamps them.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.commands.flight_monitor import FlightMonitor
from quad_mpc_ros.commands.processes import NodeProcess, start_all, stop_all
from quad_mpc_ros.commands.run_configuration import RunConfig, run_configuration
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.messages.cdr import header_stamp_ns
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY
from quad_mpc_ros.recordings.reader import BagReader

_RELAY = Path(__file__).with_name("relay.py")
_RELAYED = "relayed_command"
_READY_TIMEOUT = 240.0
_WARM_UP_NS = 1_000_000_000  # of the flight, left out
_PERCENTILES = (50, 99, 100)
# rclpy's line of a transition: [INFO] [1700000000.123456789] [mpc]: inactive
_CONFIGURED = re.compile(r"\[(\d+\.\d+)\] \[\w+\]: inactive")


class Load(NamedTuple):
    """Processor time [s] and resident memory [MiB] of a process."""

    cpu: float
    memory: float


def main() -> int:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_run_options(parser)
    parser.add_argument("--rate", type=float, default=50.0, help="of odometry and control [Hz]")
    parser.set_defaults(duration=60.0)
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rate = options.rate
    options.assignments[:0] = [
        f"mpc.control_rate={rate}",
        f"simulator.odom_rate={rate}",
        f"recorder.topics=[odom, reference, command, mpc/stats, {_RELAYED}, "
        "mpc/predicted_path, reference/path]",
    ]
    with tempfile.TemporaryDirectory() as folder:
        options.out = options.out or Path(folder, "run")
        config = run_configuration(options, lockstep=False)
        loads, started = fly(config)
        print(latencies(config.out / "bag", period_ms=1e3 / rate))
        print(footprints(loads, started, config.simulator.duration))
    return 0


def fly(config: RunConfig) -> tuple[dict[str, Load], dict[str, float]]:
    """Fly; return what each process took of the flight, and how long its start took [s]."""
    begun = time.time()
    relaying = subprocess.Popen([sys.executable, "-P", _RELAY, _RELAYED])
    processes: dict[str, NodeProcess] = {}
    try:
        processes = start_all(config, lockstep=False)
        pids = {name: process.pid for name, process in processes.items()} | {"relay": relaying.pid}
        with FlightMonitor(lockstep=False) as monitor:
            await_readiness(monitor)
            monitor.start_simulator()
            before = after = loads_of(pids, {})
            while processes["simulator"].exit_code is None:
                after = loads_of(pids, after)
                time.sleep(0.5)
    finally:
        relaying.send_signal(signal.SIGINT)
        relaying.wait()
        stop_all(processes)
    logs = {name: config.out / "log" / f"{name}.log" for name in processes}
    configured = {name: _CONFIGURED.search(log.read_text()) for name, log in logs.items()}
    starts = {name: float(found[1]) - begun for name, found in configured.items() if found}
    return {
        name: Load(load.cpu - before[name].cpu, load.memory) for name, load in after.items()
    }, starts


def await_readiness(monitor: FlightMonitor) -> None:
    """Wait until all are connected, the relay and the recorder of its commands included."""
    deadline = time.monotonic() + _READY_TIMEOUT
    while not (monitor.ready() and monitor.node.count_subscribers(_RELAYED)):
        if time.monotonic() > deadline:
            raise SystemExit(f"missing: {', '.join(monitor.missing())}")
        monitor.spin(0.02)


def loads_of(pids: dict[str, int], before: dict[str, Load]) -> dict[str, Load]:
    """Return the usage of processes so far; the last known usage of ended processes."""
    loads = dict(before)
    for name, pid in pids.items():
        times = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        if pages:  # a zombie has none
            cpu = (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")
            loads[name] = Load(cpu, pages * os.sysconf("SC_PAGE_SIZE") / 2**20)
    return loads


def latencies(bag: Path, *, period_ms: float) -> str:
    """Return a table of the controller's latency and the relay's."""
    sent: dict[str, dict[int, int]] = {ODOMETRY.name: {}, COMMAND.name: {}, _RELAYED: {}}
    for message in BagReader(bag).messages([f"/{topic}" for topic in sent]):
        stamps = sent[message.topic.removeprefix("/")]
        stamps.setdefault(header_stamp_ns(message.data), message.publish_time_ns)
    odometries = sent[ODOMETRY.name]
    first_ns = min(odometries) + _WARM_UP_NS
    rows = [["odometry to command [ms]", "answered", "p50", "p99", "max", "late by a period"]]
    for name, answers in (("mpc", sent[COMMAND.name]), ("relay", sent[_RELAYED])):
        asked = [ns for ns in odometries if ns >= first_ns]
        taken = 1e-6 * np.array([answers[ns] - odometries[ns] for ns in asked if ns in answers])
        late = len(asked) - int(np.sum(taken <= period_ms))
        rows.append(
            [
                name,
                f"{len(taken)} of {len(asked)}",
                *(f"{value:.3f}" for value in np.percentile(taken, _PERCENTILES)),
                f"{late} ({100.0 * late / len(asked):.2f} %)",
            ]
        )
    return "\n".join(text_table(rows, align="lrrrrr"))


def footprints(loads: dict[str, Load], starts: dict[str, float], duration: float) -> str:
    """Return a table of processor, memory and start by process."""
    rows = [["", "processor [%]", "resident [MiB]", "start to configured [s]"]]
    for name, load in loads.items():
        start = f"{starts[name]:.2f}" if name in starts else ""
        rows.append([name, f"{100.0 * load.cpu / duration:.1f}", f"{load.memory:.0f}", start])
    return "\n".join(text_table(rows, align="lrrr"))


if __name__ == "__main__":
    sys.exit(main())
