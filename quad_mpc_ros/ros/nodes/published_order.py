"""Writes messages of several topics in the order of their publication.

In simulated time an executor may deliver an odometry before the reference that the flight waited
for. Playing such a bag in lockstep would never end.
"""

from __future__ import annotations

from collections.abc import Callable

Write = Callable[[int], None]
"""Writes a message with a time of reception [ns]."""


class PublishedOrder:
    """Holds messages briefly and writes them in the order of their publication.

    The times of reception are assigned in the same order.
    """

    def __init__(self) -> None:
        self._held: list[tuple[int, int, Write]] = []  # time of publication, of reception
        self._due_ns = 0  # newest publication at the last call of write_older
        self._newest_ns = 0  # time of reception of written messages

    def add(self, published_ns: int, received_ns: int, write: Write) -> None:
        """Add a message: its time of publication (system clock), and of reception (recording)."""
        self._held.append((published_ns, received_ns, write))

    def write_older(self) -> None:
        """Write the messages published before those added since the last call.

        Call this periodically: messages late by more than a period stay out of order.
        """
        due = [each for each in self._held if each[0] <= self._due_ns]
        self._held = [each for each in self._held if each[0] > self._due_ns]
        self._due_ns = max((each[0] for each in self._held), default=0)
        self._write(due)

    def write_all(self) -> None:
        """Write all held messages."""
        held, self._held = self._held, []
        self._write(held)

    def _write(self, messages: list[tuple[int, int, Write]]) -> None:
        received = sorted(received_ns for _, received_ns, _ in messages)
        ordered = sorted(messages, key=lambda each: each[0])
        for (_, _, write), received_ns in zip(ordered, received, strict=True):
            self._newest_ns = max(received_ns, self._newest_ns)
            write(self._newest_ns)
