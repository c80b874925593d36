"""The process that only wakes, held up on purpose."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from subprocess import PIPE

from quad_mpc_ros.commands.soak import bare_timer
from quad_mpc_ros.commands.soak.bare_timer import BareTimer, Wakes


def test_reports_when_the_machine_stalled() -> None:
    timer = BareTimer(0.02)
    time.sleep(1.0)  # until it runs
    began_ns = time.time_ns()
    os.kill(timer.pid, signal.SIGSTOP)
    time.sleep(0.5)
    os.kill(timer.pid, signal.SIGCONT)
    ended_ns = time.time_ns()
    time.sleep(0.5)
    wakes = timer.stop()

    assert wakes is not None
    assert wakes.count > 40
    assert wakes.latest > 400.0
    assert any(
        begin <= (began_ns + ended_ns) / 2 <= end and end - begin < 10e9
        for begin, end in wakes.stalls(margin=0.0)
    )


def test_overlapping_stalls_are_merged() -> None:
    second, ms = 1_000_000_000, 1e3
    wakes = Wakes(count=100, late=[(20 * second, 1 * ms), (12 * second, 2 * ms), (9 * second, ms)])
    assert wakes.stalls(margin=0.5) == [
        (7.5 * second, 12.5 * second),
        (18.5 * second, 20.5 * second),
    ]


def test_a_killed_timer_returns_nothing() -> None:
    timer = BareTimer(0.02)
    os.kill(timer.pid, signal.SIGKILL)
    assert timer.stop() is None


def test_a_timer_whose_reader_has_been_interrupted_ends_in_silence() -> None:
    command = [sys.executable, "-P", "-m", bare_timer.__name__, "0.02"]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE) as timer:
        assert timer.stdin and timer.stdout and timer.stderr
        timer.stdout.close()
        timer.stdin.close()
        assert (timer.stderr.read(), timer.wait(10)) == (b"", 0)
