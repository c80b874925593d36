# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lines to a stack without topics: a serial port (pyserial), UDP or TCP.

``udpin:HOST:PORT`` is a server and answers its caller; ``udpout:HOST:PORT`` and ``tcp:HOST:PORT``
are clients. A line that fails is reopened.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import socket
import time
from abc import ABC, abstractmethod
from typing import Any

RECONNECT_PERIOD = 1.0  # s
NETWORK_PREFIXES = "udpin:", "udpout:", "tcp:"
_CONNECT_TIMEOUT = 0.2  # s, during which the node is blocked
_CALLER_TIMEOUT = 3.0  # s, after which another caller is accepted
_MAX_READ_BYTES = 65536  # in one call of read
_MAX_DATAGRAM_BYTES = 2048


def address_of(device: str) -> tuple[str, int] | None:
    """Return host and port of ``udpin:HOST:PORT`` and the like; None for other texts."""
    parts = device.split(":")
    if len(parts) != 3 or not parts[2].isdecimal() or not 0 < int(parts[2]) < 65536:
        return None
    return parts[1], int(parts[2])


def line_to(device: str, baud: int) -> ReconnectingLine:
    """Return the line to a serial port, or to ``udpin:HOST:PORT`` and the like."""
    if device.startswith(NETWORK_PREFIXES):
        return NetworkLine(device)
    return SerialLine(device, baud)


class ReconnectingLine(ABC):
    """A line that reads and writes without blocking; ``fault`` is the reason if it cannot.

    The line connects when it is first read.
    """

    period = 0.005
    """Time between two reads [s]."""

    def __init__(self, name: str) -> None:
        self.fault = ""
        self._name = name
        self._end: Any = None  # the port or socket, None while the line is closed
        self._attempted_s = -math.inf

    def read(self) -> bytes:
        """Return the received bytes."""
        if self._end is None and not self._reconnect():
            return b""
        try:
            return self._receive()
        except OSError as error:  # also pyserial's errors
            self._disconnect(error)
            return b""

    def write(self, data: bytes) -> None:
        """Send; data that cannot be sent at once are dropped, because newer data follow."""
        if self._end is None or not data:
            return
        try:
            self._send(data)
        except OSError as error:
            self._disconnect(error)

    def close(self) -> None:
        """Close the line."""
        if self._end is not None:
            self._end.close()
            self._end = None

    @abstractmethod
    def _open(self) -> Any:
        """Return the opened port or socket; raises ``OSError`` or ``ValueError``."""

    @abstractmethod
    def _receive(self) -> bytes:
        """Return the received bytes; raises ``OSError``."""

    @abstractmethod
    def _send(self, data: bytes) -> None:
        """Send as :meth:`write`; raises ``OSError``."""

    def _reconnect(self) -> bool:
        """Try to open the line, at most once a second; return whether it is open."""
        now = time.monotonic()
        if now - self._attempted_s < RECONNECT_PERIOD:
            return False
        self._attempted_s = now
        try:
            self._end = self._open()
        except (OSError, ValueError) as error:
            self._disconnect(error)
            return False
        self.fault = ""
        return True

    def _disconnect(self, error: Exception) -> None:
        self.fault = f"{self._name}: {error}"
        with contextlib.suppress(OSError):
            self.close()


class SerialLine(ReconnectingLine):
    """A serial port."""

    def __init__(self, device: str, baud: int) -> None:
        super().__init__(device)
        self._baud = baud
        self._serial: Any = None

    def _open(self) -> Any:
        self._serial = importlib.import_module("serial")
        return self._serial.Serial(
            self._name, self._baud, timeout=0, write_timeout=0.01, exclusive=True
        )

    def _receive(self) -> bytes:
        return bytes(self._end.read(self._end.in_waiting))

    def _send(self, data: bytes) -> None:
        try:
            self._end.write(data)
        except self._serial.SerialTimeoutException:
            self._end.reset_output_buffer()


class NetworkLine(ReconnectingLine):
    """A UDP or TCP connection."""

    def __init__(self, device: str) -> None:
        address = address_of(device)
        if address is None:
            raise ValueError(f"{device}: expected a protocol, a host and a port")
        super().__init__(device)
        self._address = address
        self._is_server, self._is_stream = device.startswith("udpin:"), device[0] == "t"
        self._caller: tuple[tuple[str, int], float] | None = None  # with its last time

    def _open(self) -> socket.socket:
        if self._is_stream:
            end = socket.create_connection(self._address, timeout=_CONNECT_TIMEOUT)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            (end.bind if self._is_server else end.connect)(self._address)
        end.setblocking(False)
        return end

    def _receive(self) -> bytes:
        data = b""
        while len(data) < _MAX_READ_BYTES:
            try:
                piece, caller = self._end.recvfrom(_MAX_DATAGRAM_BYTES)
                if self._is_stream and not piece:
                    raise ConnectionResetError("closed by the other end")
            except OSError as error:  # ConnectionRefused of UDP: no receiver yet
                if data or isinstance(error, BlockingIOError):
                    break
                raise
            if not self._is_server or self._accepts(caller):
                data += piece
        return data

    def _send(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            if not self._is_server:
                self._end.send(data)
            elif self._caller is not None:
                self._end.sendto(data, self._caller[0])

    def _accepts(self, caller: tuple[str, int]) -> bool:
        """Return whether to accept a datagram: only one caller, until this caller is silent."""
        now = time.monotonic()
        if self._caller is not None and caller != self._caller[0]:
            if now - self._caller[1] < _CALLER_TIMEOUT:
                self.fault = f"{self._name}: {caller[0]}:{caller[1]} also sends, ignored"
                return False
            self.fault = ""
        self._caller = caller, now
        return True
