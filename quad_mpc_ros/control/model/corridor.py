# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The free region: half-spaces on the position for every stage of a horizon."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration.arguments import array, number, stamp
from quad_mpc_ros.configuration.errors import ArgumentError
from quad_mpc_ros.control.lie import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Corridor:
    """Half-spaces n' p <= b on the position, K per stage.

    Args:
        stamp_ns: Start time of the first stage [ns].
        step: Duration of a stage [s].
        normals: Unit vectors n in the world (N, K, 3); zero in inactive rows.
        offsets: Offsets b (N, K) [m], infinity in inactive rows. A row applies at the end of its
            stage.

    Raises:
        ArgumentError: An argument has another type or shape, or N is 0.
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
