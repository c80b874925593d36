"""The plans of the controller as they were recorded: where it expected to be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quad_mpc_ros.lie import Array
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import PREDICTED_PATH
from quad_mpc_ros.recordings.recorded_topics import messages_by_topic


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedPlan:
    """Positions ``p_WB`` (n, 3) [m] along one plan, from the state at which it begins."""

    stamp_ns: int
    p_WB: Array


def read_plans(bag: Path, *, end_ns: int) -> list[RecordedPlan]:
    """Return the plans stamped up to the end, in order of stamps; none when none was recorded.

    What is not finite is left out. Raises :class:`BagError` as the reader of the bag does.
    """
    messages = messages_by_topic(bag, (PREDICTED_PATH,))[PREDICTED_PATH]
    plans = [
        RecordedPlan(
            stamp_ns=conversions.nanoseconds(message.message.header.stamp),
            p_WB=conversions.positions_from_path(message.message),
        )
        for message in messages
    ]
    return sorted(
        (plan for plan in plans if plan.stamp_ns <= end_ns and np.all(np.isfinite(plan.p_WB))),
        key=lambda plan: plan.stamp_ns,
    )
