"""Replanning of a race for moved gates, in a separate process.

A plan takes a second, and building its program blocks all other threads of a process for 30 ms:
too long for a node that publishes at 50 Hz, or for an MPC in the same process.
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

_MIN_LEAD_TIME = 1.0  # s, at least, from now to the start of a replanned part
_LEAD_TIME_FACTOR = 1.5
_RETRY_DELAY_NS = 1_000_000_000  # after a failed replanning
_NICENESS = 5  # controllers come first
_KEPT_TEXT = "keeping the current path"


class _PendingReplan(NamedTuple):
    """A request in progress, its phase of the flight, and its start [s]."""

    request: ReplanRequest
    phase: Phase
    since: float


class GateReplanner:
    """Replans a live reference for the moved gates of its race.

    Args:
        config: Parameters of the reference, with trajectory ``gates``.
        live: The live reference.
        waits: Whether time is stopped during replanning, as in lockstep.

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
        """Receive the poses of the gates; arguments and errors as :meth:`.Course.moved`."""
        self._race.move(p_WG, q_WG_xyzw)
        if self._process is None:
            self._process = _ReplanProcess(self._config)

    def poll(self, now_ns: int) -> Reply | None:
        """Replan if a gate ahead has moved, and fly a finished plan; return a log message."""
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
        """Report once each moved gate that is passed before a replanned part could start."""
        missed = self._race.missed(phase.trajectory, seconds, seconds + self._lead_time)
        new_misses = {number: far for number, far in missed.items() if number not in self._missed}
        self._missed = set(missed)
        if not new_misses:
            return None
        return Reply(accepted=False, text=f"{description(new_misses)}: too close; {_KEPT_TEXT}")

    def close(self) -> None:
        """Stop the process."""
        if self._process is not None:
            self._process.close()
        self._process = self._pending = None

    def _take_result(self, now_ns: int) -> Reply | None:
        """Fly a finished plan."""
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
            reply = self._live.replace_trajectory(phase, result.trajectory, start_ns)
            if reply.accepted:
                return Reply(accepted=True, text=self._race.take(request, result))
            result = reply.text
            if reply is TOO_LATE:
                return Reply(accepted=False, text=f"{request.text()}: {result}, trying again")
        self._not_before_ns = now_ns + _RETRY_DELAY_NS
        return Reply(accepted=False, text=f"{request.text()}: {result}; {_KEPT_TEXT}")


class _ReplanProcess:
    """The process that replans; it ends with this process."""

    def __init__(self, config: ReferenceConfig) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, far_end = context.Pipe()
        self._worker: BaseProcess = context.Process(
            target=_run_replanning, args=(far_end, config), daemon=True
        )
        # Otherwise the child process starts it, which unblocks SIGINT.
        resource_tracker.ensure_running()
        # Ctrl-C is for the node, which ends the process; blocked before its first line.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._worker.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        far_end.close()  # only the process has it open now
        self._ready = False

    def is_ready(self, *, wait: bool) -> bool:
        """Return whether the process has finished its imports."""
        if not self._ready:
            self._ready = self.result(wait=wait) is not None
        return self._ready

    def send(self, request: ReplanRequest) -> None:
        """Send a request to the process."""
        with contextlib.suppress(OSError):  # the process has ended, see result
            self._pipe.send(request)

    def result(self, *, wait: bool) -> GateTrajectory | str | None:
        """Return the trajectory, or an error; None while the process is busy."""
        if not (wait or self._pipe.poll()):
            return None
        try:
            result: GateTrajectory | str = self._pipe.recv()
        except (EOFError, OSError):
            return "the replanning process has ended"
        return result

    def close(self) -> None:
        """Stop the process."""
        self._worker.kill()
        self._worker.join()
        self._pipe.close()


def _run_replanning(pipe: Connection, config: ReferenceConfig) -> None:
    """Process requests, in a separate process, until the other end is closed."""
    os.nice(_NICENESS)
    if casadi_fault() is None:  # before the first request
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
