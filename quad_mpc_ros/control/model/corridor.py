"""The free region: half-spaces on the position for every stage of a horizon."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration.arguments import array, number, stamp
from quad_mpc_ros.configuration.errors import ArgumentError
from quad_mpc_ros.control.lie import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Corridor:
    """Half-spaces n' p <= b on the position, K a stage.

    Args:
        stamp_ns: When the first stage begins [ns].
        step: How long a stage is [s].
        normals: Unit vectors n in the world (N, K, 3); zero in rows that hold nothing.
        offsets: b along them (N, K) [m], infinity in rows that hold nothing. A row holds at the
            end of its stage.

    Raises:
        ArgumentError: One of them is of another type or shape, or N is 0.
    """

    stamp_ns: int
    step: float
    normals: Array
    offsets: Array

    def __post_init__(self) -> None:
        stamp(self.stamp_ns, "stamp_ns")
        number(self.step, "step", above=0.0)
        offsets = array(self.offsets, "offsets", ...)
        if offsets.ndim != 2 or len(offsets) == 0:
            raise ArgumentError("offsets", offsets, "numbers of shape (N, K), N at least 1")
        array(self.normals, "normals", *offsets.shape, 3)

    def beyond(self, p_W: Array, stage: int = 0) -> float:
        """Return how far a position (3,) is outside the free region of a stage, at least 0 [m]."""
        over = self.normals[stage] @ p_W - self.offsets[stage]
        return max(0.0, float(over.max(initial=0.0)))
