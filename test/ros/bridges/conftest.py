"""Messages of the stacks, and bridges as processes of their own."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fixtures.processes import end
from fixtures.setup_py import executable
from fixtures.stack_messages import new_message, sound_message


@pytest.fixture(scope="session")
def new() -> Callable[[str], Any]:
    """Make empty messages and requests by type name."""
    return new_message


@pytest.fixture(scope="session")
def sound() -> Callable[[str, int], Any]:
    """Make messages of the stacks by type name and stamp [ns], as they are when all is well."""
    return sound_message


@pytest.fixture(scope="session")
def matching() -> float:
    """How long [s] until a client that has found its service has been found by it.

    Before that it would get no answer.
    """
    return 0.3


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Start nodes by executable, like ``mpc_node``, and arguments; they end with the test."""

    with ExitStack() as stack:

        def started(name: str, *arguments: str) -> subprocess.Popen[bytes]:
            log = stack.enter_context((tmp_path / f"{name}.log").open("wb"))
            command = [*executable(name), "--ros-args", *arguments]
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
            stack.callback(end, process)
            return process

        yield started
