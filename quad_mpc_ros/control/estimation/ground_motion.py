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
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample

# Time constants [s] of noise in odometry, of what motors make of a throttle, of a flight's thrust.
_FILTER, _THRUST_FILTER, _FLIGHT_FILTER = 0.1, 0.3, 2.0
_REDUCED = 0.8  # share of the flight's thrust with less of which it has to fall
_SHOULD_FALL = 0.2  # m/s faster downwards, by then
_FALLS = 0.3  # share of that; with less it is carried


class ThrustFilter(Record):
    """What is filtered of the thrust, all as shares of the weight."""

    lift: float  # the part that lifts
    now: float
    in_flight: float  # lately
    # m/s, by how much it should have fallen since the thrust is too little, and how fast it
    # climbed before that.
    fall: float
    climb: float


class MotionFilter(Record):
    """What is filtered."""

    p_WB: Vector3  # m
    v_WB_W: Vector3  # m/s
    ground: Vector3  # m, where it stood or was seen first
    thrust: ThrustFilter


class Motion(NamedTuple):
    """Speed along the ground and upwards [m/s], filtered.

    And its way [m] from where it stood or was seen first, and that upwards; the share of its
    weight that the thrust lifts; and whether something else seems to carry it.
    """

    aside: float = 0.0
    climb: float = 0.0
    way: float = 0.0
    rise: float = 0.0
    lift: float = 0.0
    carried: bool = False

    @property
    def speed(self) -> float:
        """Its speed [m/s]."""
        return math.hypot(self.aside, self.climb)


class FilteredMotion:
    """Filters from odometry to odometry."""

    def __init__(self, gravity: float) -> None:
        self._gravity = gravity
        self._buffer = MotionFilter.zeros()
        self._state = self._buffer[()]
        self._duration = 0.0
        self.now = Motion()
        """The motion at the last odometry."""

    @property
    def height(self) -> float:
        """The height, filtered [m]."""
        return float(self._state.p_WB[2])

    def forget_thrust(self) -> None:
        """Forget what carried it."""
        self._state.thrust = ThrustFilter.zeros()[()]

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: nothing has moved."""
        state = self._state
        state.p_WB[:], state.ground[:] = reset.points(state.p_WB), reset.points(state.ground)
        state.v_WB_W[:] = reset.vectors(state.v_WB_W)

    def draw_ground(self, *, fast: bool) -> None:
        """Let where it stood follow where it is."""
        time_constant = _THRUST_FILTER if fast else _FLIGHT_FILTER
        ground, share = self._state.ground, 1.0 - math.exp(-self._duration / time_constant)
        ground += share * (self._state.p_WB - ground)

    def lower_ground(self) -> None:
        """Let where it stood be no higher than where it is."""
        self._state.ground[2] = min(self._state.ground[2], self._state.p_WB[2])

    def follow(
        self, odometry: OdometrySample, *, thrust: float, duration: float, anew: bool, flies: bool
    ) -> None:
        """Take an odometry that comes ``duration`` [s] after the one before, or begin ``anew``.

        ``thrust`` is what the command in force makes by the model, as a share of the weight.
        """
        self._duration = 0.0 if anew else duration
        self.now = Motion(
            *_follow(
                p_WB=odometry.p_WB,
                q_WB_xyzw=odometry.q_WB_xyzw,
                v_WB_B=odometry.v_WB_B,
                thrust=thrust,
                duration=self._duration,
                anew=anew,
                flies=flies,
                gravity=self._gravity,
                buffer=self._buffer,
            )
        )


@compiled
def _follow(
    p_WB: Array,
    q_WB_xyzw: Array,
    v_WB_B: Array,
    thrust: float,
    duration: float,
    anew: bool,
    flies: bool,
    gravity: float,
    buffer: RecordArray[MotionFilter],
) -> tuple[float, float, float, float, float, bool]:
    x, y, state = q_WB_xyzw[0], q_WB_xyzw[1], buffer[()]
    R_WB = kernels.rotation(kernels.quaternion_in(q_WB_xyzw))
    v_WB_W = kernels.apply(R_WB, kernels.vector(v_WB_B))
    p, v, ground, carrying = state.p_WB, state.v_WB_W, state.ground, state.thrust
    share = 1.0 - math.exp(-duration / _FILTER)
    for k in range(3):
        if anew:
            p[k], v[k], ground[k] = p_WB[k], v_WB_W[k], p_WB[k]
        p[k] += share * (p_WB[k] - p[k])
        v[k] += share * (v_WB_W[k] - v[k])
    aside, rise = math.hypot(v[0], v[1]), p[2] - ground[2]
    way = math.hypot(math.hypot(p[0] - ground[0], p[1] - ground[1]), rise)
    up = 1.0 - 2.0 * (x * x + y * y)
    lift_share = 1.0 - math.exp(-duration / _THRUST_FILTER)
    carrying.lift += lift_share * (thrust * up - carrying.lift)
    carried = _is_carried(max(thrust, 0.0), v[2], share, duration, flies, gravity, carrying)
    return aside, v[2], way, rise, carrying.lift, carried


@compiled
def _is_carried(
    thrust: float,
    climb: float,
    share: float,
    duration: float,
    flies: bool,
    gravity: float,
    state: ThrustFilter,
) -> bool:
    """Note with what thrust it flies; return whether it should be falling, and is not.

    A curve of the thrust may be negative where nothing turns; here it is not.
    """
    state.now += share * (thrust - state.now)
    change = state.now - state.in_flight
    if state.now < _REDUCED * state.in_flight:
        state.fall -= gravity * change / state.in_flight * duration
    else:
        state.fall, state.climb = 0.0, climb
    if flies and state.fall < _SHOULD_FALL:
        state.in_flight += (1.0 - math.exp(-duration / _FLIGHT_FILTER)) * change
    falls = state.climb - climb
    return bool(state.fall > _SHOULD_FALL and falls < _FALLS * state.fall)
