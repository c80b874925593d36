"""Where requests to the reference may lead: the fence, and the limits of commanded velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.box import BoxParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.velocity import STEP_NS, VelocityLimits

if TYPE_CHECKING:
    from quad_mpc_ros.references.config import ReferenceConfig

YAW_SHARE = 0.5
"""Of the limit of the yaw rate, what is asked for."""

_FROM_WALLS = 0.3  # m: a vehicle that flies beside its reference stays inside the fence
_CLEARANCE = 0.3  # m above the ground: lower only by a landing
_THRUST_SHARE = 0.9  # of what hovering leaves free
_YAW_RISE = 0.5  # s, to the highest yaw rate


@dataclass(frozen=True, kw_only=True)
class ReferenceFenceParameters(BoxParameters):
    """What a take-off, a goal, a trajectory received or a velocity may not lead out of.

    A velocity ends a little in front of the walls.
    """

    owner = "reference.fence"

    def objection(self, p_WB: Array) -> str | None:
        """Return which of some points (n, 3) [m] is outside, or None."""
        for axis, values, low, high in zip("xyz", p_WB.T, *self.walls, strict=True):
            for value in (float(values.min()), float(values.max())):
                if not low <= value <= high:
                    return (
                        f"outside the fence: {axis} is {value:.2f} m, limits {low:g} to {high:g}"
                    )
        return None


def velocity_limits(config: ReferenceConfig, *, ground: float, home: Array) -> VelocityLimits:
    """Return the limits of commanded velocities.

    ``ground`` [m] is its height, ``home`` (3,) [m] where the vehicle stood at first: no farther
    away than ``reach`` along each axis. Speed and acceleration are those of the parameters, or
    lower where thrust, drag and body rates set lower ones: with an acceleration a the jerk is at
    most 2 a over a step, and the body turns at most by the jerk over g - a.
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
    inset = np.minimum(_FROM_WALLS, 0.5 * (high - low))
    low = np.maximum(low + inset, home - config.reach)
    low[2] = max(low[2], ground + _CLEARANCE)
    high = np.minimum(high - inset, home + config.reach)
    return VelocityLimits(
        speed=speed,
        acceleration=acceleration,
        yaw_rate=yaw_rate,
        yaw_acceleration=yaw_rate / _YAW_RISE,
        lowest=low.tolist(),
        highest=np.maximum(high, low).tolist(),
    )
