"""The reference of a live flight: requests and odometry in, windows out; without ROS.

At once, it is the configured trajectory from the first odometry on, and nothing else until a
request is accepted. On request, the vehicle stands on the ground until it is told to take off.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.safety.validation import pose_fault
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.configured import received_trajectory
from quad_mpc_ros.trajectories.director import GROUND, LANDING, Director, Reply
from quad_mpc_ros.trajectories.feasibility import judged
from quad_mpc_ros.trajectories.flatness import yaw_of
from quad_mpc_ros.trajectories.server import ReferenceServer
from quad_mpc_ros.trajectories.touchdown import Touchdown
from quad_mpc_ros.trajectories.trajectory import Trajectory, TrajectorySamples

_CARRIED = 0.1  # m
_MOST_DRAWN = 500  # poses: a path is drawn between two windows
_STEP_NS = 50_000_000

_NOT_YET = Reply(accepted=False, text="no usable odometry yet")


class LiveReference:
    """What one vehicle is to follow now and next.

    ``trajectory`` is flown at once, ``joined`` returns the one that is flown on request, which
    must not jump. Times are nanoseconds of the clock of the windows' stamps; between two calls
    they do not run backwards.
    """

    def __init__(
        self, config: ReferenceConfig, trajectory: Trajectory, *, joined: Callable[[], Trajectory]
    ) -> None:
        self._config = config
        self._trajectory = trajectory
        self._joined = joined
        self._at_once = config.mode == "at_once"
        self._server = ReferenceServer(config, trajectory)
        self._director: Director | None = None
        self._home = np.zeros(3)
        self._standing: OdometrySample | None = None
        self._touchdown = Touchdown(config.touchdown_speed)

    @property
    def started(self) -> bool:
        """Whether an odometry has come to start from."""
        return self._director is not None

    def mode(self, now_ns: int) -> str:
        """Return what is being flown."""
        return "waiting" if self._director is None else self._director.mode(now_ns)

    def needs_odometry(self, now_ns: int) -> bool:
        """Whether the next odometry makes a difference: at the beginning and near the ground."""
        return self.mode(now_ns) in ("waiting", GROUND, LANDING)

    def observe(self, odometry: OdometrySample) -> Reply | None:
        """Take an odometry; return what follows from it, if it is the first or a touchdown."""
        now_ns = odometry.stamp_ns
        if self._director is None:
            return self._begin(odometry)
        if self._director.mode(now_ns) == GROUND:
            self._standing = odometry
        if self._director.is_sinking(now_ns):
            height = float(self._director.timeline.at([now_ns]).p_WB[0, 2])
            if self._touchdown.felt(odometry, reference_height=height):
                return self._director.touched(now_ns, p_WB=odometry.p_WB)
        return None

    def window(self, stamp_ns: int) -> ReferenceWindow | None:
        """Return the reference from ``stamp_ns`` on; None while there is nothing to start from."""
        if self._director is None and not self._at_once:
            return None
        return self._server.window(stamp_ns)

    def whole(self) -> TrajectorySamples:
        """Return the trajectory that is configured, to be drawn."""
        return ReferenceServer(self._config, self._trajectory).whole()

    def course(self, now_ns: int) -> TrajectorySamples:
        """Return all that is planned from now on, to be drawn: once round what is periodic."""
        if self._director is None:
            return self.whole()
        last = self._director.timeline.last
        end_ns = max(last.start_ns + last.trajectory.period_ns, now_ns + _STEP_NS)
        step_ns = max(_STEP_NS, -(-(end_ns - now_ns) // _MOST_DRAWN))
        return self._director.timeline.at([*range(now_ns, end_ns, step_ns), end_ns])

    def take_off(self, now_ns: int) -> Reply:
        """Climb to the configured height above the ground, and hold."""
        if self._director is None:
            return _NOT_YET
        self._follow_over_the_ground(self._director, now_ns)
        return self._done(self._director.take_off(now_ns, height=self._config.takeoff_height))

    def start(self, now_ns: int) -> Reply:
        """Go to the configured trajectory and fly it."""
        if self._director is None:
            return _NOT_YET
        try:
            trajectory = self._joined()
        except UserError as error:
            return Reply(accepted=False, text=str(error))
        return self._done(self._director.fly(now_ns, trajectory))

    def hold(self, now_ns: int) -> Reply:
        """Come to rest and stay there."""
        return _NOT_YET if self._director is None else self._done(self._director.hold(now_ns))

    def land(self, now_ns: int) -> Reply:
        """Descend to the ground and idle there."""
        if self._director is None:
            return _NOT_YET
        reply = self._done(self._director.land(now_ns))
        if reply.accepted:
            self._touchdown = Touchdown(self._config.touchdown_speed)
        return reply

    def go_to(self, now_ns: int, *, frame_id: str, p_WB: Array, q_WB_xyzw: Array) -> Reply:
        """Go to a pose, position (3,) [m] and quaternion (4,), of which the heading counts.

        A height of exactly zero, which is what a tool of two dimensions sends, keeps the height.
        """
        if self._director is None:
            return _NOT_YET
        fault = pose_fault(
            frame_id=frame_id,
            expected_frame_id=self._config.frame_id,
            p_WB=p_WB[None],
            q_WB_xyzw=q_WB_xyzw[None],
        )
        if fault is not None:
            return Reply(accepted=False, text=fault)
        if p_WB[2] == 0.0:
            p_WB = np.array([*p_WB[:2], self._director.resting_height(now_ns)])
        fault = self._out_of_reach(self._director, p_WB[None])
        if fault is not None:
            return Reply(accepted=False, text=fault)
        yaw = yaw_of(so3.rotation_from_quaternion_xyzw(q_WB_xyzw))
        return self._done(self._director.go_to(now_ns, p_WB=p_WB, yaw=yaw))

    def follow(self, now_ns: int, message: ReferenceWindow) -> Reply:
        """Go to the beginning of a received trajectory and fly it; its stamp is not asked for."""
        if self._director is None:
            return _NOT_YET
        try:
            trajectory = received_trajectory(message, self._config)
        except (UserError, ValueError) as error:
            return Reply(accepted=False, text=str(error))
        verdict = judged(trajectory, self._config, ground=self._director.ground)
        fault = verdict.reason() or self._out_of_reach(self._director, message.p_WB)
        if fault:
            return Reply(accepted=False, text=fault)
        return self._done(self._director.fly(now_ns, trajectory))

    def _begin(self, odometry: OdometrySample) -> Reply | None:
        self._home = odometry.p_WB
        if self._at_once:
            self._server.start(odometry.stamp_ns)
            self._director = Director.flying(
                self._config, self._trajectory, start_ns=odometry.stamp_ns
            )
            return None
        fault = pose_fault(
            frame_id=odometry.frame_id,
            expected_frame_id=self._config.frame_id,
            p_WB=odometry.p_WB[None],
            q_WB_xyzw=odometry.q_WB_xyzw[None],
        )
        if fault is not None:
            return Reply(accepted=False, text=f"odometry is no start: {fault}")
        self._director = Director.standing(
            self._config, p_WB=odometry.p_WB, yaw=_heading(odometry)
        )
        self._direct(self._director)
        return None

    def _done(self, reply: Reply) -> Reply:
        if reply.accepted and self._at_once and self._director is not None:
            self._at_once = False
            self._direct(self._director)
        return reply

    def _direct(self, director: Director) -> None:
        """Cut the windows out of the director's timeline from now on."""
        self._server = ReferenceServer(self._config, director.timeline)
        self._server.start(0)

    def _follow_over_the_ground(self, director: Director, now_ns: int) -> None:
        """Let the reference stand where the vehicle was carried to since it landed."""
        standing = self._standing
        if director.mode(now_ns) != GROUND or standing is None:
            return
        there = director.timeline.at([now_ns]).p_WB[0]
        if np.linalg.norm(standing.p_WB[:2] - there[:2]) > _CARRIED:
            director.moved(now_ns, p_WB=standing.p_WB, yaw=_heading(standing))

    def _out_of_reach(self, director: Director, p_WB: Array) -> str | None:
        """Return which of some points (n, 3) [m] is too far away or below the ground."""
        lowest = float(p_WB[:, 2].min())
        if not lowest >= director.ground:
            return f"it is {director.ground - lowest:.3g} m below the ground"
        distance = float(np.linalg.norm(p_WB - self._home, axis=1).max())
        if not distance <= self._config.reach:
            return f"it is {distance:.4g} m away, more than reach, {self._config.reach:g} m"
        return None


def _heading(odometry: OdometrySample) -> float:
    return yaw_of(so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw))
