"""How many of how many, and how well that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.stats import binomtest


@dataclass(frozen=True, kw_only=True)
class Proportion:
    """``count`` of ``total``; there may be none."""

    count: int
    total: int

    @property
    def share(self) -> float:
        """The share, 0 to 1; NaN of none."""
        return self.count / self.total if self.total else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the share (E. B. Wilson, 1927); 0 to 1 of none."""
        if not self.total:
            return 0.0, 1.0
        test = binomtest(self.count, self.total)
        low, high = test.proportion_ci(confidence_level=0.95, method="wilson")
        return float(low), float(high)

    def __str__(self) -> str:
        if not self.total:
            return "none of 0"
        low, high = self.interval
        return (
            f"{self.count} of {self.total}, {_percent(self.share)} % "
            f"({_percent(low)} to {_percent(high)} %)"
        )


def _percent(share: float) -> str:
    return f"{100 * share:.1f}" if share < 0.1 else f"{100 * share:.0f}"
