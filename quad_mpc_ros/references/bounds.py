# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Limits of requests to the reference: the fence, and limits of commanded velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.configuration import UserError, per_axis
from quad_mpc_ros.configuration.box import BoxParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.velocity import STEP_NS, VelocityLimits

if TYPE_CHECKING:
    from quad_mpc_ros.references.config import ReferenceConfig

YAW_SHARE = 0.5
"""Share of the limit of the yaw rate that transitions use."""

_WALL_DISTANCE = 0.3  # m, so that a vehicle with a tracking error stays inside the fence
_MIN_HEIGHT = 0.3  # m above the ground, except for a landing
_THRUST_SHARE = 0.9  # of the thrust range about hovering
_YAW_RISE_TIME = 0.5  # s, to the highest yaw rate


@dataclass(frozen=True, kw_only=True)
class ReferenceFenceParameters(BoxParameters):
    """Fence for take-offs, goals, received trajectories and velocities.

    Velocities stop in front of the walls.
    """

    owner = "reference.fence"

    def check_inside(self, p_WB: Array) -> None:
        """Raise :class:`UserError` if any of the points (n, 3) [m] is outside."""
        for axis, values, low, high in zip("xyz", p_WB.T, *self.walls, strict=True):
            for value in (float(values.min()), float(values.max())):
                if not low <= value <= high:
                    raise UserError(
                        f"outside the fence: {axis} is {value:.2f} m, limits {low:g} to {high:g}"
                    )


def velocity_limits(config: ReferenceConfig, *, ground: float, home: Array) -> VelocityLimits:
    """Return the limits of commanded velocities.

    ``ground`` [m] is the height of the ground, ``home`` (3,) [m] the first position, from which
    velocities stay within ``reach`` along each axis. Speed and acceleration are from the
    parameters, or lower limits from thrust, drag and body rates: with an acceleration a the jerk
    is at most 2 a over a step, and the body rate at most the jerk over g - a.
    """
    vehicle = config.vehicle()
    g, share = vehicle.gravity, 1.0 - config.limit_margin
    highest = vehicle.thrust(config.throttle_max) / vehicle.mass - g
    lowest = g - vehicle.thrust(config.throttle_min) / vehicle.mass
    free = _THRUST_SHARE * share * min(highest, lowest)
    drag = max(np.add(per_axis(vehicle.drag), per_axis(vehicle.rotor_drag)).tolist())
    speed = min(config.max_speed, 0.5 * free / drag) if drag else config.max_speed
    turn = share * min(config.rate_limits[:2]) * 1e-9 * STEP_NS
    acceleration = min(config.max_acceleration, free - drag * speed, turn * g / (2.0 + turn))
    yaw_rate = YAW_SHARE * config.rate_limits[2]
    low, high = map(np.array, config.fence.walls)
    inset = np.minimum(_WALL_DISTANCE, 0.5 * (high - low))
    low = np.maximum(low + inset, home - config.reach)
    low[2] = max(low[2], ground + _MIN_HEIGHT)
    high = np.minimum(high - inset, home + config.reach)
    return VelocityLimits(
        speed=speed,
        acceleration=acceleration,
        yaw_rate=yaw_rate,
        yaw_acceleration=yaw_rate / _YAW_RISE_TIME,
        lowest=low.tolist(),
        highest=np.maximum(high, low).tolist(),
    )
