"""What operating system and garbage collector can do for a process that must not be late.

Each request is granted, or refused with a sentence that says what is in the way. A node that is
refused flies on without: it is later now and then, which ``mpc/stats`` shows.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from quad_mpc_ros.control.config import RealtimeParameters

_MLOCK_CURRENT, _MLOCK_FUTURE = 1, 2
_LATENCY = "/dev/cpu_dma_latency"
_LIMITS = "set it for your user in /etc/security/limits.conf and log in again, or in a container"


def apply(wanted: RealtimeParameters) -> list[str]:
    """Ask the operating system for what is wanted; return what it refuses, in sentences."""
    refusals: list[str] = []
    if wanted.cpus:
        refusals += _refusal(lambda: _pin(wanted.cpus), f"cpus {list(wanted.cpus)}", _cpus_hint())
    if wanted.lock_memory:
        hint = f"it needs a memlock limit of unlimited: {_LIMITS} --ulimit memlock=-1"
        refusals += _refusal(_lock_memory, "lock_memory", hint)
    if wanted.keep_awake:
        hint = f"it needs write access to {_LATENCY}: run as root, or let a udev rule give it"
        refusals += _refusal(_keep_awake, "keep_awake", hint)
    if wanted.scheduler_priority:
        priority = wanted.scheduler_priority
        hint = f"it needs an rtprio limit of {priority}: {_LIMITS} --cap-add=SYS_NICE"
        refusals += _refusal(
            lambda: _schedule_first(priority),
            f"scheduler_priority {priority} (SCHED_FIFO)",
            hint,
        )
    return refusals


def _refusal(request: Callable[[], object], name: str, hint: str) -> list[str]:
    try:
        request()
    except OSError as error:
        return [f"advanced.realtime.{name} is not granted ({error.strerror}); {hint}"]
    return []


def _schedule_first(priority: int) -> None:
    """Let every thread of this process go first; those of the middleware bring the odometry."""
    for task in Path("/proc/self/task").iterdir():
        os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(priority))


def _pin(cpus: Iterable[int]) -> None:
    """Keep every thread of this process, those of the middleware included, on some processors."""
    for task in Path("/proc/self/task").iterdir():
        os.sched_setaffinity(int(task.name), cpus)


def _cpus_hint() -> str:
    return f"this process may use {sorted(os.sched_getaffinity(0))}"


@functools.cache
def _keep_awake() -> int:
    """Ask for no delay of waking, which holds until the file is closed at the end of the process.

    Linux, Documentation/power/pm_qos_interface.rst: a wish of 0 us as 32 bits.
    """
    file = os.open(_LATENCY, os.O_WRONLY)
    os.write(file, (0).to_bytes(4, sys.byteorder))
    return file


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MLOCK_CURRENT | _MLOCK_FUTURE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def freeze_gc() -> None:
    """Take what exists now for as long-lived as the process.

    A full collection in flight then need not look at it, which would take milliseconds.
    """
    gc.collect()
    gc.freeze()


def free_memory() -> None:
    """Free what nothing uses any more, what was taken for long-lived included."""
    gc.unfreeze()
    for _ in range(3):  # what was freed may have been the last to hold something else
        if not gc.collect():
            break


class GarbageCollection:
    """Collects garbage when there is time for it, instead of whenever enough has gathered.

    A collection looks only at what has come since :func:`freeze_gc`, and is short.
    """

    _TICKS = 50

    def __init__(self, *, between_ticks: bool) -> None:
        self._between_ticks = between_ticks
        self._ticks = 0
        if between_ticks:
            gc.disable()

    def after_tick(self) -> None:
        """Collect now and then; to be called when the command is out and the next is far."""
        self._ticks += 1
        if self._between_ticks and self._ticks % self._TICKS == 0:
            gc.collect()
