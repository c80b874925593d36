"""A serial port, by pyserial."""

from __future__ import annotations

import importlib
from typing import Any

from quad_mpc_ros.ros.bridges.bridge import Line
from quad_mpc_ros.ros.bridges.line import ReopenedLine


class SerialLine(ReopenedLine):
    """A serial port."""

    def __init__(self, line: Line) -> None:
        super().__init__(line.device)
        self._serial = importlib.import_module("serial")
        self._line = line
        self._port: Any = None

    def read(self) -> bytes:
        """Return what has come."""
        if self._port is None and not self._is_reopened():
            return b""
        try:
            return bytes(self._port.read(self._port.in_waiting))
        except OSError as error:  # of which pyserial's own are
            self._lose(error)
            return b""

    def write(self, data: bytes) -> None:
        """Send; what the port cannot take at once is dropped, as newer data follow."""
        if self._port is None or not data:
            return
        try:
            self._port.write(data)
        except self._serial.SerialTimeoutException:
            self._port.reset_output_buffer()
        except OSError as error:
            self._lose(error)

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _open(self) -> None:
        self._port = self._serial.Serial(
            self._line.device, self._line.baud, timeout=0, write_timeout=0.01, exclusive=True
        )
