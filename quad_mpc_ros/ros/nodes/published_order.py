"""Writes messages of several topics in the order of their publication.

In simulated time an executor may deliver an odometry before the reference that the flight waited
for. Playing such a bag in lockstep would never end.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

Write = Callable[[int], None]
"""Writes a message with a time of reception [ns]."""


class _Held(NamedTuple):
    published_ns: int
    received_ns: int
    write: Write


class PublishedOrder:
    """Holds messages briefly and writes them in the order of their publication.

    The times of reception are assigned in the same order.
    """

    def __init__(self) -> None:
        self._older: list[_Held] = []
        self._newer: list[_Held] = []
        self._newest_ns = 0  # time of reception of written messages

    def add(self, published_ns: int, received_ns: int, write: Write) -> None:
        """Add a message: its time of publication (system clock), and of reception (recording)."""
        self._newer.append(_Held(published_ns, received_ns, write))

    def write_older(self) -> None:
        """Write the messages published before those added since the last call.

        Call this periodically: messages late by more than a period stay out of order.
        """
        newest_ns = max((held.published_ns for held in self._older), default=0)
        held = self._older + self._newer
        self._write([each for each in held if each.published_ns <= newest_ns])
        self._older = [each for each in held if each.published_ns > newest_ns]
        self._newer = []

    def write_all(self) -> None:
        """Write all held messages."""
        self._write(self._older + self._newer)
        self._older, self._newer = [], []

    def _write(self, messages: list[_Held]) -> None:
        received = sorted(each.received_ns for each in messages)
        messages = sorted(messages, key=lambda each: each.published_ns)
        for message, received_ns in zip(messages, received, strict=True):
            self._newest_ns = max(received_ns, self._newest_ns)
            message.write(self._newest_ns)
