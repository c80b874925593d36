"""How a vehicle moves and what carries it, filtered: its ground state is judged by this.

At the touchdown with less than a share of the thrust that has carried it in flight lately it has
to fall. Something else carries it where it should have become faster downwards by so much, and has
by less than a share of that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import so3
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
        self._p_WB = self._v_WB_W = self._ground = np.zeros(3)
        self._duration = 0.0
        self.forget_thrust()

    @property
    def height(self) -> float:
        """The height, filtered [m]."""
        return float(self._p_WB[2])

    def forget_thrust(self) -> None:
        """Forget what carried it."""
        # As shares of the weight: what lifts, the thrust now and in flight lately.
        self._lift = self._thrust = self._in_flight = 0.0
        # m/s: by how much it should have fallen with too little thrust, how it climbed before.
        self._fall = self._climb = 0.0

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: nothing has moved."""
        self._p_WB, self._ground = reset.points(self._p_WB), reset.points(self._ground)
        self._v_WB_W = reset.vectors(self._v_WB_W)

    def draw_ground(self, *, fast: bool) -> None:
        """Let where it stood follow where it is."""
        share = _share(self._duration, _THRUST_FILTER if fast else _FLIGHT_FILTER)
        self._ground = self._ground + share * (self._p_WB - self._ground)

    def lower_ground(self) -> None:
        """Let where it stood be no higher than where it is."""
        x, y, z = self._ground.tolist()
        self._ground = np.array([x, y, min(z, self.height)])

    def follow(
        self, odometry: OdometrySample, *, thrust: float, duration: float, anew: bool, flies: bool
    ) -> None:
        """Take an odometry that comes ``duration`` [s] after the one before, or begin ``anew``.

        ``thrust`` is what the command in force makes by the model, as a share of the weight.
        """
        v_WB_W = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw) @ odometry.v_WB_B
        if anew:
            self._p_WB, self._v_WB_W, self._ground = odometry.p_WB, v_WB_W, odometry.p_WB
        self._duration = 0.0 if anew else duration
        share = _share(self._duration, _FILTER)
        self._p_WB = self._p_WB + share * (odometry.p_WB - self._p_WB)
        self._v_WB_W = self._v_WB_W + share * (v_WB_W - self._v_WB_W)
        self._lift += _share(self._duration, _THRUST_FILTER) * (thrust * odometry.up - self._lift)
        x, y, rise = (self._p_WB - self._ground).tolist()
        vx, vy, climb = self._v_WB_W.tolist()
        self.now = Motion(
            aside=math.hypot(vx, vy),
            climb=climb,
            way=math.hypot(x, y, rise),
            rise=rise,
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
