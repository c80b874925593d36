# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Give every test a ROS domain of its own on the loopback, and shared fixtures."""

from __future__ import annotations

import fcntl
import gc
import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Before anything imports NumPy: its threads gain nothing on small matrices but wait for others.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Nodes that tests start are to be those that are installed, as the tests' own imports are, and not
# those of the folder where they are started.
os.environ["PYTHONSAFEPATH"] = "1"

# Before anything imports rclpy. A free domain per run, so that two runs on one machine do not
# discover each other.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


def _is_empty(domain: int) -> bool:
    """Whether a domain has no participants: each participant has a port by its number."""
    for participant in range(12):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            except OSError:
                return False
    return True


def _free_domains(most: int) -> list[int]:
    """Return domains without nodes, kept from other runs by locks as long as this one lasts."""
    free: list[int] = []
    for domain in range(20, 100):
        path = Path(tempfile.gettempdir(), f"quad_mpc_ros_test_domain_{domain}.lock")
        try:
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:  # another user's
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        if not _is_empty(domain):
            os.close(lock)
            continue
        free.append(domain)
        if len(free) == most:
            break
    if not free:
        raise RuntimeError("no free ROS domain between 20 and 99")
    return free


class _Domains:
    """The domains of this process, each of which may have to rest before it is taken again.

    Another one after each test: of what a test leaves in its process, as long as anything refers
    to it, the participant lives on, and counts as a node without endpoints. Discovery
    reports a killed process for 20 s.
    """

    most = 14  # of 80, so that five processes can run tests at once
    _rest = 25.0  # s
    _longest = 60.0  # s, of waiting for an empty one

    def __init__(self, numbers: Iterable[int]) -> None:
        self._ready_at = dict.fromkeys(numbers, 0.0)  # longest not taken first; in monotonic s

    def take(self) -> int:
        """Return the next domain that has rested and is empty, after waiting for one."""
        give_up = time.monotonic() + self._longest
        while True:
            now = time.monotonic()
            rested = [each for each, at in self._ready_at.items() if at <= now]
            empty = (each for each in rested if _is_empty(each))
            # Rather a test that fails than one that never begins.
            late = rested[0] if rested and now > give_up else None
            number = next(empty, late)
            if number is not None:
                del self._ready_at[number]
                return number
            gc.collect()  # what a test left may be what keeps them
            time.sleep(0.1)

    def give_back(self, number: int, *, rests: bool) -> None:
        """Take one back, which may have nodes of killed processes in it if it is to rest."""
        self._ready_at[number] = time.monotonic() + (self._rest if rests else 0.0)


_domains = _Domains(())
_SOON = 0.005  # s; what ended so soon made no nodes
_starts_of_processes = 0


def _count_starts(event: str, _arguments: object) -> None:
    global _starts_of_processes
    _starts_of_processes += event in {"subprocess.Popen", "os.fork", "os.posix_spawn"}


def pytest_configure(config: pytest.Config) -> None:
    """Take domains, but where other processes run the tests."""
    global _domains
    # A shell that starts this in its background has it ignored, and every process started here
    # inherits that: tests that interrupt one would wait for ever.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    distributes = getattr(config.option, "numprocesses", None)
    if not distributes or hasattr(config, "workerinput"):
        _domains = _Domains(_free_domains(_Domains.most))
        os.environ["ROS_DOMAIN_ID"] = str(_domains.take())
        sys.addaudithook(_count_starts)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Generator[None, object, object]:
    """Go to the next domain after a test that may have made nodes."""
    began, before = time.monotonic(), _starts_of_processes
    domain = int(os.environ["ROS_DOMAIN_ID"])
    result = yield
    if time.monotonic() - began > _SOON:
        _domains.give_back(domain, rests=_starts_of_processes > before)
        os.environ["ROS_DOMAIN_ID"] = str(_domains.take())
    return result


@pytest.fixture(scope="module")
def another_domain() -> Iterator[Callable[[], str]]:
    """Return ROS domains beside the test's own, for what runs meanwhile."""
    taken: list[int] = []

    def another() -> str:
        taken.append(_domains.take())
        return str(taken[-1])

    yield another
    for number in taken:
        _domains.give_back(number, rests=True)


# How long an example takes is the machine's business.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")

pytest_plugins = [
    "fixtures.bags",
    "fixtures.controller",
    "fixtures.own_package",
    "fixtures.recorded_flights",
    "fixtures.setup_py",
]


def pytest_sessionstart(session: pytest.Session) -> None:
    """Where tests run on several processes, compile everything before those start.

    Both would do it at once, and nodes that wait for each other meanwhile.
    """
    option = session.config.option
    if not getattr(option, "numprocesses", None) or option.collectonly:
        return
    from quad_mpc_ros.cli import main

    assert main(["compile"]) == 0
