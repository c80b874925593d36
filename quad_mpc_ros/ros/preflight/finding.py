"""One thing that a check has found."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Level(enum.IntEnum):
    """How grave a finding is; its name is what people read."""

    OK = 0
    UNKNOWN = 1
    """Not judged: what it needs is missing."""
    WARNING = 2
    """It may fly so."""
    ERROR = 3
    """It must be mended first."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was found, and what to do about it; nothing where all is well."""

    level: Level
    sentence: str
    remedy: str = ""

    @property
    def text(self) -> str:
        """The finding in one line."""
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence


def ok(sentence: str) -> Finding:
    """Return that all is well."""
    return Finding(level=Level.OK, sentence=sentence)


def unknown(sentence: str) -> Finding:
    """Return why something could not be judged."""
    return Finding(level=Level.UNKNOWN, sentence=sentence)


def warning(sentence: str, remedy: str) -> Finding:
    """Return what may fly, and had better be looked at."""
    return Finding(level=Level.WARNING, sentence=sentence, remedy=remedy)


def error(sentence: str, remedy: str) -> Finding:
    """Return what must be mended before a flight."""
    return Finding(level=Level.ERROR, sentence=sentence, remedy=remedy)
