"""A UDP or TCP connection in place of a serial line, under the names that MAVLink tools use.

``udpin:HOST:PORT`` waits to be called, and answers who calls; ``udpout:HOST:PORT`` and
``tcp:HOST:PORT`` call.
"""

from __future__ import annotations

import socket
import time

from quad_mpc_ros.ros.bridges.bridge import Line
from quad_mpc_ros.ros.bridges.line import ReopenedLine
from quad_mpc_ros.ros.bridges.serial_line import SerialLine

NETWORK = "udpin:", "udpout:", "tcp:"
_CONNECTING = 0.2  # s: nothing else happens meanwhile
_QUIET = 3.0  # s, after which another caller is answered
_MOST = 65536  # bytes of one reading; what is left comes with the next
_LARGEST = 2048  # bytes of a datagram


def address_of(device: str) -> tuple[str, int] | None:
    """Return host and port of ``udpin:HOST:PORT`` and the like; None for what is none."""
    parts = device.split(":")
    if len(parts) != 3 or not parts[2].isdecimal() or not 0 < int(parts[2]) < 65536:
        return None
    return parts[1], int(parts[2])


def open_line(line: Line) -> ReopenedLine:
    """Return the line to a device: a serial port, or a connection."""
    return NetworkLine(line) if line.device.startswith(NETWORK) else SerialLine(line)


class NetworkLine(ReopenedLine):
    """A UDP or TCP connection."""

    def __init__(self, line: Line) -> None:
        address = address_of(line.device)
        if address is None:
            raise ValueError(f"{line.device}: expected a kind, a host and a port")
        super().__init__(line.device)
        self._address = address
        self._waits, self._is_stream = line.device.startswith("udpin:"), line.device[0] == "t"
        self._socket: socket.socket | None = None
        self._caller: tuple[tuple[str, int], float] | None = None  # and when it was heard

    def read(self) -> bytes:
        """Return what has come."""
        data = b""
        while len(data) < _MOST:
            if self._socket is None and not self._is_reopened():
                break
            assert self._socket is not None
            try:
                if self._waits:
                    piece, caller = self._socket.recvfrom(_LARGEST)
                    if not self._is_heard(caller):
                        continue
                else:
                    piece = self._socket.recv(_LARGEST)
            except BlockingIOError:
                break
            except OSError as error:  # ConnectionRefused of UDP: nobody is there yet
                self._lose(error)
                break
            if self._is_stream and not piece:
                self._lose(ConnectionResetError("closed by the other end"))
                break
            data += piece
        return data

    def write(self, data: bytes) -> None:
        """Send; what cannot be taken at once is dropped, as newer data follow."""
        if self._socket is None or not data:
            return
        try:
            if self._waits:
                if self._caller is not None:
                    self._socket.sendto(data, self._caller[0])
            else:
                self._socket.send(data)
        except BlockingIOError:
            pass
        except OSError as error:
            self._lose(error)

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _open(self) -> None:
        if self._is_stream:
            self._socket = socket.create_connection(self._address, timeout=_CONNECTING)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            (self._socket.bind if self._waits else self._socket.connect)(self._address)
        self._socket.setblocking(False)

    def _is_heard(self, caller: tuple[str, int]) -> bool:
        """Whether a datagram is of whom we talk to; another is heard once that one is silent."""
        now = time.monotonic()
        if self._caller is not None and caller != self._caller[0]:
            if now - self._caller[1] < _QUIET:
                self.fault = f"{self._name}: {caller[0]}:{caller[1]} calls as well, not heard"
                return False
            self.fault = ""
        self._caller = caller, now
        return True
