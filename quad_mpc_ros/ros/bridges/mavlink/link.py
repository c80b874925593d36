"""What is known of the vehicle at the other end: its clock and its settings."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

_SECOND = 1_000_000_000
_QUESTIONS = 10  # about a parameter, or about the time at once
_ASKED_AGAIN_NS = 300_000_000


class VehicleTime:
    """The vehicle's clock on ours, by TIMESYNC.

    The vehicle read its clock between question and answer. So every answer, also one that took
    long, bounds the offset from both sides, whatever the drift of a simulation's clock.
    """

    def __init__(self) -> None:
        self.behind_ns = 0
        """By how much it is behind ours; 0 while that is unknown."""
        self._is_known = False
        self._asked: deque[int] = deque(maxlen=_QUESTIONS)

    def asked(self, *, now_ns: int) -> None:
        """Note that it is asked now."""
        self._asked.append(now_ns)

    def answered(self, *, sent_ns: int, vehicle_ns: int, now_ns: int) -> None:
        """Take an answer, unless it answers no question of ours."""
        if sent_ns not in self._asked or not 0 <= now_ns - sent_ns <= _SECOND:
            return
        least_ns, most_ns = sent_ns - vehicle_ns, now_ns - vehicle_ns
        middle_ns = (least_ns + most_ns) // 2
        if not self._is_known or abs(self.behind_ns - middle_ns) > _SECOND:
            self.behind_ns, self._is_known = middle_ns, True
        self.behind_ns = min(max(self.behind_ns, least_ns), most_ns)


class Settings:
    """The parameters of the vehicle that matter, as far as it has told them."""

    def __init__(self, names: Sequence[str]) -> None:
        self.values: dict[str, float] = {}
        self._questions = dict.fromkeys(names, 0)
        self._asked_ns: int | None = None

    @property
    def are_settled(self) -> bool:
        """Whether each has come, or has been asked for in vain."""
        return all(
            name in self.values or count >= _QUESTIONS for name, count in self._questions.items()
        )

    def due(self, *, now_ns: int) -> list[str]:
        """Return the names to ask for now."""
        if self._asked_ns is not None and abs(now_ns - self._asked_ns) < _ASKED_AGAIN_NS:
            return []
        missing = [
            name
            for name, count in self._questions.items()
            if name not in self.values and count < _QUESTIONS
        ]
        self._asked_ns = now_ns
        for name in missing:
            self._questions[name] += 1
        return missing

    def receive(self, name: str, value: float) -> bool:
        """Take a parameter; return whether it matters and is another than before."""
        if name not in self._questions or self.values.get(name) == value:
            return False
        self.values[name] = value
        return True
