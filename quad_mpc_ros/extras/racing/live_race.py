"""A race with gates that move in flight: which part must be replanned, and the flown trajectory.

A way through gates that have moved is made elsewhere (:mod:`.replanning`), for that takes
longer than a tick. It leaves the present one at a state ahead, and a plan meets it again behind
the gates that have moved.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.extras.racing.gate_passages import passages
from quad_mpc_ros.extras.racing.gate_path import smooth_path
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.course import Course, Finish, Gate
from quad_mpc_ros.references.feasibility import judged
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.minimum_snap import End, Leg
from quad_mpc_ros.references.motion_table import MotionTable, PlannedMotion
from quad_mpc_ros.references.path import Turned
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.references.transition import flat_state_of

_MIN_SHIFT = 0.05  # m, of a gate's centre or edge: smaller changes are ignored
# s: a replanned part does not start within the first time before a gate, but the second after it.
_LEAVE_BEFORE_GATE, _LEAVE_AFTER_GATE = 0.15, 0.02
# Number of unmoved gates before and behind moved gates that are replanned as well.
_GATES_BEFORE, _GATES_BEHIND = 1, 2
_STEP_NS = 10_000_000  # between rows of a table
_SAMPLE_PERIOD = 0.005  # s


@dataclass(frozen=True, kw_only=True, eq=False)
class GateTrajectory:
    """A trajectory through a course, with its gate times (n,) [s] and lap time [s]."""

    trajectory: Trajectory
    course: Course
    times: Array
    lap: float

    @classmethod
    def of(cls, trajectory: Trajectory, course: Course) -> GateTrajectory:
        """Return a trajectory with its gate times. Raises :class:`UserError` if it misses one."""
        duration = 1e-9 * trajectory.period_ns
        seconds = np.linspace(0.0, duration, 2 + round(duration / _SAMPLE_PERIOD))
        p_WB = trajectory.at(np.round(1e9 * seconds).astype(np.int64).tolist()).p_WB
        lap = passages(course, seconds=seconds, p_WB=p_WB)
        times = []
        for number, passage in zip(course.numbers, lap.passages, strict=True):
            if not passage.passed or passage.time is None:
                raise UserError(f"it does not pass gate {number}")
            times.append(passage.time)
        end = duration if lap.time is None else lap.time
        return cls(trajectory=trajectory, course=course, times=np.array(times), lap=end)

    def table(self) -> MotionTable:
        """Return the trajectory in rows: its own rows, or one every 10 ms."""
        if isinstance(self.trajectory, PlannedMotion):
            return self.trajectory.table
        times = [*range(0, self.trajectory.period_ns, _STEP_NS), self.trajectory.period_ns]
        return _tabled(self.trajectory, times)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReplanRequest:
    """A part of a race to replan because gates have moved.

    Attributes:
        motion: The present trajectory, from the start of the race.
        leave: The row at which the replanned part starts.
        rejoin: The row at which it rejoins the trajectory; None for the end of the race.
        course: The course with the gates of the replanned race.
        part: The course between the two rows.
        ends: The times at which the present trajectory ends each leg of ``part`` (n,) [s].
        moved: The displacements of moved gates of the part, by number [m].
        planned: Whether to plan it with the optimiser, or as a smooth path.
    """

    motion: MotionTable
    leave: int
    rejoin: int | None
    course: Course
    part: Course
    ends: Array
    moved: Mapping[int, float]
    planned: bool

    @property
    def leave_seconds(self) -> float:
        """Start of the replanned part, from the start of the race [s]."""
        return float(self.motion.seconds[self.leave] - self.motion.seconds[0])

    def text(self) -> str:
        """Return a text with the moved gates."""
        return description(self.moved)

    def with_part(self, part: MotionTable, config: ReferenceConfig) -> GateTrajectory:
        """Return the race with a replanned part. Raises :class:`UserError` if infeasible."""
        before = self.motion.rows(slice(None, self.leave + 1))
        table = before.followed_by(part)
        if self.rejoin is not None:
            table = table.followed_by(self.motion.rows(slice(self.rejoin, None)))
        motion = PlannedMotion(dataclasses.replace(table, planned_with=part.planned_with))
        verdict = judged(motion, config)
        if not verdict.feasible:
            raise UserError(verdict.reason())
        return GateTrajectory.of(motion, self.course)


class LiveRace:
    """The gates of a race, and the flown trajectory.

    Args:
        course: The configured course.
        trajectory: The flown trajectory.
        planner: Whether the optimiser is available; otherwise smooth paths are used.

    Raises :class:`UserError` for a trajectory that does not pass the course.
    """

    def __init__(self, course: Course, trajectory: Trajectory, *, planner: bool) -> None:
        self._now = course
        self._planner = planner
        self._whole = self._newest = GateTrajectory.of(trajectory, course)

    def move(self, p_WG: Array, q_WG_xyzw: Array) -> None:
        """Receive the poses of the gates; arguments and errors as :meth:`.Course.moved`."""
        self._now = self._now.moved(p_WG, q_WG_xyzw)

    def replan_request(self, trajectory: Trajectory, begin: float) -> ReplanRequest | None:
        """Return the part to replan after a time of the race [s].

        None if no gate ahead on ``trajectory`` has moved, or ``trajectory`` is not this race.
        """
        flown = self._known_trajectory(trajectory)
        if flown is None:
            return None
        begin = _clear_of_gates(flown.times, max(begin, 0.0))
        moved = self._moved(flown, begin, math.inf)
        if not moved:
            return None
        table = flown.table()
        planned = self._planner and bool(table.planned_with)
        return _replan_request(flown, table, self._now.once(), moved, begin, planned=planned)

    def missed(self, trajectory: Trajectory, since: float, until: float) -> dict[int, float]:
        """Return the displacements of moved gates passed between two times, by number."""
        flown = self._known_trajectory(trajectory)
        if flown is None:
            return {}
        moved = self._moved(flown, since, until)
        return {flown.course.numbers[i]: far for i, far in moved.items()}

    def take(self, request: ReplanRequest, flown: GateTrajectory) -> str:
        """Note a new flown trajectory; return a message for the log."""
        before, self._newest = self._newest, flown
        return (
            f"replanned: {request.text()}, joins at {request.leave_seconds:.2f} s of the race, "
            f"lap {flown.lap:.2f} s after {before.lap:.2f} s"
        )

    def _moved(self, flown: GateTrajectory, since: float, until: float) -> dict[int, float]:
        now = self._now.once()
        return {
            i: far
            for i in np.flatnonzero((flown.times > since) & (flown.times <= until)).tolist()
            if (far := _moved(flown.course.gates[i], now[flown.course.numbers[i]])) > _MIN_SHIFT
        }

    def _known_trajectory(self, trajectory: Trajectory) -> GateTrajectory | None:
        ways = (self._newest, self._whole)
        return next((flown for flown in ways if flown.trajectory is trajectory), None)


def description(moved: Mapping[int, float]) -> str:
    """Return a text with the displacements of moved gates [m]."""
    return ", ".join(f"gate {number} moved {far:.2f} m" for number, far in moved.items())


def smooth_part(request: ReplanRequest, config: ReferenceConfig) -> MotionTable:
    """Return a smooth path through the gates of a request to the end, in rows.

    It continues the present motion. Raises :class:`UserError` if there is none.
    """
    leave_ns = round(1e9 * request.leave_seconds)
    start = flat_state_of(PlannedMotion(request.motion), leave_ns)
    if start.inverted:
        raise UserError("upside down where a smooth path would join")
    path = smooth_path(
        request.part,
        max_speed=config.max_speed,
        max_acceleration=config.max_acceleration,
        start=start.end,
    )
    rest = End.at_rest(np.array([start.yaw, 0.0, 0.0]))
    begin = dataclasses.replace(rest, v_WB_W=np.array([start.yaw_rate, 0.0, 0.0]))
    turned = Turned(path, Leg(begin, rest, duration=path.duration))
    try:
        trajectory = FlatTrajectory(turned, config)
    except ValueError as error:
        raise UserError(str(error)) from error
    times = [*range(0, trajectory.period_ns, _STEP_NS), trajectory.period_ns]
    return _tabled(trajectory, times)


def _replan_request(
    flown: GateTrajectory,
    table: MotionTable,
    now: Mapping[int, Gate],
    moved: Mapping[int, float],
    begin: float,
    *,
    planned: bool,
) -> ReplanRequest:
    """Return the request for the first moved gates; a smooth path extends to the end."""
    times, seconds, end = flown.times, table.seconds - table.seconds[0], flown.course.end
    stop, before = len(times), min(moved) - _GATES_BEFORE - 1
    if planned:
        last = min(moved)
        for i in moved:
            last = i if i <= last + _GATES_BEHIND else last
        stop = min(last + 1 + _GATES_BEHIND, len(times))
        if before >= 0:
            begin = max(begin, 0.5 * float(times[before] + times[before + 1]))
    leave = _row_from(seconds, begin)
    first = int(times.searchsorted(seconds[leave], side="right"))
    ends, rejoin = times[first:stop], None
    if stop < len(times):
        rejoin = _row_from(seconds, 0.5 * float(times[stop - 1] + times[stop]))
        ends = np.append(ends, seconds[rejoin])
        end = Finish(p_WB=table.p_WB[rejoin], tolerance=0.0, at_rest=True)
    else:
        if end is not None and not end.at_rest:
            ends = np.append(ends, flown.lap)
        ends = np.append(ends, seconds[-1])
    numbers = flown.course.numbers
    gates = tuple(now[number] for number in numbers[first:stop])
    before_and_behind = flown.course.gates[:first], flown.course.gates[stop:]
    return ReplanRequest(
        motion=table,
        leave=leave,
        rejoin=rejoin,
        course=dataclasses.replace(
            flown.course, gates=(*before_and_behind[0], *gates, *before_and_behind[1])
        ),
        part=dataclasses.replace(
            flown.course,
            start=table.p_WB[leave],
            numbers=numbers[first:stop],
            gates=gates,
            end=end,
        ),
        ends=ends,
        moved={numbers[i]: far for i, far in moved.items() if i < stop},
        planned=planned,
    )


def _moved(before: Gate, now: Gate) -> float:
    """Return the displacement of a gate's centre or edge [m]."""
    far = float(np.linalg.norm(now.p_WG - before.p_WG))
    if before.R_WG is None or now.R_WG is None:
        return far
    axes = slice(0, 1) if before.is_round else slice(0, 3)  # a circle's normal
    turned = np.linalg.norm((now.R_WG - before.R_WG)[:, axes], axis=0).max()
    return max(far, float(turned) * max(before.half_width, before.half_height))


def _clear_of_gates(times: Array, begin: float) -> float:
    """Return the time at which to leave the trajectory, not near a gate [s]."""
    for passed in times.tolist():
        if begin - _LEAVE_AFTER_GATE < passed < begin + _LEAVE_BEFORE_GATE:
            begin = passed + _LEAVE_AFTER_GATE
    return begin


def _row_from(seconds: Array, begin: float) -> int:
    return min(int(seconds.searchsorted(begin)), len(seconds) - 1)


def _tabled(trajectory: Trajectory, times_ns: list[int]) -> MotionTable:
    samples = trajectory.at([*times_ns[:-1], times_ns[-1] - 1])  # not at rest if it ends in motion
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)
    return MotionTable(
        source="the smooth path",
        seconds=1e-9 * np.array(times_ns),
        p_WB=samples.p_WB,
        v_WB_W=samples.v_WB_W,
        a_WB_W=samples.a_WB_W,
        q_WB_xyzw=samples.q_WB_xyzw,
        w_WB_B=np.einsum("nji,nj->ni", R_WB, samples.w_WB_W),
        rests=(False, True),
    )
