"""Changes of live parameters, good and bad ones in turn."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from quad_mpc_ros.control.config import MpcConfig


class Change(NamedTuple):
    """Parameters of the mpc that are set together; a bad one must be refused as a whole."""

    values: Mapping[str, Any]
    good: bool


_BAD: Sequence[Mapping[str, Any]] = (
    {"Q": [1.0, 2.0]},
    {"R": [0.0, 0.001, 0.001, -0.001]},
    {"Q": [float("nan")] * 9},
    {"omega_max": [0.0, 1.0, 1.0]},
    {"throttle_min": 0.9},  # leaves no throttle to hover
    # A good one does not come through beside a bad one.
    {"omega_max": [1.0, 1.0, 1.0], "throttle_max": 2.0},
)


def good_changes(config: MpcConfig) -> Iterator[Change]:
    """Yield endlessly what one tunes in flight: weights and bounds, and back."""
    given = {"Q": list(config.Q), "omega_max": list(config.omega_max)}
    other = {"Q": [1.5 * q for q in config.Q], "omega_max": [0.8 * w for w in config.omega_max]}
    return itertools.cycle((Change(other, good=True), Change(given, good=True)))


def good_and_bad_changes(config: MpcConfig) -> Iterator[Change]:
    """Yield endlessly good changes and, between them, all that must be refused."""
    good = good_changes(config)
    for bad in itertools.cycle(_BAD):
        yield next(good)
        yield Change(bad, good=False)
