"""How a vehicle moves and what carries it, filtered: its ground state is judged by this.

At the touchdown with less than a share of the thrust that has carried it in flight lately it has
to fall. Something else carries it where it should have become faster downwards by so much, and has
by less than a share of that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample

# Time constants [s] of noise in odometry, of what motors make of a throttle, of a flight's thrust.
_FILTER, _THRUST_FILTER, _FLIGHT_FILTER = 0.1, 0.3, 2.0
_REDUCED = 0.8  # share of the flight's thrust with less of which it has to fall
_SHOULD_FALL = 0.2  # m/s faster downwards, by then
_FALLS = 0.3  # share of that; with less it is carried


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
        self.now = Motion()
        """The motion at the last odometry."""
        self._gravity = gravity
        # Lists of plain numbers: of three, arrays take longer.
        self._p_WB = self._v_WB_W = self._ground = [0.0, 0.0, 0.0]
        self._duration = 0.0
        self.forget_thrust()

    @property
    def height(self) -> float:
        """The height, filtered [m]."""
        return self._p_WB[2]

    def forget_thrust(self) -> None:
        """Forget what carried it."""
        # As shares of the weight: what lifts, the thrust now and in flight lately.
        self._lift = self._thrust = self._in_flight = 0.0
        # m/s: by how much it should have fallen with too little thrust, how it climbed before.
        self._fall = self._climb = 0.0

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: nothing has moved."""
        self._p_WB = reset.points(np.array(self._p_WB)).tolist()
        self._ground = reset.points(np.array(self._ground)).tolist()
        self._v_WB_W = reset.vectors(np.array(self._v_WB_W)).tolist()

    def draw_ground(self, *, fast: bool) -> None:
        """Let where it stood follow where it is."""
        share = _share(self._duration, _THRUST_FILTER if fast else _FLIGHT_FILTER)
        self._ground = _between(self._ground, self._p_WB, share)

    def lower_ground(self) -> None:
        """Let where it stood be no higher than where it is."""
        self._ground = [*self._ground[:2], min(self._ground[2], self.height)]

    def follow(
        self, odometry: OdometrySample, *, thrust: float, duration: float, anew: bool, flies: bool
    ) -> None:
        """Take an odometry that comes ``duration`` [s] after the one before, or begin ``anew``.

        ``thrust`` is what the command in force makes by the model, as a share of the weight.
        """
        p_WB = odometry.p_WB.tolist()
        v_WB_W = _turned(odometry.q_WB_xyzw.tolist(), odometry.v_WB_B.tolist())
        if anew:
            self._p_WB, self._v_WB_W, self._ground = p_WB, v_WB_W, p_WB
        self._duration = 0.0 if anew else duration
        share = _share(self._duration, _FILTER)
        self._p_WB = _between(self._p_WB, p_WB, share)
        self._v_WB_W = _between(self._v_WB_W, v_WB_W, share)
        self._lift += _share(self._duration, _THRUST_FILTER) * (thrust * odometry.up - self._lift)
        vx, vy, climb = self._v_WB_W
        self.now = Motion(
            aside=math.hypot(vx, vy),
            climb=climb,
            way=math.dist(self._p_WB, self._ground),
            rise=self._p_WB[2] - self._ground[2],
            lift=self._lift,
            carried=self._is_carried(max(thrust, 0.0), climb, share, flies=flies),
        )

    def _is_carried(self, thrust: float, climb: float, share: float, *, flies: bool) -> bool:
        """Note with what thrust it flies; return whether it should be falling, and is not.

        A curve of the thrust may be negative where nothing turns; here it is not.
        """
        self._thrust += share * (thrust - self._thrust)
        change = self._thrust - self._in_flight
        if self._thrust < _REDUCED * self._in_flight:
            self._fall -= self._gravity * change / self._in_flight * self._duration
        else:
            self._fall, self._climb = 0.0, climb
        if flies and self._fall < _SHOULD_FALL:
            self._in_flight += _share(self._duration, _FLIGHT_FILTER) * change
        return self._fall > max(_SHOULD_FALL, (self._climb - climb) / _FALLS)


def _share(duration: float, time_constant: float) -> float:
    """Return the share of the way to a new value that a filter goes in a time [s]."""
    return 1.0 - math.exp(-duration / time_constant)


def _between(here: list[float], there: list[float], share: float) -> list[float]:
    return [a + share * (b - a) for a, b in zip(here, there, strict=True)]


def _turned(q_WB_xyzw: list[float], v_B: list[float]) -> list[float]:
    """Return a vector of the body in the world, v + 2 w (q x v) + 2 q x (q x v)."""
    (x, y, z, w), (a, b, c) = q_WB_xyzw, v_B
    d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return [a + w * d + y * f - z * e, b + w * e + z * d - x * f, c + w * f + x * e - y * d]
