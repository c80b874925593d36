# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference of a live flight: requests and odometry in, windows out; without ROS.

With ``at_once`` the configured trajectory starts at the first odometry and is flown until a
request is accepted. With ``on_request`` the vehicle idles on the ground until a take-off.

If ``engaged`` is published, the reference waits until the vehicle executes commands: on the ground
with idle motors, in the air coming to rest from the current motion. Then the reference continues
from there: ``on_request`` holds, ``at_once`` starts the trajectory, after a take-off if on the
ground. When the vehicle stops executing commands, the reference waits again.

The MPC's ground state decides whether the vehicle is on the ground
(:meth:`LiveReference.set_ground_state`). If the state is unknown, the flight stack's report is
used; without a report, until a take-off, the height of the first odometry. Only the first two end
a landing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.estimation.ground_state import (
    HEIGHT,
    LEFT_GROUND,
    LEFT_GROUND_UNPOWERED,
    GroundHeight,
    GroundState,
    idling,
)
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.validation import pose_fault
from quad_mpc_ros.references.bounds import velocity_limits
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import received_trajectory
from quad_mpc_ros.references.director import GROUND, LANDING, Director, Reply
from quad_mpc_ros.references.feasibility import judged
from quad_mpc_ros.references.flatness import yaw_of
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.references.timeline import Timeline
from quad_mpc_ros.references.trajectory import Trajectory, TrajectorySamples
from quad_mpc_ros.references.transition import FlatState
from quad_mpc_ros.references.velocity import VelocityCommand

_MAX_DRAWN_POSES = 500
_SAMPLE_STEP_NS = 50_000_000

_NOT_YET = Reply(accepted=False, text="no usable odometry yet")
_NOT_ENGAGED = Reply(
    accepted=False, text="the vehicle does not execute commands: engage and arm it first"
)
WAITING = "waiting"

R = TypeVar("R", bound="Reply | None")


class Published(NamedTuple):
    """An immutable snapshot of the reference, from which windows are cut.

    On the ground they request idle motors (``docs/explanation/landing_detection.md``).
    """

    server: ReferenceServer
    timeline: Timeline | None  # phases; None for the configured trajectory
    gravity: float
    version: object
    """The same object while earlier windows are valid; None if every window differs."""

    def window(self, stamp_ns: int) -> ReferenceWindow:
        """Return the reference from ``stamp_ns`` on."""
        window, timeline = self.server.window(stamp_ns), self.timeline
        if timeline is None or not timeline.last.name == GROUND == timeline.phase(stamp_ns).name:
            return window
        return idling(window, self.gravity)

    def changes(self, after_ns: int, until_ns: int) -> bool:
        """Whether the reference jumps between two times without preview."""
        return self.server.changes(after_ns, until_ns)


class _Configured(NamedTuple):
    """The configured trajectory, held at its beginning without a director."""

    server: ReferenceServer
    director: Director | None


class _Waiting(NamedTuple):
    """The odometry at which the reference waits, and the height of the ground [m], if known."""

    odometry: OdometrySample
    on_ground: bool
    ground: float | None


class LiveReference:
    """The reference of one vehicle.

    ``trajectory`` is flown at once; ``joined`` returns the trajectory without jumps that is flown
    on request. Times are nanoseconds of the windows' clock, and do not decrease.

    One thread makes requests and passes odometry. :attr:`published` and :meth:`window` are safe in
    any thread, as they depend on ``_source`` only, which is replaced atomically.
    """

    def __init__(
        self, config: ReferenceConfig, trajectory: Trajectory, *, joined: Callable[[], Trajectory]
    ) -> None:
        self._config = config
        self.trajectory = trajectory
        """The trajectory in the mode ``at_once``."""
        self._joined = joined
        self._at_once = config.mode == "at_once"
        held = _Configured(ReferenceServer(config, trajectory), None)
        self._source: _Configured | _Waiting | Director | None = held if self._at_once else None
        self._home = np.zeros(3)
        self._newest: OdometrySample | None = None
        self._engaged: bool | None = None
        self._landed: bool | None = None
        self._ground = GroundState.UNKNOWN
        self._ground_height = GroundHeight(LEFT_GROUND_UNPOWERED)
        self.too_late: Callable[[int], bool] = lambda start_ns: False
        """Whether it is too late to start at a time; such requests are rejected."""

    @property
    def _director(self) -> Director | None:
        """The director of the flight, once started."""
        source = self._source
        if isinstance(source, _Configured):
            return source.director
        return source if isinstance(source, Director) else None

    @property
    def started(self) -> bool:
        """Whether an odometry was received, and the vehicle executes commands as far as known."""
        return self._director is not None

    @property
    def waits(self) -> bool:
        """Whether the reference waits at the vehicle, which does not execute commands."""
        return self._engaged is False

    def engage(self, engaged: bool) -> Reply | None:
        """Set whether the vehicle executes commands; return the resulting reply, if any."""
        before, self._engaged = self._engaged, engaged
        if not engaged:
            self._source, self._at_once = self._waiting, self._config.mode == "at_once"
            return None if before is False else Reply(accepted=True, text="waits at the vehicle")
        waiting = self._waiting
        if before is not False or waiting is None:
            self._wait()
            return None
        return self._take_over(waiting)

    def landed(self, landed: bool | None) -> None:
        """Set whether the flight stack reports a landing; None without a report."""
        self._landed = landed
        self._wait()

    def set_ground_state(self, state: GroundState) -> None:
        """Take the ground state of the MPC, which has precedence over all other sources."""
        self._ground = state
        self._wait()

    def reset_estimate(self, now_ns: int, reset: EstimateReset) -> Reply:
        """Apply an announced odometry jump; return the resulting reply, if any."""
        if self._newest is not None:
            self._newest, self._home = reset.odometry(self._newest), reset.points(self._home)
        if self._ground_height.height is not None:
            self._ground_height.height += float(reset.step_W[2])
        self._wait()
        moves = self._director is None or self._director.reset_estimate(now_ns, reset)
        stepped = f"the odometry jumps by {np.linalg.norm(reset.step_W):.2f} m"
        kept = f"{self.mode(now_ns)} keeps its position on the map"
        return Reply(accepted=moves, text=f"{stepped}: {'moves along' if moves else kept}")

    def mode(self, now_ns: int) -> str:
        """Return the name of the present phase."""
        return WAITING if self._director is None else self._director.mode(now_ns)

    def needs_odometry(self, now_ns: int) -> bool:
        """Whether the next odometry is needed: at the beginning and near the ground."""
        lifts = self._ground is GroundState.LIFTING_OFF
        return lifts or self.mode(now_ns) in (WAITING, GROUND, LANDING)

    def observe(self, odometry: OdometrySample) -> Reply | None:
        """Take a valid odometry; return a reply if it changes the phase."""
        now_ns = odometry.stamp_ns
        if self._newest is None:
            self._home = odometry.p_WB
        self._newest = odometry
        self._update_ground_height(odometry)
        if self._director is None:
            if self._engaged and self._waiting is not None:
                return self._take_over(self._waiting)
            if self._engaged is None:
                self._begin(odometry)
            self._wait()
            return None
        if self._ground is GroundState.LIFTING_OFF:
            self._director.slipped(now_ns, p_WB=odometry.p_WB)
        if self._director.is_sinking(now_ns) and self._is_down(self._director, odometry):
            self._ground_height.set(float(odometry.p_WB[2]))
            return self._director.touched(now_ns, p_WB=odometry.p_WB)
        if self._director.timeline.last.name == GROUND and self._ground is GroundState.FLYING:
            self._director.sink(now_ns, p_WB=odometry.p_WB, yaw=_heading(odometry))
            return Reply(accepted=True, text="in flight: descends to the ground")
        return None

    def _is_down(self, director: Director, odometry: OdometrySample) -> bool:
        """Whether a landing has reached the ground."""
        if self._ground is not GroundState.UNKNOWN or self._landed is not True:
            return self._ground.is_on_ground
        reference_height = float(director.timeline.at([odometry.stamp_ns]).p_WB[0, 2])
        return float(odometry.p_WB[2]) - reference_height > LEFT_GROUND

    @property
    def published(self) -> Published | None:
        """The current reference; None without odometry."""
        source, gravity = self._source, self._config.gravity
        if isinstance(source, _Configured):
            return Published(source.server, None, gravity, source.server)
        if source is None:
            return None
        waits = isinstance(source, _Waiting)
        director = self._waiting_at(source) if isinstance(source, _Waiting) else source
        timeline = director.timeline.snapshot()
        server = ReferenceServer(self._config, timeline)
        server.start(0)
        return Published(server, timeline, gravity, None if waits else timeline.version)

    def window(self, stamp_ns: int) -> ReferenceWindow | None:
        """Return the reference from ``stamp_ns`` on; None without odometry."""
        published = self.published
        return None if published is None else published.window(stamp_ns)

    def planned_samples(self, now_ns: int) -> TrajectorySamples:
        """Return the planned reference from now on, for drawing; one period if periodic.

        Before the flight, return the configured trajectory.
        """
        if self._director is None:
            return ReferenceServer(self._config, self.trajectory).whole()
        last = self._director.timeline.last
        end_ns = max(last.start_ns + last.trajectory.period_ns, now_ns + _SAMPLE_STEP_NS)
        step_ns = max(_SAMPLE_STEP_NS, -(-(end_ns - now_ns) // _MAX_DRAWN_POSES))
        return self._director.timeline.at([*range(now_ns, end_ns, step_ns), end_ns])

    def take_off(self, now_ns: int) -> Reply:
        """Climb to the configured height above the ground, and hold."""

        def request(director: Director) -> Reply:
            self._follow_over_the_ground(director, now_ns)
            return director.take_off(now_ns)

        return self._requested(request)

    def start(self, now_ns: int) -> Reply:
        """Go to the configured trajectory and fly it."""
        return self._requested(lambda director: director.fly(now_ns, self._joined()))

    def hold(self, now_ns: int) -> Reply:
        """Come to rest and hold."""
        return self._requested(lambda director: director.hold(now_ns))

    def land(self, now_ns: int) -> Reply:
        """Descend to the ground and idle there."""
        return self._requested(lambda director: director.land(now_ns))

    def go_to(self, now_ns: int, *, frame_id: str, p_WB: Array, q_WB_xyzw: Array) -> Reply:
        """Go to a pose, position (3,) [m] and quaternion (4,), of which only the yaw is used.

        A height of exactly zero, as sent by two-dimensional tools, keeps the current height.
        """

        def request(director: Director) -> Reply:
            fault = pose_fault(
                frame_id=frame_id,
                expected_frame_id=self._config.frame_id,
                p_WB=p_WB[None],
                q_WB_xyzw=q_WB_xyzw[None],
            )
            if fault is not None:
                raise UserError(fault)
            height = p_WB[2] if p_WB[2] != 0.0 else director.resting_height(now_ns)
            goal = np.array([*p_WB[:2], height])
            self._check_reach(director, goal[None])
            yaw = yaw_of(so3.rotation_from_quaternion_xyzw(q_WB_xyzw))
            return director.go_to(now_ns, p_WB=goal, yaw=yaw)

        return self._requested(request)

    def follow(self, now_ns: int, message: ReferenceWindow) -> Reply:
        """Go to the beginning of a received trajectory and fly it; its stamp is ignored."""

        def request(director: Director) -> Reply:
            try:
                trajectory = received_trajectory(message, self._config)
            except ValueError as error:
                raise UserError(str(error)) from error
            verdict = judged(trajectory, self._config, ground=director.ground)
            if not verdict.feasible:
                raise UserError(verdict.reason())
            self._check_reach(director, message.p_WB)
            return director.fly(now_ns, trajectory)

        return self._requested(request)

    def move(self, now_ns: int, command: VelocityCommand) -> Reply | None:
        """Follow a velocity for ``velocity_timeout``; return a message for the log, if any.

        A velocity starts in the air, and ends any motion except a take-off and a landing.
        """
        if self._director is None and not command.moves:
            return None

        def request(director: Director) -> Reply | None:
            limits = velocity_limits(self._config, ground=director.ground, home=self._home)
            timeout = self._config.velocity_timeout
            return director.follow_velocity(now_ns, command, limits, timeout=timeout)

        return self._requested(request)

    def _requested(self, request: Callable[[Director], R]) -> Reply | R:
        """Carry out a request, which raises :class:`UserError` for bad input."""
        if self._director is None:
            return _NOT_ENGAGED if self._engaged is False else _NOT_YET
        try:
            answer = request(self._director)
        except UserError as error:
            return Reply(accepted=False, text=str(error))
        reply: Reply | None = answer
        if reply is not None and reply.accepted and self._at_once:
            self._at_once = False
            self._follow(self._director)
        return answer

    def _begin(self, odometry: OdometrySample) -> None:
        """Start at the first odometry, if no node publishes ``engaged``."""
        if self._at_once:
            self._follow_as_it_is(odometry.stamp_ns)
            return
        self._follow(Director.on_ground(self._config, p_WB=odometry.p_WB, yaw=_heading(odometry)))

    def _take_over(self, waiting: _Waiting) -> Reply:
        """Continue from the vehicle's state when the vehicle starts to execute commands."""
        director, now_ns = self._waiting_at(waiting), waiting.odometry.stamp_ns
        if self._at_once and not self.trajectory.smooth:  # it jumps anyway
            self._follow_as_it_is(now_ns)
            return Reply(accepted=True, text="begins the trajectory")
        if self._at_once:
            reply = self._begun(director, now_ns)
            self._at_once = False
        else:
            reply = Reply(accepted=True, text=f"{director.mode(now_ns)} at the vehicle's position")
        self._follow(director)
        return reply

    def _begun(self, director: Director, now_ns: int) -> Reply:
        """Begin the configured trajectory, from the ground after a take-off."""
        try:
            trajectory = self._joined()
            if director.mode(now_ns) == GROUND:
                reply = director.take_off(now_ns)
                if not reply.accepted:
                    return reply
                now_ns = director.timeline.last.start_ns
        except UserError as error:
            return Reply(accepted=False, text=str(error))
        return director.fly(now_ns, trajectory)

    def _wait(self) -> None:
        """Update the state at which the reference waits, if waiting."""
        if self._engaged is not None and self._director is None:
            self._source = self._waiting

    @property
    def _waiting(self) -> _Waiting | None:
        """State at which the reference waits; None without odometry."""
        newest = self._newest
        if newest is None:
            return None
        return _Waiting(newest, self._is_on_ground, self._ground_height.height)

    def _waiting_at(self, waiting: _Waiting) -> Director:
        """Return a director that continues from a waiting vehicle's state."""
        odometry, ground = waiting.odometry, waiting.ground
        yaw = _heading(odometry)
        if waiting.on_ground:
            return Director.on_ground(self._config, p_WB=odometry.p_WB, yaw=yaw)
        rest = FlatState.at_rest(odometry.p_WB, yaw=yaw)
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        end = dataclasses.replace(rest.end, v_WB_W=R_WB @ odometry.v_WB_B)
        return Director.stopping(
            self._config,
            dataclasses.replace(rest, end=end),
            start_ns=odometry.stamp_ns,
            ground=min(0.0, float(odometry.p_WB[2])) if ground is None else ground,
        )

    @property
    def _is_on_ground(self) -> bool:
        """Whether the vehicle is on the ground, from the sources listed in the module."""
        if self._ground is not GroundState.UNKNOWN:
            return not self._ground.is_flying
        return not self._ground_height.was_left if self._landed is None else self._landed

    def _update_ground_height(self, odometry: OdometrySample) -> None:
        """Update the height of the ground, and whether the vehicle has left it."""
        height = float(odometry.p_WB[2])
        if self._landed:
            self._ground_height.set(height)
        elif self._landed is None and self._ground_height.height is None:
            self._ground_height.set(height)  # first odometry
        else:
            self._ground_height.update(height)

    def _follow_as_it_is(self, now_ns: int) -> None:
        """Fly the configured trajectory from now on."""
        server = ReferenceServer(self._config, self.trajectory)
        server.start(now_ns)
        director = Director.flying(self._config, self.trajectory, start_ns=now_ns)
        director.too_late = self.too_late
        self._source = _Configured(server, director)

    def _follow(self, director: Director) -> None:
        """Cut the windows out of the director's timeline from now on."""
        director.too_late = self.too_late
        self._source = director

    def _follow_over_the_ground(self, director: Director, now_ns: int) -> None:
        """Move the reference to a vehicle that was carried after landing."""
        newest = self._newest
        if director.mode(now_ns) != GROUND or newest is None:
            return
        there = director.timeline.at([now_ns]).p_WB[0]
        if np.linalg.norm(newest.p_WB - there) > HEIGHT:
            director.rest_on_ground(now_ns, p_WB=newest.p_WB, yaw=_heading(newest))

    def _check_reach(self, director: Director, p_WB: Array) -> None:
        """Raise :class:`UserError` for points (n, 3) [m] too far away or below the ground."""
        lowest = float(p_WB[:, 2].min())
        if not lowest >= director.ground:
            raise UserError(f"target {director.ground - lowest:.3g} m below the ground")
        distance = float(np.linalg.norm(p_WB - self._home, axis=1).max())
        if not distance <= self._config.reach:
            raise UserError(f"target {distance:.4g} m off, beyond reach, {self._config.reach:g} m")
        self._config.fence.check_inside(p_WB)


def _heading(odometry: OdometrySample) -> float:
    return yaw_of(so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw))
