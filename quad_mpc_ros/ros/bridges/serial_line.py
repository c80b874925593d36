"""A serial port that may disappear: nothing is read or sent meanwhile, and it is reopened."""

from __future__ import annotations

import importlib
import time
from typing import Any

from quad_mpc_ros.ros.bridges.bridge import Line

_AGAIN = 1.0  # s


class SerialLine:
    """Reads and writes without waiting, by pyserial; ``fault`` is why it cannot."""

    def __init__(self, line: Line) -> None:
        self.fault = ""
        self._serial = importlib.import_module("serial")
        self._line = line
        self._port: Any = None
        self._tried: float | None = None

    def read(self) -> bytes:
        """Return what has come."""
        if self._port is None and not self._open():
            return b""
        try:
            return bytes(self._port.read(self._port.in_waiting))
        except (OSError, self._serial.SerialException) as error:
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
        except (OSError, self._serial.SerialException) as error:
            self._lose(error)

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _open(self) -> bool:
        now = time.monotonic()
        if self._tried is not None and now - self._tried < _AGAIN:
            return False
        self._tried = now
        try:
            self._port = self._serial.Serial(
                self._line.device, self._line.baud, timeout=0, write_timeout=0.01, exclusive=True
            )
        except (OSError, ValueError, self._serial.SerialException) as error:
            self.fault = f"{self._line.device}: {error}"
            return False
        self.fault = ""
        return True

    def _lose(self, error: Exception) -> None:
        self.fault = f"{self._line.device}: {error}"
        self.close()
