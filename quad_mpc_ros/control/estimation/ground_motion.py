# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Filtered motion and thrust of a vehicle, for the ground detector.

With less than a share of its recent thrust in flight, a vehicle must fall. If its sink rate has
grown by less than a share of the expected amount, the vehicle is on the ground. This takes 0.1 s
to 0.4 s. A change of the climb rate that the thrust does not explain shows a contact at once, but
a gust changes the climb rate as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.control.lie.formulas import lowpass_share
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import Measured, OdometrySample

# Time constants [s]: odometry, thrust of the motors, mean thrust in flight.
_ODOMETRY_TIME, _THRUST_TIME, _FLIGHT_TIME = 0.1, 0.3, 2.0
_REDUCED_THRUST = 0.8  # share of the thrust in flight below which the vehicle must fall
_EXPECTED_SINK = 0.2  # m/s, expected change of the sink rate before it is compared
_MIN_SINK_SHARE = 0.3  # of the expected change; below it the ground carries the vehicle
# Time constants [s] with which an impact is forgotten, and of thrust and climb rate before it.
_IMPACT_TIME, _RECENT_TIME = 0.5, 1.0
_NOISE_TIME = 2.0  # s, of the unexplained changes of the climb rate
_MIN_IMPACT_RATIO = 5.0  # of an impact to their root mean square; noise of an odometry sums to 3.5


class VehicleMotion(NamedTuple):
    """Filtered motion: horizontal, vertical and total speed [m/s], height [m].

    ``recent_climb`` [m/s] is the mean climb rate of the last second.
    ``displacement`` and ``rise`` [m] are relative to the position on the ground, or the first
    position. ``lift`` is the vertical thrust as a share of the weight; ``carried``: the ground
    seems to carry the vehicle; ``impact`` [m/s]: recent rise of the climb rate that neither thrust
    nor noise explain. Not filtered: ``up``, cosine of the tilt, and ``reported_speed``.
    """

    aside: float = 0.0
    climb: float = 0.0
    speed: float = 0.0
    height: float = 0.0
    displacement: float = 0.0
    rise: float = 0.0
    lift: float = 0.0
    carried: bool = False
    impact: float = 0.0
    recent_climb: float = 0.0
    up: float = 1.0
    reported_speed: float = 0.0


class Filters(Record):
    """State of the filters."""

    gravity: float  # m/s^2
    p_WB: Vector3
    v_WB_W: Vector3
    ground_W: Vector3  # place on the ground, or first position
    duration: float  # s, between the last two odometries
    # As shares of the weight: vertical thrust, thrust, mean thrust in flight.
    lift: float
    thrust: float
    in_flight: float
    # m/s: expected change of the sink rate with too little thrust, climb rate before.
    fall: float
    climb: float
    # Last reported climb rate [m/s], its recent mean [m/s] and rise that the thrust does not
    # explain [m/s], and the recent thrust as a share of the weight.
    reported_climb: float
    recent_climb: float
    impact: float
    recent: float
    noise: float  # m^2/s^2, mean square of the unexplained changes of the reported climb rate


class MotionFilter:
    """Filters the motion at each odometry."""

    def __init__(self, gravity: float) -> None:
        self.now = VehicleMotion()
        """The motion at the last odometry."""
        self._filters = Filters.zeros()
        self._filters["gravity"] = gravity

    def forget_thrust(self) -> None:
        """Reset the filters of the thrust."""
        for name in ("lift", "thrust", "in_flight", "fall", "climb"):
            self._filters[name] = 0.0

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the filters by an announced odometry jump."""
        for name in ("p_WB", "ground_W"):
            self._filters[name] = reset.points(self._filters[name])
        self._filters["v_WB_W"] = reset.vectors(self._filters["v_WB_W"])

    def draw_ground(self, *, fast: bool) -> None:
        """Move the position on the ground towards the current position."""
        time_constant = _THRUST_TIME if fast else _FLIGHT_TIME
        share = lowpass_share(float(self._filters["duration"]), time_constant)
        ground_W = self._filters["ground_W"]
        ground_W += share * (self._filters["p_WB"] - ground_W)

    def lower_ground(self) -> None:
        """Lower the position on the ground to at most the current height."""
        ground_W = self._filters["ground_W"]
        ground_W[2] = min(ground_W[2], self.now.height)

    def follow(
        self, odometry: OdometrySample, *, thrust: float, duration: float, is_flying: bool
    ) -> None:
        """Take an odometry ``duration`` [s] after the previous odometry; 0 restarts the filters.

        ``thrust`` is the modelled thrust of the active command as a share of the weight.
        """
        self.now = _follow(
            self._filters, odometry.measured, thrust, duration=duration, is_flying=is_flying
        )


@compiled
def _follow(
    buffer: RecordArray[Filters],
    reported: Measured,
    thrust: float,
    duration: float,
    is_flying: bool,
) -> VehicleMotion:
    """Filter the ``reported`` position, attitude and velocity; restart if the duration is 0."""
    filters, (p_WB, q_WB_xyzw, v_WB_B, _) = buffer[()], reported
    R_WB = kernels.rotation(kernels.quaternion_in(q_WB_xyzw))
    v_WB_W = kernels.apply(R_WB, kernels.vector(v_WB_B))
    restarts, (_, _, up) = duration == 0.0, kernels.column(R_WB, 2)
    share = 1.0 if restarts else kernels.lowpass_share(duration, _ODOMETRY_TIME)
    for k in range(3):
        filters.p_WB[k] += share * (p_WB[k] - filters.p_WB[k])
        filters.v_WB_W[k] += share * (v_WB_W[k] - filters.v_WB_W[k])
        filters.ground_W[k] = p_WB[k] if restarts else filters.ground_W[k]
    filters.duration = duration
    filters.lift += kernels.lowpass_share(duration, _THRUST_TIME) * (thrust * up - filters.lift)
    share = 1.0 if restarts else kernels.lowpass_share(duration, _RECENT_TIME)
    filters.recent_climb += share * (v_WB_W[2] - filters.recent_climb)
    vx, vy, climb = kernels.vector(filters.v_WB_W)
    carried = _is_carried(filters, max(thrust, 0.0), is_flying)
    impact = _impact(filters, v_WB_W[2], is_flying and not restarts)
    return VehicleMotion(
        aside=math.hypot(vx, vy),
        climb=climb,
        speed=kernels.length(filters.v_WB_W),
        height=filters.p_WB[2],
        displacement=kernels.distance(filters.p_WB, filters.ground_W),
        rise=filters.p_WB[2] - filters.ground_W[2],
        lift=filters.lift,
        carried=carried,
        impact=impact,
        recent_climb=filters.recent_climb,
        up=up,
        reported_speed=kernels.length(v_WB_B),
    )


@compiled
def _is_carried(filters: Filters, thrust: float, is_flying: bool) -> bool:
    """Update the thrust in flight; return whether the vehicle should fall but does not.

    ``thrust`` is not negative.
    """
    climb, duration = filters.v_WB_W[2], filters.duration
    filters.thrust += kernels.lowpass_share(duration, _ODOMETRY_TIME) * (thrust - filters.thrust)
    change = filters.thrust - filters.in_flight
    if filters.thrust < _REDUCED_THRUST * filters.in_flight:
        filters.fall -= filters.gravity * change / filters.in_flight * duration
    else:
        filters.fall, filters.climb = 0.0, climb
    if is_flying and filters.fall < _EXPECTED_SINK:
        filters.in_flight += kernels.lowpass_share(duration, _FLIGHT_TIME) * change
    return bool(filters.fall > max(_EXPECTED_SINK, (filters.climb - climb) / _MIN_SINK_SHARE))


@compiled
def _impact(filters: Filters, climb: float, is_flying: bool) -> float:
    """Update the impact with the reported climb rate [m/s], and return it; 0 within the noise."""
    rise, filters.reported_climb = climb - filters.reported_climb, climb
    if not is_flying or filters.recent <= 0.0:
        filters.impact, filters.recent, filters.noise = 0.0, filters.thrust, 0.0
        return 0.0
    duration = filters.duration
    change = filters.thrust - filters.recent
    filters.recent += kernels.lowpass_share(duration, _RECENT_TIME) * change
    rise -= filters.gravity * (filters.thrust / filters.recent - 1.0) * duration
    kept = 1.0 - kernels.lowpass_share(duration, _IMPACT_TIME)
    filters.impact = max(kept * (filters.impact + rise), 0.0)
    filters.noise += kernels.lowpass_share(duration, _NOISE_TIME) * (rise * rise - filters.noise)
    is_noise = filters.impact < _MIN_IMPACT_RATIO * math.sqrt(filters.noise)
    return 0.0 if is_noise else filters.impact
