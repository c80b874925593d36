# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A line over UDP and TCP sends without a receiver and reconnects."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from quad_mpc_ros.ros.bridges import line as line_module
from quad_mpc_ros.ros.bridges.line import NetworkLine


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_module, "RECONNECT_PERIOD", 0.02)


@contextlib.contextmanager
def opened(device: str) -> Iterator[NetworkLine]:
    line = NetworkLine(device)
    yield line
    line.close()


@pytest.fixture
def other() -> Iterator[socket.socket]:
    """Return a UDP socket of the other end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(5.0)
        yield made


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def until(done: Callable[[], object]) -> bool:
    deadline = time.monotonic() + 5.0
    while not done():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


def test_answers_the_first_sender_until_it_is_silent(
    other: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = free_port()
    with opened(f"udpin:127.0.0.1:{port}") as line, socket.socket(type=socket.SOCK_DGRAM) as third:
        line.read()
        line.write(b"no receiver yet")
        other.sendto(b"one", ("127.0.0.1", port))
        assert until(lambda: line.read() == b"one")
        third.sendto(b"stranger", ("127.0.0.1", port))
        assert until(lambda: line.read() == b"" and "also sends" in line.fault)
        line.write(b"two")
        assert other.recv(100) == b"two"
        monkeypatch.setattr(line_module, "_CALLER_TIMEOUT", 0.0)
        third.sendto(b"three", ("127.0.0.1", port))
        assert until(lambda: line.read() == b"three") and line.fault == ""


def test_sends_by_udp_without_a_receiver(other: socket.socket) -> None:
    port = other.getsockname()[1]
    other.close()
    with opened(f"udpout:127.0.0.1:{port}") as line:
        line.read()
        for _ in range(3):
            line.write(b"anybody?")
            line.read()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
            late.bind(("127.0.0.1", port))
            late.settimeout(0.2)

            def came() -> bool:
                line.read()
                line.write(b"hello")
                with contextlib.suppress(TimeoutError):
                    return late.recv(100) == b"hello"
                return False

            assert until(came)
            late.sendto(b"yes", line_address(line))
            assert until(lambda: line.read() == b"yes")


def line_address(line: NetworkLine) -> tuple[str, int]:
    host, port = line._end.getsockname()
    return host, port


def test_reconnects_by_tcp() -> None:
    port = free_port()
    with opened(f"tcp:127.0.0.1:{port}") as line:
        assert line.read() == b"" and "refused" in line.fault
        for text in (b"first", b"second"):
            with socket.create_server(("127.0.0.1", port)) as server:
                server.settimeout(0.2)
                ends: list[socket.socket] = []

                def accepted(server: socket.socket = server, ends: list = ends) -> bool:
                    line.read()
                    with contextlib.suppress(TimeoutError):
                        ends.append(server.accept()[0])
                    return bool(ends)

                assert until(accepted) and line.fault == ""
                with ends[0] as end:
                    end.sendall(text)
                    assert until(lambda text=text: line.read() == text)
                    line.write(text)
                    assert end.recv(100) == text
            assert until(lambda: line.read() == b"" and line.fault != "")


def test_a_read_ends_despite_continuous_input(other: socket.socket) -> None:
    port = free_port()
    with opened(f"udpin:127.0.0.1:{port}") as line:
        line.read()
        for _ in range(200):
            other.sendto(bytes(2000), ("127.0.0.1", port))
        assert until(lambda: 0 < len(line.read()) <= line_module._MAX_READ_BYTES + 2048)
