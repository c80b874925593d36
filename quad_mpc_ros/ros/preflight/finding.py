"""A finding of a preflight check."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Level(enum.IntEnum):
    """Severity of a finding; its name is printed."""

    OK = 0
    UNKNOWN = 1
    """Not checked: facts are missing."""
    WARNING = 2
    """The vehicle may fly."""
    ERROR = 3
    """Must be fixed before the flight."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A finding and its remedy, empty if unnecessary."""

    level: Level
    sentence: str
    remedy: str = ""

    @property
    def text(self) -> str:
        """The finding in one line."""
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence


def ok(sentence: str) -> Finding:
    """Return a finding without problem."""
    return Finding(level=Level.OK, sentence=sentence)


def unknown(sentence: str) -> Finding:
    """Return a finding for a check with missing facts."""
    return Finding(level=Level.UNKNOWN, sentence=sentence)


def warning(sentence: str, remedy: str) -> Finding:
    """Return a warning."""
    return Finding(level=Level.WARNING, sentence=sentence, remedy=remedy)


def error(sentence: str, remedy: str) -> Finding:
    """Return an error, which must be fixed before the flight."""
    return Finding(level=Level.ERROR, sentence=sentence, remedy=remedy)
