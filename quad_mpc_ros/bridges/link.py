"""The last that was heard of the stack, while it is worth anything."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")


class Link(Generic[T]):
    """Holds the newest status for ``timeout`` seconds."""

    def __init__(self, *, timeout: float) -> None:
        self._timeout_ns = round(timeout * 1e9)
        self._value: T | None = None
        self._received_ns = 0

    def receive(self, value: T, *, now_ns: int) -> None:
        """Take a status that arrives now."""
        self._value, self._received_ns = value, now_ns

    def value(self, *, now_ns: int) -> T | None:
        """Return the newest status, or None when it is too old or there is none.

        One that comes from the future is of before the clock was set back: nobody knows how old.
        """
        return self._value if abs(now_ns - self._received_ns) <= self._timeout_ns else None
