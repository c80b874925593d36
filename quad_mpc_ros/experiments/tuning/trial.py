"""One configuration that was tried, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

FLOWN, GIVEN_UP, REFUSED = "flown", "given up", "refused"
"""What becomes of a trial: flown to the end, given up on the way, or a configuration that is none.
"""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One configuration and what came of it.

    Attributes:
        number: Its place in the study; 0 is the campaigns' own configuration.
        values: The values of what is searched, by its names.
        outcome: :data:`FLOWN`, :data:`GIVEN_UP` or :data:`REFUSED`.
        objectives: The values of the objectives, of one given up by the flights until then; none
            of one refused.
        reason: Why it was refused, or why trial 0 is not in the search space.
        flights: How many were flown.
        lost: How many of them were lost.
        seconds: How long that took.
    """

    number: int
    values: Mapping[str, Any]
    outcome: str
    objectives: tuple[float, ...]
    reason: str
    flights: int
    lost: int
    seconds: float
