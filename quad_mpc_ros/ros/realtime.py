"""Real-time settings of the operating system and the garbage collector.

Each request is granted, or refused with a reason. After a refusal the node continues without the
setting: it is late now and then, as ``mpc/stats`` shows.
"""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Callable
from pathlib import Path

from quad_mpc_ros.control.config import RealtimeParameters

_MLOCK_CURRENT, _MLOCK_FUTURE = 1, 2
_LIMITS = "set it for your user in /etc/security/limits.conf and log in again, or in a container"


def apply(wanted: RealtimeParameters) -> list[str]:
    """Request the settings from the operating system; return a message for each refusal."""
    refusals: list[str] = []
    if wanted.lock_memory:
        hint = f"it needs a memlock limit of unlimited: {_LIMITS} --ulimit memlock=-1"
        refusals += _refusal(_lock_memory, "lock_memory", hint)
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
    """Give real-time priority to all threads of this process, also those of the middleware."""
    for task in Path("/proc/self/task").iterdir():
        os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(priority))


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MLOCK_CURRENT | _MLOCK_FUTURE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def freeze_gc() -> None:
    """Exclude all present objects from garbage collection.

    A full collection in flight would take milliseconds to visit them.
    """
    gc.collect()
    gc.freeze()


def free_memory() -> None:
    """Free all unused objects, also excluded ones."""
    gc.unfreeze()
    for _ in range(3):  # freed objects may release others
        if not gc.collect():
            break


class GarbageCollection:
    """Garbage collection between control steps instead of at arbitrary times.

    A collection visits only objects created since :func:`freeze_gc`, and is short.
    """

    _TICKS = 50

    def __init__(self, *, between_ticks: bool) -> None:
        self._between_ticks = between_ticks
        self._ticks = 0
        if between_ticks:
            gc.disable()

    def after_tick(self) -> None:
        """Collect periodically; called after the command was published."""
        self._ticks += 1
        if self._between_ticks and self._ticks % self._TICKS == 0:
            gc.collect()
