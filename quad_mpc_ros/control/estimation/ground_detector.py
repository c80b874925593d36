# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Landing detection: the only module that decides whether the vehicle is on the ground or flies.

The limit stage, the estimator and, via ``mpc/ground_state``, the reference and the bridges use it.

A false landing would cut the motors of a flying vehicle. So the state becomes "on ground" only if
the vehicle cannot fly. With a share l of its weight as thrust a vehicle in the air falls by

    a >= (1 - 1.5 l) g - gust

even if the true thrust is 1.5 times the modelled one. If the vehicle holds its height nevertheless
(:mod:`.kept_height`), it is on the ground. A landing reported by the flight stack also counts, but
only at low thrust. ``simulation/`` models the ground independently, so that tests find errors of
this module.
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
    next_state,
)
from quad_mpc_ros.control.estimation.kept_height import (
    GUST,
    SETTLING,
    THRUST_ERROR,
    KeptHeight,
    since,
)
from quad_mpc_ros.control.estimation.update_mode import LONGEST_GAP_NS, UpdateMode
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.stage import Stage

# Filtered lift as a share of the weight that means flight, if it lasts: for an unknown state, and
# for a vehicle on the ground.
_FLIGHT_LIFT, _LIFT_OFF_LIFT = 0.6, 0.95
_SPOOL_UP_NS = 1_500_000_000  # autopilots let the motors spool up for a second
_LIFT_OFF_NS = _SPOOL_UP_NS // 2  # nothing is learned for so long after the lift-off

_MOVING_SPEED = 0.5 * FAST  # m/s, filtered: with a change of height, faster vehicles fly
_SLIPPING_SPEED = 0.5 * SLOW  # m/s, horizontal with thrust: the vehicle has left the ground
_CLIMB_SPEED = 0.3  # m/s, with thrust, half of HEIGHT above the ground: it has left the ground
_NEAR_GROUND = 0.5  # m above the place on the ground, as odometry drifts
_MIN_IMPACT = 0.2  # m/s: a sinking vehicle near the ground has met it
# Climb rate, recent sink rate and impact [m/s] of a vehicle that has stopped sinking, and its
# share of the sink rate of the reference.
_STOPPED, _MIN_STOP, _STOPPED_SHARE = 0.1, 0.1, 0.5
_MIN_HEIGHT_CHANGE = 0.01  # m within its window: the reference climbs or sinks


class _WantedMotion(NamedTuple):
    """Motion of the reference: heights [m] now and at most, speed and climb rate [m/s].

    ``speed`` is the largest one, ``sinks`` whether the reference sinks within its window. Heights
    are -inf if the reference is idle.
    """

    height: float = -math.inf
    highest: float = -math.inf
    sinks: bool = False
    speed: float = 0.0
    climb: float = 0.0


class GroundDetector(Stage):
    """Decides the ground state at each odometry."""

    def __init__(self, gravity: float = 9.81) -> None:
        self.idle_wanted = False
        """Whether the reference requests idle motors (:func:`.ground_state.idles`)."""
        self._gravity = gravity
        self.landed: bool | None = None
        """Whether the flight stack reports the vehicle landed; None if it does not report.

        A reported landing counts while the vehicle has little thrust and does not move. The
        absence of a report proves nothing, because stacks report late.
        """
        self._engaged = True
        self._motion = MotionFilter(gravity)
        self._window: ReferenceWindow | None = None
        self._wanted = _WantedMotion()
        self._forget()

    def _forget(self) -> None:
        self.state = GroundState.UNKNOWN
        """The state at the last odometry."""
        self._climbs = self._lands = False  # the reference, near the ground
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
        """Set whether the vehicle executes commands; otherwise their thrust is meaningless."""
        stood, height = self.state.is_on_ground and engaged, self._stood_at
        self._engaged = engaged
        self._forget()
        self._stood_at = height  # the vehicle may land there again
        if stood:  # as reported by the flight stack
            self.state = GroundState.ON_GROUND

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform heights by an announced odometry jump."""
        if self._stood_at is not None:
            self._stood_at += float(reset.step_W[2])
        self._still.forget()
        self._crash.reset()
        if self._stamp_ns is not None:
            self._motion.reset_estimate(reset)

    @property
    def allowed(self) -> AllowedCommand:
        """The part of a command that may be sent to the motors."""
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
    def learning(self) -> UpdateMode:
        """The permitted update of the estimate, as the ground may carry part of the weight."""
        if not self.state.is_flying or self._has_just_left:
            return UpdateMode.HOLD
        might_touch = self._lands or self._little_since_ns is not None
        if might_touch or self.state is GroundState.TOUCHING_DOWN:
            return UpdateMode.VELOCITY_ONLY
        return UpdateMode.LEARN

    def update(
        self, odometry: OdometrySample, *, thrust: float, window: ReferenceWindow | None
    ) -> GroundState:
        """Update the state by an odometry.

        Args:
            odometry: The newest odometry.
            thrust: Modelled thrust of the active command, as a share of the weight.
            window: The reference, if there is one.
        """
        if not self._engaged:
            self.state = GroundState.ON_GROUND if self.landed else GroundState.UNKNOWN
            self._stood_at = float(odometry.p_WB[2]) if self.landed else self._stood_at
        elif self._stamp_ns != odometry.stamp_ns:
            self._follow(odometry, thrust)
            self.state = next_state(self.state, self._evidence(odometry, window))
            self._follow_ground(odometry)
        return self.state

    def _follow(self, odometry: OdometrySample, thrust: float) -> None:
        """Update the filters of motion and thrust."""
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
            is_flying=self.state.is_flying,
        )
        self._thrust = max(thrust, 0.0)  # the curve may be negative at throttle 0
        little, lift = thrust <= NO_LIFT, self._motion.now.lift
        lifts = lift >= (_LIFT_OFF_LIFT if self.state.is_on_ground else _FLIGHT_LIFT)
        stamp_ns = odometry.stamp_ns
        self._little_since_ns = since(self._little_since_ns, stamp_ns) if little else None
        self._lifting_since_ns = since(self._lifting_since_ns, stamp_ns) if lifts else None

    def _evidence(
        self, odometry: OdometrySample, window: ReferenceWindow | None
    ) -> tuple[GroundEvidence, ...]:
        """Return the evidence for a change of the state."""
        self._climbs = self._lands = False
        if self._crash.update(odometry.stamp_ns, self._motion.now):
            return (GroundEvidence.LIES,)
        found: tuple[GroundEvidence, ...] = ()
        height = float(odometry.p_WB[2])
        wanted = self._wanted_motion(window, height)
        climbs_later = wanted.highest > wanted.height + _MIN_HEIGHT_CHANGE
        self._climbs = wanted.highest > height + HEIGHT or climbs_later
        below = wanted.height < height - HEIGHT
        rests = not self._climbs and (wanted.speed < _MOVING_SPEED or below)
        self._lands = rests and (below or wanted.sinks) and self._is_low(height)
        if self._climbs:
            found += (GroundEvidence.CLIMBS,)
        touches = below and self._might_be_down(height, sinks=wanted.sinks)
        if rests and (touches or self._meets_ground(wanted)):
            found += (GroundEvidence.TOUCHES,)
        if self._has_left() or self._is_moving():
            found += (GroundEvidence.LEFT,)
        elif self._rests(odometry.stamp_ns, wanted=rests):
            found += (GroundEvidence.RESTS,)
        return found

    def _wanted_motion(self, window: ReferenceWindow | None, height: float) -> _WantedMotion:
        """Return the motion of the reference; without one it holds the vehicle's height [m]."""
        if self.idle_wanted:
            return _WantedMotion()
        if window is None:
            return _WantedMotion(height, height)
        if window is not self._window:
            self._window, heights = window, window.p_WB[:, 2].tolist()
            self._wanted = _WantedMotion(
                height=heights[0],
                highest=max(heights),
                sinks=min(heights) < heights[0] - _MIN_HEIGHT_CHANGE,
                speed=kernels.largest_length(window.v_WB_W),
                climb=window.v_WB_W[0, 2],
            )
        return self._wanted

    def _follow_ground(self, odometry: OdometrySample) -> None:
        """Update the position on the ground, as the estimate drifts."""
        stamp_ns = odometry.stamp_ns
        if self.state.is_on_ground:
            self._stood_at, self._stood_ns = float(odometry.p_WB[2]), stamp_ns
        stood_ns = self._stood_ns
        self._has_just_left = stood_ns is not None and 0 <= stamp_ns - stood_ns < _LIFT_OFF_NS
        if self.state.is_on_ground and self._little_since_ns is not None:
            self._motion.draw_ground(fast=True)  # certainly not lifted off
        elif not (self.state.is_flying or self._climbs):
            self._motion.draw_ground(fast=False)
        elif self.state.is_on_ground:
            # The estimate may sink while motors spool up, which would hide the lift-off.
            self._motion.lower_ground()

    def _rests(self, stamp_ns: int, *, wanted: bool) -> bool:
        """Whether a landing is reported, or the height is held with too little thrust to fly."""
        since_ns = self._little_since_ns
        idle = since_ns is not None and stamp_ns - since_ns >= round(1e9 * SETTLING)
        if not (wanted and idle and self._motion.now.speed < SLOW):
            self._still.forget()
            return False
        fall = (1.0 - (1.0 + THRUST_ERROR) * self._thrust - GUST) * self._gravity
        kept = self._still.lasts(stamp_ns, self._motion.now.height, fall)
        return bool(self.landed) or kept

    def _might_be_down(self, height: float, *, sinks: bool) -> bool:
        """Whether the vehicle is slow, and possibly on the ground.

        Contact means: the reference requests idle, thrust is low near the ground, or the vehicle
        does not descend with the reference. Neither does a hover with more thrust than before.
        """
        low = self._little_since_ns is not None and self._is_low(height)
        carried = sinks and self._motion.now.carried
        return self._motion.now.speed < SLOW and (carried or self.idle_wanted or low)

    def _meets_ground(self, wanted: _WantedMotion) -> bool:
        """Whether a landing has just met the ground, before the reference is far below it.

        On the ground the reported velocity still drifts. Tilting against the drift would only
        make the vehicle lean. Where the ground is unknown or higher, the impact must have stopped
        the descent although the reference sinks.
        """
        motion = self._motion.now
        behind = motion.climb > _STOPPED_SHARE * wanted.climb
        stays = wanted.sinks and behind and abs(motion.climb) < _STOPPED
        stopped = stays and motion.recent_climb < -_MIN_STOP and motion.impact > _MIN_STOP
        near = self._lands and motion.impact > _MIN_IMPACT
        remains = self.state is GroundState.TOUCHING_DOWN and stays
        return motion.speed < SLOW and (near or stopped or remains)

    def _is_low(self, height: float) -> bool:
        """Whether the vehicle is near the height of the ground."""
        stood = self._stood_at is not None and height < self._stood_at + _NEAR_GROUND
        return bool(self.landed) or stood

    def _is_moving(self) -> bool:
        """Whether the vehicle is faster than noise, which alone does not change the height."""
        motion = self._motion.now
        shifted = not -HEIGHT <= motion.rise <= HEIGHT
        return motion.speed > (_MOVING_SPEED if shifted else FAST)

    def _has_left(self) -> bool:
        """Whether the vehicle has left its initial or ground position by thrust."""
        since_ns, stamp_ns, motion = self._lifting_since_ns, self._stamp_ns, self._motion.now
        assert stamp_ns is not None
        if since_ns is not None and stamp_ns - since_ns >= _SPOOL_UP_NS:
            return True
        if self._little_since_ns is not None or self.state.is_flying:
            return False
        if not self.state.is_on_ground:
            return motion.displacement > LEFT_GROUND
        climbs = motion.climb > _CLIMB_SPEED and motion.rise > 0.5 * HEIGHT
        by_thrust = self._thrust > _FLIGHT_LIFT and (climbs or motion.aside > _SLIPPING_SPEED)
        return by_thrust or motion.rise > LEFT_GROUND
