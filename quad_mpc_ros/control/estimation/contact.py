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

One that has crashed (``control/estimation/crash.py``) neither stands nor flies.

``references/touchdown.py`` asks something else, whether a landing has come to its end, and knows
no commands but how far below the vehicle the reference is. The ground of ``simulation/`` is part
of the plant: it cannot hide a mistake made here.
"""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation.crash import Crash
from quad_mpc_ros.control.estimation.filtered_motion import GRAVITY, FilteredMotion
from quad_mpc_ros.control.estimation.ground import CLIMBING, LEFT_GROUND, NO_LIFT, asks_to_sink
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow

_STRONGEST = 1.5  # true thrust over the modelled
_GUST = 2.0  # m/s^2 that air may push up by
# Thrust as a share of the weight. Some, filtered, for a while, keeps a vehicle in the air that was
# not seen to stand, and enough may have lifted one that was.
_SOME, _ENOUGH = 0.6, 0.95
_SETTLING_NS = 200_000_000  # until a throttle that was given up no longer lifts
_SHORTEST, _LONGEST = 0.4, 0.8  # s, of the time T
_LIFTING_NS = 1_500_000_000  # autopilots let the motors spool up for a second
_LONGEST_GAP_NS = 500_000_000  # between odometries; beyond it what was between is not known

_DRIFT_FILTER, _GROUND_FILTER = 0.5, 2.0  # s
# m/s, filtered: with no more it may have come to stand. It flies when it is faster than the second
# and has changed its height, or than the third.
_RESTING, _MOVING, _FAST = 1.0, 1.5, 3.0
_SHIFTED = 0.1  # m of height
_SLIPPING = 0.5  # m/s aside with thrust: it has left the ground, leaning
_CLIMBING = 0.3  # m/s upwards with thrust, and
_LIFTED = 0.05  # m higher than it has been: it has left the ground

_NEAR = 0.5  # m above where it stood, by odometry that drifts
_RISING = 0.01  # m within its window: such a reference climbs or sinks
_REFERENCE_SPEED = 1.5  # m/s: no reference of a vehicle that stands moves so fast


class Contact(enum.Enum):
    """What is known: flying teaches, standing and crashed idle, and unknown does neither."""

    UNKNOWN = "unknown"
    FLYING = "flying"
    STANDING = "standing"
    CRASHED = "crashed"


class _Course(NamedTuple):
    """What a reference is to do: its height now, the lowest and the highest, the largest speed."""

    height: float
    lowest: float
    highest: float
    speed: float


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
        self._motion = FilteredMotion()
        self._window: ReferenceWindow | None = None
        self._course = _Course(0.0, 0.0, 0.0, 0.0)
        self._forget()

    def engage(self, engaged: bool) -> None:
        """Set whether commands act: as long as they do not, their thrust says nothing."""
        if engaged is not self._engaged:
            stood, height = self.standing and engaged, self._stood_at
            self._engaged = engaged
            self._forget()
            self._stood_at = height  # whoever flew meanwhile: it may come down there again
            if stood:  # as the flight stack reported until now
                self.contact = Contact.STANDING

    def _forget(self) -> None:
        self.contact, self.touching, self._lands = Contact.UNKNOWN, False, False
        self._stood_at = None
        self._stamp_ns: int | None = None
        self._little_since_ns: int | None = None
        self._lifting_since_ns: int | None = None
        self._motion.forget_thrust()
        self._still: _Stillness | None = None
        self._crash = Crash()

    def tell_landed(self, landed: bool | None) -> None:
        """Take what the flight stack says; None where it says nothing.

        A reported landing counts as long as the vehicle is given little thrust and does not
        move. That it has not says nothing: stacks take their time.
        """
        self._landed = landed

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: nothing has moved."""
        if self._stood_at is not None:
            self._stood_at += float(reset.step_W[2])
        self._still = None
        self._crash.begin_anew()
        if self._stamp_ns is not None:
            self._motion.reset_estimate(reset)

    @property
    def standing(self) -> bool:
        """Whether it is certain that it stands."""
        return self.contact is Contact.STANDING

    @property
    def crashed(self) -> bool:
        """Whether it is certain that it lies where it cannot fly from."""
        return self.contact is Contact.CRASHED

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
        self._follow(odometry, thrust)
        self._weigh(odometry.stamp_ns, thrust=thrust)
        if self._crash.update(odometry, self._motion.now, height=self._motion.height):
            self.contact, self.touching, self._lands = Contact.CRASHED, False, False
            return self.contact
        if self.crashed:
            self.contact = Contact.FLYING  # it falls
        height, course = float(odometry.p_WB[2]), self._course_of(window)
        self.asks_for_height = course is not None and _asks_for_height(course, height)
        rests = course is None or (not self.asks_for_height and course.speed < _REFERENCE_SPEED)
        self.contact = self._judged(odometry.stamp_ns, reference_rests=rests)
        if self.standing:
            self._stood_at = height
        sinks = rests and course is not None and asks_to_sink(course.height, height)
        self.touching = not self.standing and sinks and self._might_be_down(height)
        lands = rests and course is not None and _sinks(course, height)
        self._lands = lands and self._is_low(height)
        if self.standing and self._little_since_ns is not None:
            # It has not left, however its odometry drifts.
            self._motion.draw_ground(_DRIFT_FILTER)
        elif not (self.contact is Contact.FLYING or self.asks_for_height):
            self._motion.draw_ground(_GROUND_FILTER)
        elif self.standing:
            # An estimate may sink as motors spool up, by what the vehicle then seems not to rise.
            self._motion.lower_ground()
        return self.contact

    def _course_of(self, window: ReferenceWindow | None) -> _Course | None:
        if window is None:
            return None
        if window is not self._window:
            self._window = window
            self._course = _Course(*_course(window.p_WB, window.v_WB_W))
        return self._course

    def _wait(self, odometry: OdometrySample, window: ReferenceWindow | None) -> None:
        """While commands do not act, take what the flight stack reports: nothing else is known."""
        self.contact = Contact.STANDING if self._landed else Contact.UNKNOWN
        height, course = float(odometry.p_WB[2]), self._course_of(window)
        self.asks_for_height = course is not None and _asks_for_height(course, height)
        if self._landed:
            self._stood_at = height

    def _follow(self, odometry: OdometrySample, thrust: float) -> None:
        """Filter how it moves, and what carries it."""
        before_ns, self._stamp_ns = self._stamp_ns, odometry.stamp_ns
        duration_ns = 0 if before_ns is None else odometry.stamp_ns - before_ns
        anew = not 0 < duration_ns <= _LONGEST_GAP_NS
        if anew:
            self._little_since_ns = self._lifting_since_ns = self._still = None
            self._crash.begin_anew()
        self._motion.follow(
            odometry, thrust=thrust, duration=1e-9 * duration_ns, anew=anew, flies=self.flies
        )

    def _weigh(self, stamp_ns: int, *, thrust: float) -> None:
        """Note since when there has been little thrust, and since when it lifts."""
        self._thrust = max(thrust, 0.0)  # a curve may be negative where nothing turns
        if thrust > NO_LIFT:
            self._little_since_ns, self._still = None, None
        elif self._little_since_ns is None:
            self._little_since_ns = stamp_ns
        if self._motion.now.lift < (_ENOUGH if self.standing else _SOME):
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
        return self._motion.now.speed < _RESTING

    def _might_be_down(self, height: float) -> bool:
        """Whether it is slow, and is carried, or has little thrust and is about where it stood."""
        little = self._little_since_ns is not None
        return self._is_slow() and (self._motion.now.carried or (little and self._is_low(height)))

    def _is_low(self, height: float) -> bool:
        """Whether it is about as high as where it stood."""
        stood = self._stood_at is not None and height < self._stood_at + _NEAR
        return bool(self._landed) or stood

    def _is_moving(self) -> bool:
        """Whether it is faster than noise, which alone does not change the height as well."""
        shifted = abs(self._motion.now.rise) > _SHIFTED
        return self._motion.now.speed > (_MOVING if shifted else _FAST)

    def _has_left(self, *, little: bool) -> bool:
        """Whether it is no longer where it was seen first, or stood."""
        if self.contact is Contact.FLYING:
            return False
        if self.standing:
            return (self._rises() or self._slips()) and not little
        return self._motion.now.way > LEFT_GROUND and not little

    def _rises(self) -> bool:
        """Whether it is higher than where it stood, by its height or on its way under thrust."""
        rise, climb = self._motion.now.rise, self._motion.now.climb
        climbs = self._thrust > _SOME and climb > _CLIMBING and rise > _LIFTED
        return climbs or rise > LEFT_GROUND

    def _slips(self) -> bool:
        """Whether it goes aside under thrust, as one does that takes off from where it leans."""
        return self._thrust > _SOME and self._motion.now.aside > _SLIPPING

    def _stays(self, stamp_ns: int) -> bool:
        """Whether it keeps its height with so little thrust that it would fall."""
        height = self._motion.height
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
        fall = (1.0 - _STRONGEST * self._thrust) * GRAVITY - _GUST
        return self._highest - self._lowest < 0.5 * fall * duration**2 / 8.0


def _lasts(since_ns: int | None, now_ns: int) -> bool:
    return since_ns is not None and now_ns - since_ns >= _LIFTING_NS


def _asks_for_height(course: _Course, height: float) -> bool:
    return course.highest > height + CLIMBING or course.highest > course.height + _RISING


def _sinks(course: _Course, height: float) -> bool:
    """Whether the reference goes down, or is below already."""
    return course.lowest < course.height - _RISING or asks_to_sink(course.height, height)


@compiled
def _course(p_WB: Array, v_WB_W: Array) -> tuple[float, float, float, float]:
    lowest = highest = p_WB[0, 2]
    square = 0.0
    for i in range(len(p_WB)):
        lowest, highest = min(lowest, p_WB[i, 2]), max(highest, p_WB[i, 2])
        v = kernels.vector(v_WB_W[i])
        square = max(square, kernels.dot(v, v))
    return p_WB[0, 2], lowest, highest, math.sqrt(square)
