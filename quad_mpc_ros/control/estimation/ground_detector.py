"""Landing detection: the one place that judges whether the vehicle stands or flies.

All users ask here: the limit stage what motors and rates may do, the estimator
whether anything may be learned, and on ``mpc/ground_state`` the reference and the bridges.

To say wrongly that it stands would cut the motors of a flying vehicle. So that is said only of
what cannot fly. With a share l of its weight as thrust a vehicle in the air falls by

    a >= (1 - 1.5 l) g - gust

even if the true thrust is 1.5 times the modelled; what keeps its height nevertheless
(:mod:`.kept_height`) is carried by the ground. The flight stack's own word counts as much, given
little thrust as well. The ground of ``simulation/`` is part of the plant: it cannot hide a
mistake made here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.control.estimation.crash import FAST, SLOW, CrashDetector
from quad_mpc_ros.control.estimation.ground_motion import MotionFilter
from quad_mpc_ros.control.estimation.ground_state import (
    HEIGHT,
    LEFT_GROUND,
    NO_LIFT,
    AllowedCommand,
    GroundEvidence,
    GroundState,
    Learning,
    next_state,
)
from quad_mpc_ros.control.estimation.kept_height import GUST, SETTLING, THRUST_ERROR, KeptHeight
from quad_mpc_ros.control.estimation.update_mode import LONGEST_GAP_NS
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.stage import Stage

# Thrust as a share of the weight: some, filtered, for a while, keeps a vehicle in the air that was
# not seen to stand, and enough may have lifted one that was.
_SOME, _ENOUGH = 0.6, 0.95
_SPOOLING_UP_NS = 1_500_000_000  # autopilots let the motors spool up for a second
# At the lift-off throttle leaps as the ground lets go, and nothing is learned for so long.
_LETTING_GO_NS = _SPOOLING_UP_NS // 2

_MOVING = 0.5 * FAST  # m/s, filtered: faster it flies if it has changed its height as well
_SLIPPING = 0.5 * SLOW  # m/s aside with thrust: it has left the ground, leaning
# m/s upwards with thrust, half of HEIGHT above where it has been: it has left the ground.
_CLIMBING = 0.3
_NEAR = 0.5  # m above where it stood, by odometry that drifts
_RISING = 0.01  # m within its window: such a reference climbs or sinks


class _Course(NamedTuple):
    """What a reference is to do: its height now, the lowest and the highest, the largest speed."""

    height: float
    lowest: float
    highest: float
    speed: float


class GroundDetector(Stage):
    """Follows a vehicle from odometry to odometry."""

    def __init__(self, gravity: float = 9.81) -> None:
        self.state = GroundState.UNKNOWN
        """The state at the last odometry."""
        self.idle_wanted = False
        """Whether the reference asks for idle motors (:func:`.ground_state.idles`)."""
        self._gravity = gravity
        self._landed: bool | None = None
        self._engaged = True
        self._motion = MotionFilter(gravity)
        self._window: ReferenceWindow | None = None
        self._course = _Course(0.0, 0.0, 0.0, 0.0)
        self._forget()

    def _forget(self) -> None:
        self.state = GroundState.UNKNOWN
        self._climbs = self._lands = False  # so does the reference, near the ground
        self._stood_at: float | None = None
        self._stood_ns: int | None = None
        self._has_just_left = False
        self._stamp_ns: int | None = None
        self._little_since_ns: int | None = None
        self._lifting_since_ns: int | None = None
        self._thrust = 0.0
        self._motion.forget_thrust()
        self._still = KeptHeight(2.0 * SETTLING)
        self._crash = CrashDetector(self._gravity)

    def engage(self, engaged: bool) -> None:
        """Set whether commands act: as long as they do not, their thrust says nothing."""
        if engaged is not self._engaged:
            stood, height = self.state.stands and engaged, self._stood_at
            self._engaged = engaged
            self._forget()
            self._stood_at = height  # others may have flown it meanwhile: it may land there again
            if stood:  # as the flight stack reported until now
                self.state = GroundState.ON_GROUND

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
        self._still.forget()
        self._crash.reset()
        if self._stamp_ns is not None:
            self._motion.reset_estimate(reset)

    @property
    def allowed(self) -> AllowedCommand:
        """What of a command goes to the motors."""
        match self.state:
            case GroundState.ON_GROUND | GroundState.CRASHED:
                return AllowedCommand.IDLE
            case GroundState.UNKNOWN | GroundState.TOUCHING_DOWN if self.idle_wanted:
                return AllowedCommand.IDLE
            case GroundState.LIFTING_OFF | GroundState.TOUCHING_DOWN:
                return AllowedCommand.LEVEL
            case _:
                return AllowedCommand.ALL

    @property
    def learning(self) -> Learning:
        """What the estimator may do: the ground carries what the thrust does not."""
        if not self.state.flies or self._has_just_left:
            return Learning.HOLD
        might_touch = self._lands or self._little_since_ns is not None
        if might_touch or self.state is GroundState.TOUCHING_DOWN:
            return Learning.PAUSE
        return Learning.LEARN

    def update(
        self, odometry: OdometrySample, *, thrust: float, window: ReferenceWindow | None
    ) -> GroundState:
        """Judge by an odometry.

        Args:
            odometry: The vehicle, now.
            thrust: What the command in force makes by the model, as a share of the weight.
            window: The reference, if there is one.
        """
        if not self._engaged:  # nothing else is known
            self.state = GroundState.ON_GROUND if self._landed else GroundState.UNKNOWN
            self._stood_at = float(odometry.p_WB[2]) if self._landed else self._stood_at
        elif self._stamp_ns != odometry.stamp_ns:
            self._follow(odometry, thrust)
            self.state = next_state(self.state, self._evidence(odometry, window))
            self._follow_ground(odometry)
        return self.state

    def _follow(self, odometry: OdometrySample, thrust: float) -> None:
        """Filter how it moves, and what carries it."""
        before_ns, self._stamp_ns = self._stamp_ns, odometry.stamp_ns
        duration_ns = 0 if before_ns is None else odometry.stamp_ns - before_ns
        if not 0 < duration_ns <= LONGEST_GAP_NS:
            duration_ns = 0
            self._little_since_ns = self._lifting_since_ns = None
            self._still.forget()
            self._crash.reset()
        self._motion.follow(
            odometry,
            thrust=thrust,
            duration=1e-9 * duration_ns,
            flies=self.state.flies,
        )
        self._thrust = max(thrust, 0.0)  # a curve may be negative where nothing turns
        little, lift = thrust <= NO_LIFT, self._motion.now.lift
        lifts = lift >= (_ENOUGH if self.state.stands else _SOME)
        self._little_since_ns = since(self._little_since_ns, odometry.stamp_ns, lasts=little)
        self._lifting_since_ns = since(self._lifting_since_ns, odometry.stamp_ns, lasts=lifts)

    def _evidence(
        self, odometry: OdometrySample, window: ReferenceWindow | None
    ) -> tuple[GroundEvidence, ...]:
        """Return what speaks for a change of the state."""
        self._climbs = self._lands = False
        if self._crash.update(odometry.stamp_ns, self._motion.now):
            return (GroundEvidence.LIES,)
        found: tuple[GroundEvidence, ...] = ()
        height = float(odometry.p_WB[2])
        course = self._course_of(window, height)
        self._climbs = course.highest > height + HEIGHT or course.highest > course.height + _RISING
        below = course.height < height - HEIGHT
        rests = not self._climbs and (course.speed < _MOVING or below)
        sinks = course.lowest < course.height - _RISING
        self._lands = rests and (below or sinks) and self._is_low(height)
        if self._climbs:
            found += (GroundEvidence.CLIMBS,)
        if rests and below and self._might_be_down(height, sinks=sinks):
            found += (GroundEvidence.TOUCHES,)
        if self._has_left() or self._is_moving():
            found += (GroundEvidence.LEFT,)
        elif self._rests(odometry.stamp_ns, wanted=rests):
            found += (GroundEvidence.RESTS,)
        return found

    def _course_of(self, window: ReferenceWindow | None, height: float) -> _Course:
        """Return what the reference is to do: idle is below all, and none is at the vehicle."""
        if self.idle_wanted:
            return _Course(-math.inf, -math.inf, -math.inf, 0.0)
        if window is None:
            return _Course(height, height, height, 0.0)
        if window is not self._window:
            self._window, heights = window, window.p_WB[:, 2].tolist()
            speed = kernels.largest_length(window.v_WB_W)
            self._course = _Course(heights[0], min(heights), max(heights), speed)
        return self._course

    def _follow_ground(self, odometry: OdometrySample) -> None:
        """Note where it stands, as far as it does: estimates drift."""
        stamp_ns = odometry.stamp_ns
        if self.state.stands:
            self._stood_at, self._stood_ns = float(odometry.p_WB[2]), stamp_ns
        stood_ns = self._stood_ns
        self._has_just_left = stood_ns is not None and 0 <= stamp_ns - stood_ns < _LETTING_GO_NS
        if self.state.stands and self._little_since_ns is not None:
            self._motion.draw_ground(fast=True)  # it has not left
        elif not (self.state.flies or self._climbs):
            self._motion.draw_ground(fast=False)
        elif self.state.stands:
            # An estimate may sink as motors spool up, by what the vehicle then seems not to rise.
            self._motion.lower_ground()

    def _rests(self, stamp_ns: int, *, wanted: bool) -> bool:
        """Whether it keeps its height with so little thrust that it would fall, or is reported."""
        since_ns = self._little_since_ns
        settled = since_ns is not None and stamp_ns - since_ns >= round(1e9 * SETTLING)
        if not (wanted and settled and self._motion.now.speed < SLOW):
            self._still.forget()
            return False
        fall = (1.0 - (1.0 + THRUST_ERROR) * self._thrust - GUST) * self._gravity
        kept = self._still.lasts(stamp_ns, self._motion.now.height, fall)
        return bool(self._landed) or kept

    def _might_be_down(self, height: float, *, sinks: bool) -> bool:
        """Whether it is slow, and something says that the ground carries it.

        That is a reference that wants it idle, little thrust about where it stood, or its motion
        as the reference sinks: in a hover a vehicle that is stronger than it was moves likewise.
        """
        low = self._little_since_ns is not None and self._is_low(height)
        carried = sinks and self._motion.now.carried
        return self._motion.now.speed < SLOW and (carried or self.idle_wanted or low)

    def _is_low(self, height: float) -> bool:
        """Whether it is about as high as where it stood."""
        stood = self._stood_at is not None and height < self._stood_at + _NEAR
        return bool(self._landed) or stood

    def _is_moving(self) -> bool:
        """Whether it is faster than noise, which alone does not change the height as well."""
        motion = self._motion.now
        shifted = not -HEIGHT <= motion.rise <= HEIGHT
        return motion.speed > (_MOVING if shifted else FAST)

    def _has_left(self) -> bool:
        """Whether it is no longer where it was seen first, or stood, under thrust."""
        since_ns, stamp_ns, motion = self._lifting_since_ns, self._stamp_ns, self._motion.now
        assert stamp_ns is not None
        if since_ns is not None and stamp_ns - since_ns >= _SPOOLING_UP_NS:
            return True
        if self._little_since_ns is not None or self.state.flies:
            return False
        if not self.state.stands:
            return motion.way > LEFT_GROUND
        climbs = motion.climb > _CLIMBING and motion.rise > 0.5 * HEIGHT
        pushed = self._thrust > _SOME and (climbs or motion.aside > _SLIPPING)
        return pushed or motion.rise > LEFT_GROUND


def since(since_ns: int | None, now_ns: int, *, lasts: bool) -> int | None:
    """Return since when something lasts, None if it does not."""
    if not lasts:
        return None
    return now_ns if since_ns is None else since_ns
