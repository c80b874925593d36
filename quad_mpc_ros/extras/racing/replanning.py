"""Ways through gates that have moved, made in a process of its own and joined when they are ready.

A plan takes a second, and building its programme keeps the interpreter from all other threads for
30 ms at a time: too long for a node that publishes 50 times a second, or an MPC beside it.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import multiprocessing
import os
import signal
import time
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import NamedTuple

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.racing.gate_path import configured_course
from quad_mpc_ros.extras.racing.live_race import (
    GateTrajectory,
    LiveRace,
    ReplanRequest,
    description,
    smooth_part,
)
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi_fault
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.director import TOO_LATE, Reply
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.motion_table import MotionTable
from quad_mpc_ros.references.timeline import Phase

_MIN_LEAD_TIME = 1.0  # s: from now to where a new way begins; more where making one took longer
_LEAD_TIME_FACTOR = 1.5
_RETRY_DELAY_NS = 1_000_000_000  # after a way that could not be made
_NICENESS = 5  # controllers come first
_KEPT_TEXT = "keeping the current path"


class _PendingReplan(NamedTuple):
    """What is being made, for which phase of the flight, and since when [s]."""

    request: ReplanRequest
    phase: Phase
    since: float


class GateReplanner:
    """Leads a live reference through the gates of its race where they move.

    Args:
        config: Of the reference; its trajectory is ``gates``.
        live: What is flown.
        waits: Whether the flight's time stands still while a way is made, as in lockstep.

    Raises :class:`UserError` for a trajectory that does not pass the course.
    """

    def __init__(self, config: ReferenceConfig, live: LiveReference, *, waits: bool) -> None:
        course = configured_course(config)
        assert course is not None
        planner = importlib.util.find_spec("casadi") is not None
        self._race = LiveRace(course, live.trajectory, planner=planner)
        self._config, self._live, self._waits = config, live, waits
        self._process: _ReplanProcess | None = None
        self._pending: _PendingReplan | None = None
        self._lead_time, self._not_before_ns = _MIN_LEAD_TIME, -(2**62)
        self._missed: set[int] = set()

    def move(self, p_WG: Array, q_WG_xyzw: Array) -> None:
        """Take where the gates are by now; takes and raises as :meth:`.Course.moved`."""
        self._race.move(p_WG, q_WG_xyzw)
        if self._process is None:
            self._process = _ReplanProcess(self._config)

    def poll(self, now_ns: int) -> Reply | None:
        """Replan where a gate ahead has moved, and fly that; return a message for the log."""
        reply, phase = self._take_result(now_ns), self._live.last_phase
        if self._process is None or phase is None or self._pending is not None:
            return reply
        seconds = 1e-9 * (now_ns - phase.start_ns)
        if now_ns >= self._not_before_ns and self._process.is_ready(wait=self._waits):
            request = self._race.replan_request(phase.trajectory, seconds + self._lead_time)
            if request is not None:
                self._process.send(request)
                self._pending = _PendingReplan(request, phase, time.monotonic())
                return reply or self._take_result(now_ns)
        return reply or self._report_missed(phase, seconds)

    def _report_missed(self, phase: Phase, seconds: float) -> Reply | None:
        """Tell once of each gate that has moved and is passed before another way could begin."""
        missed = self._race.missed(phase.trajectory, seconds, seconds + self._lead_time)
        new_misses = {number: far for number, far in missed.items() if number not in self._missed}
        self._missed = set(missed)
        if not new_misses:
            return None
        return Reply(accepted=False, text=f"{description(new_misses)}: too near; {_KEPT_TEXT}")

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
        self._process = self._pending = None

    def _take_result(self, now_ns: int) -> Reply | None:
        """Fly what has been made."""
        if self._pending is None or self._process is None:
            return None
        result = self._process.result(wait=self._waits)
        if result is None:
            return None
        (request, phase, since), self._pending = self._pending, None
        if not self._waits:
            self._lead_time = max(_MIN_LEAD_TIME, _LEAD_TIME_FACTOR * (time.monotonic() - since))
        if isinstance(result, GateTrajectory):
            start_ns = phase.start_ns + round(1e9 * request.leave_seconds)
            reply = self._live.change_way(phase, result.trajectory, start_ns)
            if reply.accepted:
                return Reply(accepted=True, text=self._race.take(request, result))
            result = reply.text
            if reply is TOO_LATE:
                return Reply(accepted=False, text=f"{request.text()}: {result}, trying again")
        self._not_before_ns = now_ns + _RETRY_DELAY_NS
        return Reply(accepted=False, text=f"{request.text()}: {result}; {_KEPT_TEXT}")


class _ReplanProcess:
    """The process that makes ways; it ends with this one."""

    def __init__(self, config: ReferenceConfig) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, far_end = context.Pipe()
        self._worker: BaseProcess = context.Process(
            target=_run_replanning, args=(far_end, config), daemon=True
        )
        # Else the process starts it, which unblocks SIGINT.
        resource_tracker.ensure_running()
        # Ctrl-C is for the node, with which it ends; blocked before its first line runs.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._worker.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        far_end.close()  # only the process holds it now
        self._ready = False

    def is_ready(self, *, wait: bool) -> bool:
        """Whether it has imported what it needs."""
        if not self._ready:
            self._ready = self.result(wait=wait) is not None
        return self._ready

    def send(self, request: ReplanRequest) -> None:
        """Let it make a way."""
        with contextlib.suppress(OSError):  # it has ended: its answer says so
            self._pipe.send(request)

    def result(self, *, wait: bool) -> GateTrajectory | str | None:
        """Return the way, or why there is none; None while it is being made."""
        if not (wait or self._pipe.poll()):
            return None
        try:
            result: GateTrajectory | str = self._pipe.recv()
        except (EOFError, OSError):
            return "the process that makes ways has ended"
        return result

    def close(self) -> None:
        """End it."""
        self._worker.kill()
        self._worker.join()
        self._pipe.close()


def _run_replanning(pipe: Connection, config: ReferenceConfig) -> None:
    """Make ways, in a process of its own, until the other end is closed."""
    os.nice(_NICENESS)
    if casadi_fault() is None:  # before it is needed
        importlib.import_module("quad_mpc_ros.extras.racing.planning.replan")
    result: GateTrajectory | str = "ready"
    with contextlib.suppress(EOFError, OSError):
        while True:
            pipe.send(result)
            request: ReplanRequest = pipe.recv()
            try:
                result = request.with_part(_replanned_part(request, config), config)
            except UserError as error:
                result = str(error)


def _replanned_part(request: ReplanRequest, config: ReferenceConfig) -> MotionTable:
    if not request.planned or casadi_fault() is not None:
        return smooth_part(request, config)
    from quad_mpc_ros.extras.racing.planning.replan import (
        planned_part,  # much memory, which the node saves
    )

    return planned_part(request)
