# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The sequence of the reference: take-off, hold, trajectory, goal, landing.

A state machine over a :class:`Timeline`, without ROS and clock. A request is either accepted and
joined to the current reference without a jump, or rejected with a reason and without effect.
Transitions are checked against the vehicle's limits. Only hold and land are never rejected in the
air: the transition that exceeds the limits least is flown, and an inverted vehicle first continues
until upright.

On the ground the reference rests at the vehicle.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.estimation.ground_state import HEIGHT
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.references.bounds import YAW_SHARE
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.feasibility import Feasibility, judged
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.minimum_snap import End, Leg
from quad_mpc_ros.references.path import RestPath, Straight
from quad_mpc_ros.references.timeline import Phase, Timeline
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.references.transition import FlatState, flat_state_of, take_off_path, transition
from quad_mpc_ros.references.velocity import (
    STEP_NS,
    VelocityCommand,
    VelocityLimits,
    VelocityPath,
    first_points,
    followed,
)

GROUND, TAKEOFF, HOLD = "ground", "takeoff", "hold"
GOING, TRACKING, LANDING = "going", "tracking", "landing"
VELOCITY = "velocity"
_VERTICAL_SPEED = 1.0  # m/s, from and to the ground
_FLARE_HEIGHT = 0.5  # m above the ground, below which the touchdown speed applies
_STOP_SHARES = (1.0, 0.7, 0.5, 0.35, 0.25)  # of the acceleration, tried for a stop
_UPRIGHT_STEP_NS, _UPRIGHT_WITHIN_NS = 20_000_000, 10_000_000_000
_STOP_DELAY_NS, _STOP_TRIALS = 100_000_000, 6
_UPSIDE_DOWN_COST = 1e3  # above any excess
_FIRST_START_NS = -(2**62)
_REST_SPEED = 0.05  # m/s, below which no stop is needed
_MAX_SPEED = 1e3  # m/s; faster odometry is wrong
_STOP_PEAK = 1.9  # slightly above the peak of a stop's acceleration over its mean
_SHORTEST_STOP = 0.5  # s


@dataclass(frozen=True, kw_only=True)
class Reply:
    """Whether a request was accepted, and the result or the reason."""

    accepted: bool
    text: str


INVERTED = Reply(accepted=False, text="rejected while the vehicle is upside down: try again")
TOO_LATE = Reply(accepted=False, text="planning took too long")


class Director:
    """The reference of one vehicle over ground of the height ``ground`` [m]."""

    def __init__(self, config: ReferenceConfig, first: Phase, *, ground: float) -> None:
        self._config = config
        self.ground = ground
        """Height of the ground [m]."""
        self.too_late: Callable[[int], bool] = lambda start_ns: False
        """Whether a start time is already too late; checked once a plan is ready."""
        self.timeline = Timeline([first])
        self._following: tuple[Phase, VelocityPath] | None = None

    @classmethod
    def on_ground(cls, config: ReferenceConfig, *, p_WB: Array, yaw: float) -> Director:
        """Return the director of a vehicle on the ground at ``p_WB`` (3,) [m]."""
        rest = _at_rest(config, p_WB, yaw)
        first = Phase(start_ns=_FIRST_START_NS, name=GROUND, trajectory=rest)
        return cls(config, first, ground=float(p_WB[2]))

    @classmethod
    def flying(cls, config: ReferenceConfig, trajectory: Trajectory, *, start_ns: int) -> Director:
        """Return the director of a vehicle that flies a trajectory, over ground of height 0."""
        first = Phase(start_ns=start_ns, name=TRACKING, trajectory=trajectory)
        return cls(config, first, ground=0.0)

    @classmethod
    def stopping(
        cls, config: ReferenceConfig, start: FlatState, *, start_ns: int, ground: float
    ) -> Director:
        """Return the director of a vehicle in flight that comes to rest."""
        here = _at_rest(config, start.p_WB, start.yaw)
        director = cls(
            config, Phase(start_ns=_FIRST_START_NS, name=HOLD, trajectory=here), ground=ground
        )
        speed = math.hypot(*start.end.v_WB_W)
        if _REST_SPEED < speed < _MAX_SPEED:
            # Closed form, not the quickest: it is planned at every window.
            seconds = max(_STOP_PEAK * speed / config.max_acceleration, _SHORTEST_STOP)
            path = Leg(start.end, End.at_rest(None), duration=seconds)
            leg = FlatTrajectory(path, config, yaw=start.yaw)
            phase = Phase(start_ns=start_ns, name=GOING, trajectory=leg)
            director._follow(start_ns, [phase], HOLD, None)
        return director

    def mode(self, now_ns: int) -> str:
        """Return the name of the present phase."""
        return self.timeline.phase(now_ns).name

    def sink(self, now_ns: int, *, p_WB: Array, yaw: float) -> None:
        """Make a flying vehicle descend while the reference is on the ground."""
        down = Straight(p_WB, v_WB_W=np.array([0.0, 0.0, -self._config.touchdown_speed]))
        trajectory = FlatTrajectory(down, self._config, yaw=yaw)
        self.timeline.follow([Phase(start_ns=now_ns, name=LANDING, trajectory=trajectory)])

    def rest_on_ground(self, now_ns: int, *, p_WB: Array, yaw: float) -> None:
        """From now on, rest at the position (3,) [m] of a vehicle on the ground."""
        self.ground = float(p_WB[2])
        rest = _at_rest(self._config, p_WB, yaw)
        self.timeline.follow([Phase(start_ns=now_ns, name=GROUND, trajectory=rest)])

    def reset_estimate(self, now_ns: int, reset: EstimateReset) -> bool:
        """Apply an announced odometry jump; return whether the reference is transformed.

        Hold, velocity, take-off and landing are relative to the vehicle and are transformed. A
        trajectory or goal keeps its world coordinates.
        """
        self.ground += float(reset.step_W[2])
        moves = self.mode(now_ns) in (GROUND, TAKEOFF, HOLD, LANDING, VELOCITY)
        self._following = None  # the next command starts in the new coordinates
        if moves:
            self.timeline.reset_estimate(reset)
        return moves

    def take_off(self, now_ns: int) -> Reply:
        """Climb to the configured height above the ground, and hold.

        Raises :class:`UserError` for a height outside the fence.
        """
        if self.mode(now_ns) != GROUND:
            return self._refused(now_ns, "take-off")
        p_WB = self.timeline.at([now_ns]).p_WB[0]
        height = self.ground + self._config.takeoff_height
        self._config.fence.check_inside(np.array([[*p_WB[:2], height]]))
        path = take_off_path(
            p_WB,
            height=height,
            checks=self._config.takeoff_check,
            max_speed=min(self._config.max_speed, _VERTICAL_SPEED),
            max_acceleration=min(self._config.max_acceleration, 0.5 * self._config.gravity),
        )
        leg = FlatTrajectory(path, self._config, yaw=flat_state_of(self.timeline, now_ns).yaw)
        return self._follow_if_feasible(now_ns, TAKEOFF, leg, then=HOLD)

    def slipped(self, now_ns: int, *, p_WB: Array) -> None:
        """Move a take-off above a vehicle that slips or drifts before lift-off."""
        if self.mode(now_ns) != TAKEOFF or self.timeline.last.name != HOLD:
            return
        slip = np.array([*(p_WB - self.timeline.at([now_ns]).p_WB[0])[:2], 0.0])
        if np.linalg.norm(slip) > HEIGHT:
            moved = EstimateReset(stamp_ns=now_ns, turn=0.0, step_W=slip)
            self.timeline.reset_estimate(moved)

    def fly(self, now_ns: int, trajectory: Trajectory) -> Reply:
        """Go to the beginning of a trajectory, matching its initial motion, and fly it."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "start")
        start = flat_state_of(trajectory, 0)
        return self._go(now_ns, GOING, start, then=TRACKING, trajectory=trajectory)

    def hold(self, now_ns: int) -> Reply:
        """Come to rest as soon as the limits allow, and hold."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "hold")
        stop = self._stop(now_ns, GOING)
        return self._follow(now_ns, [stop], HOLD, None)

    def go_to(self, now_ns: int, *, p_WB: Array, yaw: float) -> Reply:
        """Go to a position (3,) [m] and heading [rad], and hold."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "goal")
        return self._go(now_ns, GOING, FlatState.at_rest(p_WB, yaw=yaw), then=HOLD)

    def follow_velocity(
        self, now_ns: int, command: VelocityCommand, limits: VelocityLimits, *, timeout: float
    ) -> Reply | None:
        """Follow a velocity until a timeout [s], then brake and hold; None without a new phase.

        A zero velocity ends only a motion that a velocity started.
        """
        phase = self.timeline.phase(now_ns)
        if phase.name in (GROUND, TAKEOFF, LANDING):
            return self._refused(now_ns, "velocity") if command.moves else None
        begins = self._following is None or phase is not self._following[0]
        if begins:
            if not command.moves:
                return None
            state = flat_state_of(self.timeline, now_ns)
            if state.inverted:
                return INVERTED
            start_ns, known = now_ns, first_points(state)
        else:
            assert self._following is not None
            steps = (now_ns - phase.start_ns) // STEP_NS
            start_ns = phase.start_ns + steps * STEP_NS
            known = self._following[1].fixed(steps)
        path = followed(known, command, limits, held=1e-9 * (now_ns - start_ns) + timeout)
        try:
            trajectory = FlatTrajectory(path, self._config)
        except ValueError as error:
            return _infeasible(str(error))
        following = Phase(start_ns=start_ns, name=VELOCITY, trajectory=trajectory)
        reply = self._follow(now_ns, [following], HOLD, None)
        if not reply.accepted:
            return reply
        self._following = following, path
        return Reply(accepted=True, text="follows it") if begins else None

    def land(self, now_ns: int) -> Reply:
        """Come to rest, descend, and sink until touchdown."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "landing")
        stop = self._stop(now_ns, LANDING)
        above = _end_of(stop.trajectory)
        sinking = self._sinking(above)
        leg = self._leg(LANDING, above, sinking)
        descent_ns = stop.start_ns + stop.trajectory.period_ns
        descent = Phase(start_ns=descent_ns, name=LANDING, trajectory=leg)
        # A leg that is too low for a descent ends where it has reached the speed of sinking.
        lowest = leg.at([leg.period_ns - 1]).p_WB[0]
        down = Straight(lowest, v_WB_W=sinking.end.v_WB_W)
        trajectory = FlatTrajectory(down, self._config, yaw=above.yaw)
        reply = self._follow(now_ns, [stop, descent], LANDING, trajectory)
        if not reply.accepted:
            return reply
        still = max(float(lowest[2]) - self.ground, 0.0) / self._config.touchdown_speed
        seconds = 1e-9 * (self.timeline.last.start_ns - now_ns) + still
        return Reply(accepted=True, text=f"touchdown in about {seconds:.1f} s")

    def touched(self, now_ns: int, *, p_WB: Array) -> Reply:
        """End a landing at ``p_WB`` (3,) [m] on the ground, with idle motors."""
        if self.mode(now_ns) != LANDING:
            return self._refused(now_ns, "touchdown")
        self.rest_on_ground(now_ns, p_WB=p_WB, yaw=flat_state_of(self.timeline, now_ns).yaw)
        return Reply(accepted=True, text=f"{GROUND} at {self.ground:.2f} m")

    def is_sinking(self, now_ns: int) -> bool:
        """Return whether a landing is in progress, without a touchdown yet."""
        return self.mode(now_ns) == LANDING == self.timeline.last.name

    def resting_height(self, now_ns: int) -> float:
        """Return the height [m] of the current or next rest, else the current height."""
        last = self.timeline.last
        if self.mode(now_ns) == LANDING:
            return self.ground + self._config.takeoff_height
        time_ns = last.start_ns if last.name == HOLD else now_ns
        return float(self.timeline.at([max(time_ns, now_ns)]).p_WB[0, 2])

    def _sinking(self, above: FlatState) -> FlatState:
        """Return the flat state in which a landing from a hover above starts to sink."""
        flare = np.array([*above.p_WB[:2], self.ground + _FLARE_HEIGHT])
        rest = End.at_rest(flare if above.p_WB[2] > flare[2] + _FLARE_HEIGHT else None)
        v_WB_W = np.array([0.0, 0.0, -self._config.touchdown_speed])
        return FlatState(end=dataclasses.replace(rest, v_WB_W=v_WB_W), yaw=above.yaw)

    def _go(
        self,
        now_ns: int,
        name: str,
        goal: FlatState,
        *,
        then: str,
        trajectory: Trajectory | None = None,
    ) -> Reply:
        """Fly a leg from the current motion to a goal, then a trajectory, or hold at the goal."""
        start = flat_state_of(self.timeline, now_ns)
        if start.inverted:
            return INVERTED
        try:
            leg = self._leg(name, start, goal)
        except ValueError as error:
            return _infeasible(str(error))
        return self._follow_if_feasible(now_ns, name, leg, then=then, trajectory=trajectory)

    def _follow_if_feasible(
        self,
        now_ns: int,
        name: str,
        leg: FlatTrajectory,
        *,
        then: str,
        trajectory: Trajectory | None = None,
    ) -> Reply:
        """From now on follow a feasible leg, then a trajectory, or hold at the end of the leg."""
        verdict = self._judged(name, leg)
        if not verdict.feasible:
            return _infeasible(verdict.reason())
        if not leg.upright:
            return _infeasible("the path is inverted")
        phase = Phase(start_ns=now_ns, name=name, trajectory=leg)
        return self._follow(now_ns, [phase], then, trajectory)

    def _follow(
        self, now_ns: int, phases: list[Phase], then: str, trajectory: Trajectory | None
    ) -> Reply:
        """Follow phases, and then a named trajectory, or hold at the end of the last phase.

        A plan that is not ready before its start time is rejected.
        """
        if self.too_late(now_ns):
            return TOO_LATE
        last = phases[-1]
        if trajectory is None:
            end = _end_of(last.trajectory)
            trajectory = _at_rest(self._config, end.p_WB, end.yaw)
        arrival_ns = last.start_ns + last.trajectory.period_ns
        self.timeline.follow(
            [*phases, Phase(start_ns=arrival_ns, name=then, trajectory=trajectory)]
        )
        return Reply(accepted=True, text=f"{then} in {1e-9 * (arrival_ns - now_ns):.1f} s")

    def _stop(self, now_ns: int, name: str) -> Phase:
        """Return the phase of a stop that exceeds the limits least.

        The stop begins when the reference is upright, or later if it would turn upside down.
        """
        first_ns = self._upright_from(now_ns)
        stops = [self._stop_from(first_ns, name)]
        for k in range(1, _STOP_TRIALS):
            if stops[-1][0] < _UPSIDE_DOWN_COST:
                break
            stops.append(self._stop_from(first_ns + k * _STOP_DELAY_NS, name))
        return min(stops, key=lambda stop: stop[0])[1]

    def _stop_from(self, begin_ns: int, name: str) -> tuple[float, Phase]:
        """Return the excess of the best stop from a time on, and the stop."""
        start = flat_state_of(self.timeline, begin_ns)
        rest = FlatState.at_rest(None, yaw=start.yaw)
        found: list[tuple[float, FlatTrajectory]] = []
        for share in _STOP_SHARES:
            leg = self._leg(name, start, rest, share=share)
            found.append((self._excess(name, leg), leg))
            if found[-1][0] == 0.0:
                break
        excess, leg = min(found, key=lambda each: each[0])
        return excess, Phase(start_ns=begin_ns, name=name, trajectory=leg)

    def _upright_from(self, now_ns: int) -> int:
        """Return the first time from now on at which the reference is not upside down."""
        for time_ns in range(now_ns, now_ns + _UPRIGHT_WITHIN_NS, _UPRIGHT_STEP_NS):
            if not flat_state_of(self.timeline, time_ns).inverted:
                return time_ns
        return now_ns

    def _excess(self, name: str, leg: FlatTrajectory) -> float:
        """Return the sum of the relative excesses over the limits; 0 for a feasible leg."""
        needs = self._judged(name, leg).exceeded
        share = sum(abs(need.margin) / max(abs(need.limit), 1.0) for need in needs)
        return float(share) + (0.0 if leg.upright else _UPSIDE_DOWN_COST)

    def _judged(self, name: str, leg: FlatTrajectory) -> Feasibility:
        ground = -np.inf if _is_vertical(name) else self.ground
        return judged(leg, self._config, ground=ground)

    def _leg(
        self, name: str, start: FlatState, goal: FlatState, *, share: float = 1.0
    ) -> FlatTrajectory:
        """Return a leg with a ``share`` of ``max_acceleration``."""
        path = transition(
            start,
            goal,
            max_speed=min(
                self._config.max_speed, _VERTICAL_SPEED if _is_vertical(name) else np.inf
            ),
            max_acceleration=share * self._config.max_acceleration,
            max_yaw_rate=YAW_SHARE * self._config.rate_limits[2],
        )
        return FlatTrajectory(path, self._config)

    def _airborne(self, now_ns: int) -> bool:
        return self.mode(now_ns) != GROUND

    def _refused(self, now_ns: int, request: str) -> Reply:
        return Reply(accepted=False, text=f"{request} is rejected in mode {self.mode(now_ns)}")


def _infeasible(reason: str) -> Reply:
    return Reply(accepted=False, text=f"no feasible path: {reason}")


def _is_vertical(name: str) -> bool:
    """Return whether a leg starts or ends on the ground, slowly."""
    return name in (TAKEOFF, LANDING)


def _at_rest(config: ReferenceConfig, p_WB: Array, yaw: float) -> FlatTrajectory:
    return FlatTrajectory(RestPath(p_WB, duration=1.0), config, yaw=yaw)


def _end_of(trajectory: Trajectory) -> FlatState:
    return flat_state_of(trajectory, trajectory.period_ns)
