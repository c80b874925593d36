"""What a trajectory is: the reference as a function of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from quad_mpc_ros.core.messages import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectorySamples:
    """A trajectory at n times; world frame, as the message carries it.

    Shapes: ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``w_WB_W`` (n, 3) in m, m/s, m/s^2, rad/s;
    ``q_WB_xyzw`` (n, 4).
    """

    p_WB: Array
    q_WB_xyzw: Array
    v_WB_W: Array
    a_WB_W: Array
    w_WB_W: Array


class Trajectory(Protocol):
    """A reference to fly. Times are integer nanoseconds from its start, and may be any number."""

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the samples at these times; at a jump, the values after it."""
        ...

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the times in (start, end] at which the trajectory is not continuous."""
        ...

    def before(self, time_ns: int) -> TrajectorySamples:
        """Return the single sample from the left of a time, as it is just before a jump there."""
        ...

    @property
    def period_ns(self) -> int:
        """Time after which the whole trajectory has been seen."""
        ...
