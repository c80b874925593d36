# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A finding of a preflight check."""

from __future__ import annotations

import enum
import functools
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


@dataclass(frozen=True)
class Finding:
    """A finding and its remedy, empty if unnecessary."""

    sentence: str
    remedy: str = ""
    level: Level = Level.OK

    @property
    def text(self) -> str:
        """The finding in one line."""
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence


ok = functools.partial(Finding, level=Level.OK)
unknown = functools.partial(Finding, level=Level.UNKNOWN)
warning = functools.partial(Finding, level=Level.WARNING)
error = functools.partial(Finding, level=Level.ERROR)
