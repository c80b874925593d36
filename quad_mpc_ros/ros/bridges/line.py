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
        self._attempted_s = -math.inf

    @abstractmethod
    def read(self) -> bytes:
        """Return the received bytes."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send; data that cannot be sent at once are dropped, because newer data follow."""

    @abstractmethod
    def close(self) -> None:
        """Close the line."""

    @abstractmethod
    def _open(self) -> None:
        """Open the line; raises ``OSError`` or ``ValueError``."""

    def _reconnect(self) -> bool:
        """Try to open the line, at most once a second; return whether it is open."""
        now = time.monotonic()
        if now - self._attempted_s < RECONNECT_PERIOD:
            return False
        self._attempted_s = now
        try:
            self._open()
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
        self._port: Any = None

    def read(self) -> bytes:
        """Return the received bytes."""
        if self._port is None and not self._reconnect():
            return b""
        try:
            return bytes(self._port.read(self._port.in_waiting))
        except OSError as error:  # also pyserial's errors
            self._disconnect(error)
            return b""

    def write(self, data: bytes) -> None:
        """Send; data that the port cannot take at once are dropped, because newer data follow."""
        if self._port is None or not data:
            return
        try:
            self._port.write(data)
        except self._serial.SerialTimeoutException:
            self._port.reset_output_buffer()
        except OSError as error:
            self._disconnect(error)

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _open(self) -> None:
        self._serial = importlib.import_module("serial")
        self._port = self._serial.Serial(
            self._name, self._baud, timeout=0, write_timeout=0.01, exclusive=True
        )


class NetworkLine(ReconnectingLine):
    """A UDP or TCP connection."""

    def __init__(self, device: str) -> None:
        address = address_of(device)
        if address is None:
            raise ValueError(f"{device}: expected a protocol, a host and a port")
        super().__init__(device)
        self._address = address
        self._is_server, self._is_stream = device.startswith("udpin:"), device[0] == "t"
        self._socket: socket.socket | None = None
        self._caller: tuple[tuple[str, int], float] | None = None  # with its last time

    def read(self) -> bytes:
        """Return the received bytes."""
        data = b""
        while len(data) < _MAX_READ_BYTES:
            if self._socket is None and not self._reconnect():
                break
            assert self._socket is not None
            try:
                if self._is_server:
                    piece, caller = self._socket.recvfrom(_MAX_DATAGRAM_BYTES)
                    if not self._accepts(caller):
                        continue
                else:
                    piece = self._socket.recv(_MAX_DATAGRAM_BYTES)
            except BlockingIOError:
                break
            except OSError as error:  # ConnectionRefused of UDP: no receiver yet
                self._disconnect(error)
                break
            if self._is_stream and not piece:
                self._disconnect(ConnectionResetError("closed by the other end"))
                break
            data += piece
        return data

    def write(self, data: bytes) -> None:
        """Send; data that cannot be sent at once are dropped, because newer data follow."""
        if self._socket is None or not data:
            return
        try:
            if self._is_server:
                if self._caller is not None:
                    self._socket.sendto(data, self._caller[0])
            else:
                self._socket.send(data)
        except BlockingIOError:
            pass
        except OSError as error:
            self._disconnect(error)

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _open(self) -> None:
        if self._is_stream:
            self._socket = socket.create_connection(self._address, timeout=_CONNECT_TIMEOUT)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            (self._socket.bind if self._is_server else self._socket.connect)(self._address)
        self._socket.setblocking(False)

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
