"""Does the vehicle stand on the ground? The one place that judges it.

Three ask: the supervisor, which lets the motors idle and turns nothing on the ground, the
disturbance EKF, which learns nothing there, for the ground carries what the thrust does not, and
``mpc/stats``. To say wrongly that it stands would cut the motors of a flying vehicle. So that is
said only of what cannot fly: with a share l of its weight as thrust, a vehicle in the air falls by

    a >= (1 - 1.5 l) g - gust

even if the true thrust is 1.5 times the modelled. Over a time T its height then covers at least
a T^2 / 8, at the top of a throw, which is the least. Half of that is the most that one that stands
may cover. Heights are compared and not speeds, whose noise would look like motion: where speeds
are noisy, positions are smooth.

``trajectories/touchdown.py`` asks something else, whether a landing has come to its end, and knows
no commands but how far below the vehicle the reference is. The ground of ``simulation/`` is part
of the plant: it cannot hide a mistake made here.
"""

from __future__ import annotations

import enum
import math

import numpy as np

from quad_mpc_ros.lie import Array
from quad_mpc_ros.model.estimate_reset import EstimateReset
from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.model.state import state_from_odometry

_GRAVITY = 9.81  # m/s^2
_STRONGEST = 1.5  # true thrust over the modelled
_GUST = 2.0  # m/s^2 that air may push up by
# Thrust as a share of the weight: little cannot keep a vehicle in the air. Some, filtered, for a
# while, does keep one that was not seen to stand, and enough may have lifted one that was.
_LITTLE, _SOME, _ENOUGH = 0.4, 0.6, 0.95
_SETTLING_NS = 200_000_000  # until a throttle that was given up no longer lifts
_SHORTEST, _LONGEST = 0.4, 0.8  # s, of the time T
_LIFTING_NS = 1_500_000_000  # autopilots let the motors spool up for a second
_LONGEST_GAP_NS = 500_000_000  # between odometries; beyond it what was between is not known

_FILTER, _LIFT_FILTER, _DRIFT_FILTER, _GROUND_FILTER = 0.1, 0.3, 0.5, 2.0  # s
# m/s, filtered: with no more it may have come to stand. It flies when it is faster than the second
# and has changed its height, or than the third.
_RESTING, _MOVING, _FAST = 1.0, 1.5, 3.0
_SHIFTED = 0.1  # m of height
_SLIPPING = 0.5  # m/s aside with thrust: it has left the ground, leaning
_MOVED = 0.15  # m from the ground, or from where it was seen first, with thrust: it flies

_ABOVE = 0.1  # m: a reference so far above the vehicle asks for height
_BELOW = 0.1  # m: and one that is so far below it wants it to sink
_NEAR = 0.5  # m above where it stood, by odometry that drifts
_RISING = 0.01  # m within its window: so does one that rises
_REFERENCE_SPEED = 1.5  # m/s: no reference of a vehicle that stands moves so fast


class Contact(enum.Enum):
    """What is known: flying teaches, standing idles, and unknown does neither."""

    UNKNOWN = "unknown"
    FLYING = "flying"
    STANDING = "standing"


class GroundContact:
    """Follows a vehicle from odometry to odometry."""

    def __init__(self) -> None:
        self.contact = Contact.UNKNOWN
        self.asks_for_height = False
        """Whether the reference wants the vehicle higher than it is."""
        self.touching = False
        """Whether it may just have come down: not yet certain, but nothing should turn it."""
        self._landed: bool | None = None
        self._engaged = True
        self._stood_at: float | None = None
        self._thrust = 0.0
        # Filtered, and where it stood or was seen first.
        self._p, self._v, self._p_ground = np.zeros((3, 3))
        self._forget()

    def engage(self, engaged: bool) -> None:
        """Tell whether commands act: as long as they do not, their thrust says nothing."""
        if engaged is not self._engaged:
            stood, height = self.standing and engaged, self._stood_at
            self._engaged = engaged
            self._forget()
            self._stood_at = height  # whoever flew meanwhile: it may come down there again
            if stood:  # as the flight stack told until now
                self.contact = Contact.STANDING

    def _forget(self) -> None:
        self.contact, self.touching, self._lands = Contact.UNKNOWN, False, False
        self._stood_at = None
        self._stamp_ns: int | None = None
        self._little_since_ns: int | None = None
        self._lifting_since_ns: int | None = None
        self._lift = 0.0
        self._still: _Stillness | None = None

    def tell_landed(self, landed: bool | None) -> None:
        """Take what the flight stack says; None where it says nothing.

        That it has landed is believed as long as the vehicle is given little thrust and does not
        move. That it has not says nothing: stacks take their time.
        """
        self._landed = landed

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: nothing has moved."""
        if self._stood_at is not None:
            self._stood_at += float(reset.step_W[2])
        self._still = None
        if self._stamp_ns is not None:
            self._p, self._p_ground = reset.points(self._p), reset.points(self._p_ground)
            self._v = reset.vectors(self._v)

    @property
    def standing(self) -> bool:
        """Whether it is certain that it stands."""
        return self.contact is Contact.STANDING

    @property
    def flies(self) -> bool:
        """Whether it is certain that it flies."""
        return self.contact is Contact.FLYING

    @property
    def may_touch(self) -> bool:
        """Whether the ground might carry it, at any moment: with little thrust, or as it lands."""
        return self._lands or self._little_since_ns is not None

    def update(
        self, odometry: OdometrySample, *, thrust: float, window: ReferenceWindow | None
    ) -> Contact:
        """Judge by an odometry.

        Args:
            odometry: The vehicle, now.
            thrust: What the command in force makes by the model, as a share of the weight.
            window: The reference, if there is one.
        """
        if not self._engaged:
            self._wait(odometry, window)
            return self.contact
        if self._stamp_ns == odometry.stamp_ns:
            return self.contact
        x = state_from_odometry(odometry)
        self._follow(odometry.stamp_ns, x.p_WB, x.v_WB_W)
        self._weigh(odometry.stamp_ns, thrust=thrust, lift=thrust * odometry.up)
        height = float(x.p_WB[2])
        self.asks_for_height = window is not None and _asks_for_height(window, height)
        rests = window is None or (not self.asks_for_height and _moves_slowly(window))
        self.contact = self._judged(odometry.stamp_ns, reference_rests=rests)
        if self.standing:
            self._stood_at = height
        sinks = rests and window is not None and float(window.p_WB[0, 2]) < height - _BELOW
        self.touching = not self.standing and sinks and self._is_near_ground(height)
        lands = rests and window is not None and _sinks(window, height)
        self._lands = lands and self._is_low(height)
        if self.standing and self._little_since_ns is not None:
            # It has not left, however its odometry drifts.
            self._p_ground += self._share(_DRIFT_FILTER) * (self._p - self._p_ground)
        elif not (self.contact is Contact.FLYING or self.asks_for_height):
            self._p_ground += self._share(_GROUND_FILTER) * (self._p - self._p_ground)
        return self.contact

    def _wait(self, odometry: OdometrySample, window: ReferenceWindow | None) -> None:
        """While commands do not act nothing but the flight stack knows: it is believed."""
        self.contact = Contact.STANDING if self._landed else Contact.UNKNOWN
        height = float(odometry.p_WB[2])
        self.asks_for_height = window is not None and _asks_for_height(window, height)
        if self._landed:
            self._stood_at = height

    def _follow(self, stamp_ns: int, p_WB: Array, v_WB_W: Array) -> None:
        """Filter position and velocity."""
        before_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        if before_ns is None or not 0 < stamp_ns - before_ns <= _LONGEST_GAP_NS:
            self._little_since_ns = self._lifting_since_ns = self._still = None
            self._duration = 0.0
            self._p, self._v, self._p_ground = p_WB.copy(), v_WB_W.copy(), p_WB.copy()
            return
        self._duration = 1e-9 * (stamp_ns - before_ns)
        self._p = self._p + self._share(_FILTER) * (p_WB - self._p)
        self._v = self._v + self._share(_FILTER) * (v_WB_W - self._v)

    def _share(self, time_constant: float) -> float:
        return 1.0 - math.exp(-self._duration / time_constant)

    def _weigh(self, stamp_ns: int, *, thrust: float, lift: float) -> None:
        """Note since when there has been little thrust, and since when it lifts."""
        self._thrust = thrust
        if thrust > _LITTLE:
            self._little_since_ns, self._still = None, None
        elif self._little_since_ns is None:
            self._little_since_ns = stamp_ns
        self._lift += self._share(_LIFT_FILTER) * (lift - self._lift)
        if self._lift < (_ENOUGH if self.standing else _SOME):
            self._lifting_since_ns = None
        elif self._lifting_since_ns is None:
            self._lifting_since_ns = stamp_ns

    def _judged(self, stamp_ns: int, *, reference_rests: bool) -> Contact:
        little = self._little_since_ns is not None
        lifted = self._has_left(little=little) or _lasts(self._lifting_since_ns, stamp_ns)
        if lifted or self._is_moving():
            return Contact.FLYING
        if self.standing:
            return Contact.STANDING
        if not (reference_rests and self._has_settled(stamp_ns) and self._is_slow()):
            self._still = None
        elif self._landed or self._stays(stamp_ns):
            return Contact.STANDING
        return self.contact

    def _has_settled(self, stamp_ns: int) -> bool:
        """Whether the throttle has been little for so long that nothing lifts."""
        since_ns = self._little_since_ns
        return since_ns is not None and stamp_ns - since_ns >= _SETTLING_NS

    def _is_slow(self) -> bool:
        return float(self._v @ self._v) < _RESTING**2

    def _is_near_ground(self, height: float) -> bool:
        """Whether it is slow, with little thrust, about as high as where it stood."""
        return self._is_low(height) and self._little_since_ns is not None and self._is_slow()

    def _is_low(self, height: float) -> bool:
        """Whether it is about as high as where it stood."""
        stood = self._stood_at is not None and height < self._stood_at + _NEAR
        return bool(self._landed) or stood

    def _is_moving(self) -> bool:
        """Whether it is faster than noise, which alone does not change the height as well."""
        square_speed = float(self._v @ self._v)
        shifted = abs(float(self._p[2] - self._p_ground[2])) > _SHIFTED
        return square_speed > (_MOVING if shifted else _FAST) ** 2

    def _has_left(self, *, little: bool) -> bool:
        """Whether it is no longer where it was seen first, or stood."""
        if self.contact is Contact.FLYING:
            return False
        way = self._p - self._p_ground
        if self.standing:
            return (bool(way[2] > _MOVED) or self._slips()) and not little
        return bool(way @ way > _MOVED**2) and not little

    def _slips(self) -> bool:
        """Whether it goes aside under thrust, as one does that takes off from where it leans."""
        return self._thrust > _SOME and math.hypot(self._v[0], self._v[1]) > _SLIPPING

    def _stays(self, stamp_ns: int) -> bool:
        """Whether it keeps its height with so little thrust that it would fall."""
        height = float(self._p[2])
        if self._still is None:
            self._still = _Stillness(stamp_ns, height)
        self._still.add(height, self._thrust)
        duration = self._still.duration(stamp_ns)
        if duration < _SHORTEST:
            return False
        if self._still.is_carried(duration):
            return True
        if duration > _LONGEST:
            self._still = None
        return False


class _Stillness:
    """The heights covered since a moment, and the most thrust."""

    def __init__(self, stamp_ns: int, height: float) -> None:
        self._since_ns = stamp_ns
        self._lowest = self._highest = height
        self._thrust = 0.0

    def add(self, height: float, thrust: float) -> None:
        self._lowest, self._highest = min(self._lowest, height), max(self._highest, height)
        self._thrust = max(self._thrust, thrust)

    def duration(self, stamp_ns: int) -> float:
        return 1e-9 * (stamp_ns - self._since_ns)

    def is_carried(self, duration: float) -> bool:
        fall = (1.0 - _STRONGEST * self._thrust) * _GRAVITY - _GUST
        return self._highest - self._lowest < 0.5 * fall * duration**2 / 8.0


def _lasts(since_ns: int | None, now_ns: int) -> bool:
    return since_ns is not None and now_ns - since_ns >= _LIFTING_NS


def _asks_for_height(window: ReferenceWindow, height: float) -> bool:
    heights = window.p_WB[:, 2]
    highest = float(heights.max())
    return highest > height + _ABOVE or highest > float(heights[0]) + _RISING


def _sinks(window: ReferenceWindow, height: float) -> bool:
    """Whether the reference goes down, or is below already."""
    heights = window.p_WB[:, 2]
    lowest, now = float(heights.min()), float(heights[0])
    return lowest < now - _RISING or now < height - _BELOW


def _moves_slowly(window: ReferenceWindow) -> bool:
    return bool((window.v_WB_W * window.v_WB_W).sum(axis=1).max() < _REFERENCE_SPEED**2)
