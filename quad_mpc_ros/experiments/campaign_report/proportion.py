"""How many of how many, and how well that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

_QUANTILE = NormalDist().inv_cdf(0.975)


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
        n, z, share = self.total, _QUANTILE, self.share
        middle = (share + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
        return max(middle - half, 0.0), min(middle + half, 1.0)

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
