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
