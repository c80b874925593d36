"""Requests to the operating system, each in a process of its own: none can be taken back."""

from __future__ import annotations

import subprocess
import sys

import pytest

from quad_mpc_ros.control.config import RealtimeParameters
from quad_mpc_ros.ros import realtime

# Root may do anything, so the process becomes another user.
_WITHOUT_PRIVILEGES = """
if os.geteuid() == 0:
    os.setresgid(65534, 65534, 65534)
    os.setresuid(65534, 65534, 65534)
"""


def _said(code: str) -> str:
    """Run code with the module imported, in a process of its own; return what it printed."""
    imports = (
        "import ctypes, gc, os, resource, threading\n"
        "from quad_mpc_ros.control.config import RealtimeParameters\n"
        "from quad_mpc_ros.ros import realtime\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", imports + code],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return result.stdout


def test_nothing_wanted_is_nothing_asked() -> None:
    assert realtime.apply(RealtimeParameters()) == []


def test_every_thread_is_pinned() -> None:
    said = _said(
        "stop = threading.Event()\n"
        "threading.Thread(target=stop.wait).start()\n"
        "cpu = max(os.sched_getaffinity(0))\n"
        "print(realtime.apply(RealtimeParameters(cpus=(cpu,))))\n"
        "print([os.sched_getaffinity(int(t)) == {cpu} for t in os.listdir('/proc/self/task')])\n"
        "stop.set()\n"
    )
    refused, pinned = said.splitlines()
    assert refused == "[]"
    assert "True, True" in pinned
    assert "False" not in pinned


def test_a_processor_that_is_not_there_is_named_with_those_that_are() -> None:
    said = _said("print(realtime.apply(RealtimeParameters(cpus=(4095,))))")
    assert "realtime.cpus [4095] is not granted (Invalid argument); this process may use [" in said


def test_memory_is_locked_or_the_limit_named() -> None:
    said = _said(
        "print(realtime.apply(RealtimeParameters(lock_memory=True)))\n"
        "print([line for line in open('/proc/self/status') if line.startswith('VmLck')])\n"
    )
    refused, locked = said.splitlines()
    if refused == "[]":
        assert "VmLck:\\t       0 kB" not in locked
    else:
        assert "memlock limit of unlimited" in refused


def test_processors_are_kept_awake_or_the_file_named() -> None:
    """Asked for twice, as by a node that is configured again, it is one file."""
    said = _said(
        "wanted = RealtimeParameters(keep_awake=True)\n"
        "print(realtime.apply(wanted))\n"
        "print(realtime.apply(wanted))\n"
        "files = [os.readlink(f'/proc/self/fd/{n}') for n in range(3, 9)"
        " if os.path.exists(f'/proc/self/fd/{n}')]\n"
        "print(files.count('/dev/cpu_dma_latency'))\n"
    )
    first, second, files = said.splitlines()
    assert second == first
    if first == "[]":
        assert files == "1"
    else:
        assert "realtime.keep_awake is not granted" in first
        assert "needs write access to /dev/cpu_dma_latency" in first


def test_reports_processors_that_cannot_be_kept_awake() -> None:
    said = _said(
        f"{_WITHOUT_PRIVILEGES}print(realtime.apply(RealtimeParameters(keep_awake=True)))"
    )
    assert "realtime.keep_awake is not granted" in said


def test_reports_memory_that_cannot_be_locked() -> None:
    said = _said(
        f"resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))\n{_WITHOUT_PRIVILEGES}"
        "print(realtime.apply(RealtimeParameters(lock_memory=True)))"
    )
    assert "realtime.lock_memory is not granted" in said
    assert "memlock limit of unlimited" in said


def test_a_priority_is_given_to_every_thread_or_the_limit_named() -> None:
    said = _said(
        "stop = threading.Event()\n"
        "threading.Thread(target=stop.wait).start()\n"
        "print(realtime.apply(RealtimeParameters(scheduler_priority=20)))\n"
        "threads = [int(name) for name in os.listdir('/proc/self/task')]\n"
        "print(len(threads) > 1, {os.sched_getscheduler(each) == os.SCHED_FIFO"
        " and os.sched_getparam(each).sched_priority for each in threads})\n"
        "stop.set()\n"
    )
    refused, granted = said.splitlines()
    assert granted == "True {20}" if refused == "[]" else "rtprio limit of 20" in refused


def test_reports_a_priority_that_is_not_permitted() -> None:
    said = _said(
        f"resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))\n{_WITHOUT_PRIVILEGES}"
        "print(realtime.apply(RealtimeParameters(scheduler_priority=20)))"
    )
    assert "realtime.scheduler_priority 20 (SCHED_FIFO) is not granted" in said
    assert "rtprio limit of 20" in said


@pytest.mark.parametrize(("way", "collections"), [("between_ticks", 2), ("automatic", 0)])
def test_garbage_is_collected_between_ticks_or_by_itself(way: str, collections: int) -> None:
    said = _said(
        f"garbage = realtime.GarbageCollection(between_ticks={way == 'between_ticks'})\n"
        "before = gc.get_stats()[2]['collections']\n"
        "for _ in range(100): garbage.after_tick()\n"
        "print(gc.get_stats()[2]['collections'] - before, gc.isenabled())\n"
    )
    assert said.split() == [str(collections), str(way == "automatic")]
