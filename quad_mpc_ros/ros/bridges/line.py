"""A line to a stack that may be lost: nothing passes meanwhile, and it is opened again."""

from __future__ import annotations

import contextlib
import math
import time
from abc import ABC, abstractmethod

AGAIN = 1.0  # s


class ReopenedLine(ABC):
    """Reads and writes without waiting; ``fault`` is why it cannot."""

    def __init__(self, name: str) -> None:
        self.fault = ""
        self._name = name
        self._tried = -math.inf

    @abstractmethod
    def read(self) -> bytes:
        """Return what has come."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send; what cannot be taken at once is dropped, as newer data follow."""

    @abstractmethod
    def close(self) -> None:
        """Close it."""

    @abstractmethod
    def _open(self) -> None:
        """Open it; raises ``OSError`` or ``ValueError``."""

    def _is_reopened(self) -> bool:
        """Open it, once a second at most; return whether it is open."""
        now = time.monotonic()
        if now - self._tried < AGAIN:
            return False
        self._tried = now
        try:
            self._open()
        except (OSError, ValueError) as error:
            self._lose(error)
            return False
        self.fault = ""
        return True

    def _lose(self, error: Exception) -> None:
        self.fault = f"{self._name}: {error}"
        with contextlib.suppress(OSError):
            self.close()
