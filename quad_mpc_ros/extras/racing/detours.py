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
from quad_mpc_ros.extras.racing.live_race import Detour, LiveRace, Way, description, smooth_part
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi_fault
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.director import TOO_LATE, Reply
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.motion_table import MotionTable
from quad_mpc_ros.references.timeline import Phase

_LEAD = 1.0  # s: from now to where a new way begins; more where making one took longer
_LONGER = 1.5
_PAUSE_NS = 1_000_000_000  # after a way that could not be made
_NICENESS = 5  # controllers come first
_KEPT = "keeping the current path"


class _Asked(NamedTuple):
    """What is being made, for which phase of the flight, and since when [s]."""

    detour: Detour
    phase: Phase
    since: float


class Detours:
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
        self._maker: _Maker | None = None
        self._asked: _Asked | None = None
        self._lead, self._not_before_ns = _LEAD, -(2**62)
        self._missed: set[int] = set()

    def move(self, p_WG: Array, q_WG_xyzw: Array) -> None:
        """Take where the gates are by now; takes and raises as :meth:`.Course.moved`."""
        self._race.move(p_WG, q_WG_xyzw)
        if self._maker is None:
            self._maker = _Maker(self._config)

    def poll(self, now_ns: int) -> Reply | None:
        """Replan where a gate ahead has moved, and fly that; return a message for the log."""
        reply, phase = self._finished(now_ns), self._live.last_phase
        if self._maker is None or phase is None or self._asked is not None:
            return reply
        seconds = 1e-9 * (now_ns - phase.start_ns)
        if now_ns >= self._not_before_ns and self._maker.is_ready(wait=self._waits):
            detour = self._race.detour(phase.trajectory, seconds + self._lead)
            if detour is not None:
                self._maker.ask(detour)
                self._asked = _Asked(detour, phase, time.monotonic())
                return reply or self._finished(now_ns)
        return reply or self._too_late(phase, seconds)

    def _too_late(self, phase: Phase, seconds: float) -> Reply | None:
        """Tell once of each gate that has moved and is passed before another way could begin."""
        missed = self._race.missed(phase.trajectory, seconds, seconds + self._lead)
        news = {number: far for number, far in missed.items() if number not in self._missed}
        self._missed = set(missed)
        if not news:
            return None
        return Reply(accepted=False, text=f"{description(news)}: too near; {_KEPT}")

    def close(self) -> None:
        """End the process."""
        if self._maker is not None:
            self._maker.close()
        self._maker = self._asked = None

    def _finished(self, now_ns: int) -> Reply | None:
        """Fly what has been made."""
        if self._asked is None or self._maker is None:
            return None
        answer = self._maker.answer(wait=self._waits)
        if answer is None:
            return None
        (detour, phase, since), self._asked = self._asked, None
        if not self._waits:
            self._lead = max(_LEAD, _LONGER * (time.monotonic() - since))
        if isinstance(answer, Way):
            start_ns = phase.start_ns + round(1e9 * detour.leave_seconds)
            reply = self._live.replace_trajectory(phase, answer.trajectory, start_ns)
            if reply.accepted:
                return Reply(accepted=True, text=self._race.take(detour, answer))
            answer = reply.text
            if reply is TOO_LATE:
                return Reply(accepted=False, text=f"{detour.text()}: {answer}, trying again")
        self._not_before_ns = now_ns + _PAUSE_NS
        return Reply(accepted=False, text=f"{detour.text()}: {answer}; {_KEPT}")


class _Maker:
    """The process that makes ways; it ends with this one."""

    def __init__(self, config: ReferenceConfig) -> None:
        context = multiprocessing.get_context("spawn")
        self._line, its_end = context.Pipe()
        self._process: BaseProcess = context.Process(
            target=_make, args=(its_end, config), daemon=True
        )
        # Else the process starts it, which unblocks SIGINT.
        resource_tracker.ensure_running()
        # Ctrl-C is for the node, with which it ends; blocked before its first line runs.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        its_end.close()  # only the process holds it now
        self._ready = False

    def is_ready(self, *, wait: bool) -> bool:
        """Whether it has imported what it needs."""
        if not self._ready:
            self._ready = self.answer(wait=wait) is not None
        return self._ready

    def ask(self, detour: Detour) -> None:
        """Let it make a way."""
        with contextlib.suppress(OSError):  # it has ended: its answer says so
            self._line.send(detour)

    def answer(self, *, wait: bool) -> Way | str | None:
        """Return the way, or why there is none; None while it is being made."""
        if not (wait or self._line.poll()):
            return None
        try:
            answer: Way | str = self._line.recv()
        except (EOFError, OSError):
            return "the process that makes ways has ended"
        return answer

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.join()
        self._line.close()


def _make(line: Connection, config: ReferenceConfig) -> None:
    """Make ways, in a process of its own, until the other end is closed."""
    os.nice(_NICENESS)
    if casadi_fault() is None:  # before it is needed
        importlib.import_module("quad_mpc_ros.extras.racing.planning.detour")
    answer: Way | str = "ready"
    with contextlib.suppress(EOFError, OSError):
        while True:
            line.send(answer)
            detour: Detour = line.recv()
            try:
                answer = detour.flown(_part(detour, config), config)
            except UserError as error:
                answer = str(error)


def _part(detour: Detour, config: ReferenceConfig) -> MotionTable:
    if not detour.planned or casadi_fault() is not None:
        return smooth_part(detour, config)
    from quad_mpc_ros.extras.racing.planning.detour import (
        planned_part,  # much memory, which the node saves
    )

    return planned_part(detour)
