"""The figures of the controller's ticks, as they were recorded."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import get_type_hints

from quad_mpc_ros.bags import BagError, RecordedMessage
from quad_mpc_ros.control.stats import TickStats
from quad_mpc_ros.ros import conversions
from quad_mpc_ros.ros.topics import STATS


def recorded_stats(bag: Path, messages: Sequence[RecordedMessage]) -> list[TickStats]:
    """Return the figures of each tick. Raises :class:`BagError` for messages without them."""
    kinds = get_type_hints(TickStats)
    # Those that came later have a default: a bag of an earlier version has them not.
    later = {
        field.name
        for field in dataclasses.fields(TickStats)
        if field.default is not dataclasses.MISSING
    }
    ticks = []
    for message in messages:
        told = conversions.stats_from_message(message.message)
        try:
            values = {
                name: kind(told[name])
                for name, kind in kinds.items()
                if name in told or name not in later
            }
        except (KeyError, ValueError) as error:
            raise BagError(f"{bag}: unusable message on /{STATS.name}: {error}") from error
        if not (
            math.isfinite(values["odom_age_ms"]) and math.isfinite(values["reference_age_ms"])
        ):
            raise BagError(f"{bag}: unusable message on /{STATS.name}: an age is not finite")
        ticks.append(TickStats(**values))
    return ticks
