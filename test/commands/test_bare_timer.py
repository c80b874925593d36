"""The process that only wakes, held up on purpose."""

from __future__ import annotations

import os
import signal
import time

from quad_mpc_ros.commands.soak.bare_timer import BareTimer


def test_a_machine_that_stands_still_is_noticed_and_when() -> None:
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
    assert wakes.asleep((began_ns + ended_ns) // 2, margin=0.0)
    assert wakes.asleep(ended_ns + 50_000_000, margin=0.1)
    assert not wakes.asleep(began_ns - 60_000_000_000, margin=0.1)


def test_one_that_did_not_live_tells_nothing() -> None:
    timer = BareTimer(0.02)
    os.kill(timer.pid, signal.SIGKILL)
    assert timer.stop() is None
