"""The figures of the controller's ticks, as they were recorded."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_type_hints

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import diagnostics
from quad_mpc_ros.messages.topics import STATS
from quad_mpc_ros.recordings.reader import RecordedMessage

_KINDS = get_type_hints(TickStats)


def recorded_stats(bag: Path, messages: Sequence[RecordedMessage]) -> list[TickStats]:
    """Return the figures of each tick. Raises :class:`BagError` for messages without them."""
    ticks = []
    for message in messages:
        try:
            tick = tick_stats(message.message)
        except (KeyError, ValueError) as error:
            raise BagError(f"{bag}: unusable message on /{STATS.name}: {error}") from error
        if not (math.isfinite(tick.odom_age_ms) and math.isfinite(tick.reference_age_ms)):
            raise BagError(f"{bag}: unusable message on /{STATS.name}: an age is not finite")
        ticks.append(tick)
    return ticks


def tick_stats(message: Any) -> TickStats:
    """Return the figures of a message. Raises ``KeyError`` or ``ValueError`` for another's.

    Figures that an earlier version did not have take their default.
    """
    told = diagnostics.stats_from_message(message)
    values = {
        field.name: _KINDS[field.name](told[field.name])
        for field in dataclasses.fields(TickStats)
        if field.name in told or field.default is dataclasses.MISSING
    }
    return TickStats(**values)
