"""Who is to fly what, when: take-off, hold, the trajectory, a goal, landing.

A state machine over a :class:`Timeline`, told the time and without ROS. Every request either is
accepted, and then what it asks for is joined to the present reference without a jump, or is
refused with the reason and changes nothing: a transition is judged against the vehicle's limits
as a trajectory is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.core.messages import Array
from quad_mpc_ros.references.catalogue import limits_of
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.feasibility import judged
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.path import Path
from quad_mpc_ros.references.timeline import Phase, Timeline
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.references.transition import Motion, motion_of, transition
from quad_mpc_ros.references.waypoints import Rest

GROUND, TAKEOFF, HOLD, GOING, TRACKING, LANDING = (
    "ground",
    "takeoff",
    "hold",
    "going",
    "tracking",
    "landing",
)
_VERTICAL_SPEED = 1.0  # m/s, from and to the ground
_YAW_SHARE = 0.5  # of the limit

_Wanted = tuple[str, Motion, Motion]
"""The name of a leg, and the motions that it leads from and to."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Whether a request was accepted, and what is done or why not."""

    accepted: bool
    text: str


class Director:
    """Directs one vehicle, which stands on the ground at ``p_WB`` (3,) [m] at first."""

    def __init__(
        self, config: ReferenceConfig, trajectory: Trajectory, *, p_WB: Array, yaw: float
    ) -> None:
        self._config = config
        self._trajectory = trajectory
        self._ground = float(p_WB[2])
        rest = self._at_rest(p_WB, yaw)
        self.timeline = Timeline(Phase(start_ns=-(2**62), name=GROUND, trajectory=rest))

    def mode(self, now_ns: int) -> str:
        """Return what is being flown."""
        return self.timeline.phase(now_ns).name

    def take_off(self, now_ns: int, *, height: float) -> Answer:
        """Climb to ``height`` [m] above the ground, and hold."""
        if self.mode(now_ns) != GROUND:
            return self._refused(now_ns, "take-off")
        if not 0.0 < height < np.inf:
            return Answer(accepted=False, text=f"take-off to {height} m, expected a number > 0")
        start = motion_of(self.timeline, now_ns)
        above = self.timeline.at([now_ns]).p_WB[0] + [0.0, 0.0, height]
        goal = Motion.at_rest(above, yaw=start.yaw)
        return self._go(now_ns, [(TAKEOFF, start, goal)], then=HOLD)

    def start(self, now_ns: int) -> Answer:
        """Go to the beginning of the trajectory, in the motion that it begins with, and fly it."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "start")
        legs = [(GOING, motion_of(self.timeline, now_ns), motion_of(self._trajectory, 0))]
        return self._go(now_ns, legs, then=TRACKING, trajectory=self._trajectory)

    def hold(self, now_ns: int) -> Answer:
        """Come to rest as soon as the limits let it, and stay there."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "hold")
        start = motion_of(self.timeline, now_ns)
        return self._go(now_ns, [(GOING, start, Motion.at_rest(None, yaw=start.yaw))], then=HOLD)

    def go_to(self, now_ns: int, *, p_WB: Array, yaw: float) -> Answer:
        """Go to a place (3,) [m] and heading [rad], and stay there."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "goal")
        if not np.all(np.isfinite([*p_WB, yaw])):
            return Answer(accepted=False, text=f"goal {[*p_WB, yaw]}, expected finite numbers")
        legs = [(GOING, motion_of(self.timeline, now_ns), Motion.at_rest(p_WB, yaw=yaw))]
        return self._go(now_ns, legs, then=HOLD)

    def land(self, now_ns: int) -> Answer:
        """Come to rest, descend to the ground where that is, and stay there."""
        if not self._airborne(now_ns):
            return self._refused(now_ns, "landing")
        start = motion_of(self.timeline, now_ns)
        stop = [(LANDING, start, Motion.at_rest(None, yaw=start.yaw))]
        planned = self._planned(now_ns, stop)
        if isinstance(planned, Answer):
            return planned
        above = _end_of(planned[-1].trajectory)
        assert above.end.p_WB is not None
        ground = np.array([*above.end.p_WB[:2], self._ground])
        descent = (LANDING, above, Motion.at_rest(ground, yaw=above.yaw))
        return self._go(now_ns, [*stop, descent], then=GROUND)

    def _go(
        self, now_ns: int, legs: list[_Wanted], *, then: str, trajectory: Trajectory | None = None
    ) -> Answer:
        """Fly legs one after the other, then a trajectory, or stay where the last one ends."""
        phases = self._planned(now_ns, legs)
        if isinstance(phases, Answer):
            return phases
        last = phases[-1]
        arrival_ns = last.start_ns + last.trajectory.period_ns
        if trajectory is None:
            end = _end_of(last.trajectory)
            assert end.end.p_WB is not None
            trajectory = self._at_rest(end.end.p_WB, end.yaw)
        self.timeline.follow(
            [*phases, Phase(start_ns=arrival_ns, name=then, trajectory=trajectory)]
        )
        return Answer(accepted=True, text=f"{then} in {1e-9 * (arrival_ns - now_ns):.1f} s")

    def _planned(self, now_ns: int, legs: list[_Wanted]) -> list[Phase] | Answer:
        """Return the phases of legs one after the other, or why they cannot be flown."""
        phases, time_ns = [], now_ns
        for name, start, goal in legs:
            if start.inverted:
                return Answer(accepted=False, text="not while upside down: ask again")
            try:
                leg = self._leg(start, goal)
            except ValueError as error:
                return Answer(accepted=False, text=f"no way there: {error}")
            verdict = judged(leg, self._config.vehicle(), limits_of(self._config))
            if not verdict.feasible or not leg.upright:
                reason = verdict.reason() or "it would have to be flown upside down"
                return Answer(accepted=False, text=f"no way there: {reason}")
            phases.append(Phase(start_ns=time_ns, name=name, trajectory=leg))
            time_ns += leg.period_ns
        return phases

    def _leg(self, start: Motion, goal: Motion) -> FlatTrajectory:
        slow = start.end.p_WB is not None and self._on_the_ground(start, goal)
        path = transition(
            start,
            goal,
            max_speed=min(self._config.max_speed, _VERTICAL_SPEED if slow else np.inf),
            max_acceleration=self._config.max_acceleration,
            max_yaw_rate=_YAW_SHARE * self._config.omega_max[2],
        )
        return self._flown(path, 0.0)

    def _on_the_ground(self, *motions: Motion) -> bool:
        """Return whether one of two ends is on the ground."""
        heights = [motion.end.p_WB[2] for motion in motions if motion.end.p_WB is not None]
        return any(height <= self._ground for height in heights)

    def _at_rest(self, p_WB: Array, yaw: float) -> FlatTrajectory:
        return self._flown(Rest(p_WB, duration=1.0), yaw)

    def _flown(self, path: Path, yaw: float) -> FlatTrajectory:
        config = self._config
        return FlatTrajectory(path, gravity=config.gravity, drag=config.drag, yaw=yaw)

    def _airborne(self, now_ns: int) -> bool:
        return self.mode(now_ns) != GROUND

    def _refused(self, now_ns: int, request: str) -> Answer:
        return Answer(accepted=False, text=f"no {request} while in {self.mode(now_ns)}")


def _end_of(trajectory: Trajectory) -> Motion:
    return motion_of(trajectory, trajectory.period_ns)
