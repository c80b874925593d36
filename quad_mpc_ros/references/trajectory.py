# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories: references as functions of time, and their common parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.vehicle import VehicleParameters


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectorySamples:
    """A trajectory at n times, in the world frame, as in the message.

    Shapes: ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``w_WB_W`` (n, 3) in m, m/s, m/s^2, rad/s;
    ``q_WB_xyzw`` (n, 4).
    """

    p_WB: Array
    q_WB_xyzw: Array
    v_WB_W: Array
    a_WB_W: Array
    w_WB_W: Array


@runtime_checkable
class Trajectory(Protocol):
    """A reference to fly. Times are integer nanoseconds from its start, of any sign.

    A class with trajectories that never change may set ``fixed = True``: they are then sampled at
    many times at once, long before the flight.
    """

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the samples at these times; at a jump, the values after the jump."""

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the times in (start, end] at which the trajectory is not continuous."""

    @property
    def period_ns(self) -> int:
        """Duration, or period, of the trajectory; 0 without motion."""

    @property
    def smooth(self) -> bool:
        """Whether the trajectory has no jumps: it is previewed, and flights can start on it."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryParameters(VehicleParameters):
    """The common parameters of trajectories: vehicle, position and heading.

    Further parameters of a trajectory are declared in a class derived from this one, in its file.
    Parameters of all trajectories belong to the reference node, so their names must differ.
    """

    owner = "reference"

    origin: tuple[float, ...] = parameter(
        (0.0, 0.0),
        doc="Origin of the trajectory, east and north; not used by gates.",
        unit="m",
        length=2,
    )
    height: float = parameter(
        2.0,
        doc="Height of the trajectory above the ground: of the lowest point of vertical_loop "
        "and flip, of the centre of an ellipse. Not used by trajectories with heights of "
        "their own (waypoints, minimum_snap, gates, csv).",
        unit="m",
        minimum=0.0,
    )
    yaw: float = parameter(
        0.0,
        doc="Heading while level, from east to north; vertical_loop and flip are flown in "
        "this direction. The angle is added to the heading of an ellipse and to the yaw of a "
        "csv without attitudes.",
        unit="rad",
        minimum=-math.tau,
        maximum=math.tau,
    )


def at_rest(p_WB: Array, *, yaw: float = 0.0) -> TrajectorySamples:
    """Return samples that rest at positions (n, 3), level and at ``yaw`` [rad] from east."""
    rest = np.zeros_like(p_WB)
    level = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    return TrajectorySamples(
        p_WB=p_WB,
        q_WB_xyzw=np.tile(level, (len(p_WB), 1)),
        v_WB_W=rest,
        a_WB_W=rest,
        w_WB_W=rest,
    )


def resting(samples: TrajectorySamples) -> TrajectorySamples:
    """Return samples that rest at the positions and attitudes of others."""
    return dataclasses.replace(at_rest(samples.p_WB), q_WB_xyzw=samples.q_WB_xyzw)


def combined(function: Callable[..., Array], *parts: TrajectorySamples) -> TrajectorySamples:
    """Return samples with a function applied to each field of some samples."""
    names = [field.name for field in dataclasses.fields(TrajectorySamples)]
    return TrajectorySamples(
        **{name: function(*(getattr(part, name) for part in parts)) for name in names}
    )
