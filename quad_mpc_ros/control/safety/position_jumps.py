"""Positions that jump, although the velocity says that the vehicle did not go there.

From odometry to odometry the position should change by the mean of both velocities times the time
between. What is further away than

    0.75 m + 4 e + v T + A T^2 / 2 + d t

is refused: e is the root mean square of what has been found so far, which is the noise of
positions and velocities, v the speed, T the time between, A what the velocity may do within it, d
how fast an integrated velocity drifts and t for how long it has been integrated by now. Only the
position is refused. It is replaced by the integrated one, so that attitude, rates and velocity
are controlled on.

It is over when positions come back, or when they have agreed on the new place, moving along with
the velocity, for three seconds: estimators do step. For 30 s after that a step back is taken at
once, and another one after nine seconds, so that an estimate that steps to and fro is not chased.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import Array, formulas
from quad_mpc_ros.control.lie.formulas import Vector
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample

_SMALL = 0.75  # m: smaller steps are flown
_NOISES = 4.0
_ACCELERATION = 20.0  # m/s^2
_DRIFT = 0.2  # m/s
_AGREED, _AGREED_AGAIN, _MEMORY = 3.0, 9.0, 30.0  # s
# Of the noise: it is learned from so long at first, with everything taken, then over so long; and
# no single jump counts for more.
_LEARNING, _FORGETTING, _MOST = 1.0, 2.0, 3.0  # s, s, m


class _Tracked(NamedTuple):
    """Where the vehicle is taken to be."""

    stamp_ns: int
    p_WB: Vector
    v_WB_W: Vector


class _Place(NamedTuple):
    """Another place than that, since a stamp: how far from it."""

    since_ns: int
    offset_W: Vector


class PositionJumps:
    """Follows the positions of odometries with their twist in the body frame."""

    def __init__(self) -> None:
        self.fault = ""
        """Why the last position was replaced, empty if it was not."""
        self._notes: list[str] = []
        self._engaged = True
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._tracked: _Tracked | None = None
        self._replaced: OdometrySample | None = None
        self._place: _Place | None = None
        self._refused_ns = 0  # since when positions are, while there is a place
        self._taken_ns: int | None = None
        self._former: _Place | None = None  # where it was before another place was taken
        self._began_ns = 0
        self._seen, self._square = 0, 0.0  # and what has been found, squared and averaged
        self.fault = ""

    def engage(self, engaged: bool) -> None:
        """Set whether commands act: while they do not, every place is taken at once."""
        self._engaged = engaged

    def take_notes(self) -> list[str]:
        """Return which places were taken since the last call, for the log."""
        notes, self._notes = self._notes, []
        return notes

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: where it is taken to be moves along."""
        tracked, refused = self._tracked, self._place is not None
        if tracked is None or not (refused or tracked.stamp_ns < reset.stamp_ns):
            return  # the odometry in the new coordinates has come already
        self._tracked = _Tracked(
            tracked.stamp_ns,
            _numbers(reset.points(np.array(tracked.p_WB))),
            _numbers(reset.vectors(np.array(tracked.v_WB_W))),
        )
        self._place = self._former = None

    def checked(self, odometry: OdometrySample) -> OdometrySample:
        """Return an odometry, its position replaced if it has jumped; ``fault`` says so."""
        before = self._tracked
        if before is not None and before.stamp_ns == odometry.stamp_ns:
            return self._replaced or odometry  # sent again
        p_WB, v_WB_W = _numbers(odometry.p_WB), _velocity(odometry)
        self._replaced = None
        if before is None or odometry.stamp_ns < before.stamp_ns or not self._engaged:
            self._begin_anew()
            self._began_ns = odometry.stamp_ns
            self._tracked = _Tracked(odometry.stamp_ns, p_WB, v_WB_W)
            return odometry
        duration = _seconds(odometry.stamp_ns, before.stamp_ns)
        expected = _led(before, v_WB_W, duration)
        offset_W = _difference(p_WB, expected)
        if self._is_taken(offset_W, odometry, duration):
            self._tracked = _Tracked(odometry.stamp_ns, p_WB, v_WB_W)
            return odometry
        self._tracked = _Tracked(odometry.stamp_ns, expected, v_WB_W)
        self._replaced = dataclasses.replace(odometry, p_WB=np.array(expected))
        return self._replaced

    def _is_taken(self, offset_W: Vector, odometry: OdometrySample, duration: float) -> bool:
        """Whether a position so far from the expected one is taken."""
        stamp_ns, distance = odometry.stamp_ns, math.hypot(*offset_W)
        within = self._within(stamp_ns, odometry.speed, duration)
        if distance <= within or _seconds(stamp_ns, self._began_ns) < _LEARNING:
            self._learn(distance, duration)
            self._place, self.fault = None, ""
            return True
        lately = self._taken_ns is not None and _seconds(stamp_ns, self._taken_ns) < _MEMORY
        if lately and self._former is not None:
            drift = _DRIFT * _seconds(stamp_ns, self._former.since_ns)
            if math.dist(offset_W, self._former.offset_W) <= within + drift:
                self._take(stamp_ns, None, f"position is back by {distance:.1f} m: taken")
                return True
        if self._place is None:
            self._refused_ns = stamp_ns
        if self._place is None or math.dist(offset_W, self._place.offset_W) > within:
            self._place = _Place(stamp_ns, offset_W)
            self.fault = (
                f"position jumped by {distance:.1f} m, which neither velocity nor odom_reset "
                "explains: flown on by the velocity"
            )
        lasts = _seconds(stamp_ns, self._place.since_ns)
        if lasts < (_AGREED_AGAIN if lately else _AGREED):
            return False
        x, y, z = offset_W
        note = f"position {distance:.1f} m aside has lasted for {lasts:.1f} s: taken"
        self._take(stamp_ns, _Place(stamp_ns, (-x, -y, -z)), note)
        return True

    def _within(self, stamp_ns: int, speed: float, duration: float) -> float:
        """Return how far [m] a position that has not jumped may be from the expected one."""
        refused = 0.0 if self._place is None else _seconds(stamp_ns, self._refused_ns)
        motion = (speed + 0.5 * _ACCELERATION * duration) * duration
        return _SMALL + _NOISES * math.sqrt(self._square) + motion + _DRIFT * refused

    def _take(self, stamp_ns: int, former: _Place | None, note: str) -> None:
        """Take another place; the ``former`` one may come back."""
        self._taken_ns, self._former = stamp_ns, former
        self._place, self.fault = None, ""
        self._notes.append(note)

    def _learn(self, distance: float, duration: float) -> None:
        self._seen += 1
        share = max(1.0 / self._seen, min(duration / _FORGETTING, 0.2))
        self._square += share * (min(distance, _MOST) ** 2 - self._square)


def _led(before: _Tracked, v_WB_W: Vector, duration: float) -> Vector:
    """Return where the mean of both velocities leads."""
    (x, y, z), (u, v, w), (u1, v1, w1), half = before.p_WB, before.v_WB_W, v_WB_W, 0.5 * duration
    return x + half * (u + u1), y + half * (v + v1), z + half * (w + w1)


def _velocity(odometry: OdometrySample) -> Vector:
    """Return the velocity in the world."""
    q, (u, v, w) = odometry.q_WB_xyzw.tolist(), odometry.v_WB_B.tolist()
    r = formulas.rotation((q[0], q[1], q[2], q[3]))
    return (
        r[0] * u + r[1] * v + r[2] * w,
        r[3] * u + r[4] * v + r[5] * w,
        r[6] * u + r[7] * v + r[8] * w,
    )


def _seconds(now_ns: int, since_ns: int) -> float:
    return 1e-9 * (now_ns - since_ns)


def _difference(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _numbers(vector: Array) -> Vector:
    x, y, z = vector.tolist()
    return x, y, z
