"""How a vehicle moves and what carries it, filtered: its ground state is judged by this.

At the touchdown with less than a share of the thrust that has carried it in flight lately it has
to fall. Something else carries it where it should have become faster downwards by so much, and has
by less than a share of that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.lie.formulas import lowpass_share
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample

# Time constants [s] of noise in odometry, of what motors make of a throttle, of a flight's thrust.
_FILTER, _THRUST_FILTER, _FLIGHT_FILTER = 0.1, 0.3, 2.0
_REDUCED = 0.8  # share of the flight's thrust with less of which it has to fall
_SHOULD_FALL = 0.2  # m/s faster downwards, by then
_FALLS = 0.3  # share of that; with less it is carried

_Reported = tuple[Array, Array, Array]  # position, attitude and velocity in the body


class VehicleMotion(NamedTuple):
    """Speed along the ground, upwards and in all [m/s], filtered.

    And its height [m], its way from where it stood or was seen first, and that upwards; the share
    of its weight that the thrust lifts; and whether something else seems to carry it. Not
    filtered: the cosine of its tilt, and its speed as reported.
    """

    aside: float = 0.0
    climb: float = 0.0
    speed: float = 0.0
    height: float = 0.0
    way: float = 0.0
    rise: float = 0.0
    lift: float = 0.0
    carried: bool = False
    up: float = 1.0
    reported_speed: float = 0.0


class Filters(Record):
    """What is filtered."""

    gravity: float  # m/s^2
    p_WB: Vector3
    v_WB_W: Vector3
    ground_W: Vector3  # where it stood, or was seen first
    duration: float  # s, between the last two odometries
    # As shares of the weight: what lifts, the thrust now and in flight lately.
    lift: float
    thrust: float
    in_flight: float
    # m/s: by how much it should have fallen with too little thrust, how it climbed before.
    fall: float
    climb: float


class MotionFilter:
    """Filters from odometry to odometry."""

    def __init__(self, gravity: float) -> None:
        self.now = VehicleMotion()
        """The motion at the last odometry."""
        self._filters = Filters.zeros()
        self._filters["gravity"] = gravity

    def forget_thrust(self) -> None:
        """Forget what carried it."""
        for name in ("lift", "thrust", "in_flight", "fall", "climb"):
            self._filters[name] = 0.0

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: nothing has moved."""
        for name in ("p_WB", "ground_W"):
            self._filters[name] = reset.points(self._filters[name])
        self._filters["v_WB_W"] = reset.vectors(self._filters["v_WB_W"])

    def draw_ground(self, *, fast: bool) -> None:
        """Let where it stood follow where it is."""
        time_constant = _THRUST_FILTER if fast else _FLIGHT_FILTER
        share = lowpass_share(float(self._filters["duration"]), time_constant)
        ground_W = self._filters["ground_W"]
        ground_W += share * (self._filters["p_WB"] - ground_W)

    def lower_ground(self) -> None:
        """Let where it stood be no higher than where it is."""
        ground_W = self._filters["ground_W"]
        ground_W[2] = min(ground_W[2], self.now.height)

    def follow(
        self, odometry: OdometrySample, *, thrust: float, duration: float, flies: bool
    ) -> None:
        """Take an odometry that comes ``duration`` [s] after the last one; 0 restarts the filters.

        ``thrust`` is what the command in force makes by the model, as a share of the weight.
        """
        reported = odometry.p_WB, odometry.q_WB_xyzw, odometry.v_WB_B
        self.now = _follow(self._filters, reported, thrust, duration=duration, flies=flies)


@compiled
def _follow(
    buffer: RecordArray[Filters], reported: _Reported, thrust: float, duration: float, flies: bool
) -> VehicleMotion:
    """Filter the ``reported`` position, attitude and velocity; restart with no duration."""
    filters, (p_WB, q_WB_xyzw, v_WB_B) = buffer[()], reported
    R_WB = kernels.rotation(kernels.quaternion_in(q_WB_xyzw))
    v_WB_W = kernels.apply(R_WB, kernels.vector(v_WB_B))
    restarts, (_, _, up) = duration == 0.0, kernels.column(R_WB, 2)
    share = 1.0 if restarts else kernels.lowpass_share(duration, _FILTER)
    for k in range(3):
        filters.p_WB[k] += share * (p_WB[k] - filters.p_WB[k])
        filters.v_WB_W[k] += share * (v_WB_W[k] - filters.v_WB_W[k])
        filters.ground_W[k] = p_WB[k] if restarts else filters.ground_W[k]
    filters.duration = duration
    filters.lift += kernels.lowpass_share(duration, _THRUST_FILTER) * (thrust * up - filters.lift)
    vx, vy, climb = kernels.vector(filters.v_WB_W)
    return VehicleMotion(
        aside=math.hypot(vx, vy),
        climb=climb,
        speed=kernels.length(filters.v_WB_W),
        height=filters.p_WB[2],
        way=kernels.distance(filters.p_WB, filters.ground_W),
        rise=filters.p_WB[2] - filters.ground_W[2],
        lift=filters.lift,
        carried=_is_carried(filters, max(thrust, 0.0), flies),
        up=up,
        reported_speed=kernels.length(v_WB_B),
    )


@compiled
def _is_carried(filters: Filters, thrust: float, flies: bool) -> bool:
    """Note with what thrust it flies; return whether it should be falling, and is not.

    A curve of the thrust may be negative where nothing turns; here it is not.
    """
    climb, duration = filters.v_WB_W[2], filters.duration
    filters.thrust += kernels.lowpass_share(duration, _FILTER) * (thrust - filters.thrust)
    change = filters.thrust - filters.in_flight
    if filters.thrust < _REDUCED * filters.in_flight:
        filters.fall -= filters.gravity * change / filters.in_flight * duration
    else:
        filters.fall, filters.climb = 0.0, climb
    if flies and filters.fall < _SHOULD_FALL:
        filters.in_flight += kernels.lowpass_share(duration, _FLIGHT_FILTER) * change
    return bool(filters.fall > max(_SHOULD_FALL, (filters.climb - climb) / _FALLS))
