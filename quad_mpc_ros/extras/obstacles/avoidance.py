# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Obstacle avoidance: the window and the corridor of each control step.

If the reference, the plan and the straight line to the reference are clear, the reference is flown
unchanged. Otherwise a path is searched (:mod:`.search`) from the point where the reference is left
to the point where it is rejoined (:mod:`.bypass`). A guide follows the path (:mod:`.guide`), and
half-spaces (:mod:`.corridor`) keep the plan near the path. If no path reaches the reference, the
vehicle stops at the nearest reachable point.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.guide import Avoidance, Guide, Guided
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.extras.obstacles.bypass import (
    REST_SPEED,
    Bypass,
    Preview,
    find_bypass,
    interpolated,
    is_nearly_straight,
    lengths_along,
)
from quad_mpc_ros.extras.obstacles.corridor import corridor_about
from quad_mpc_ros.extras.obstacles.guide import (
    STEP,
    GuideMotion,
    follow_path,
    smoothed,
    window_of,
)
from quad_mpc_ros.extras.obstacles.local_map import VOXEL_SIZE, LocalMap, LocalMapProvider
from quad_mpc_ros.extras.obstacles.moving import Movers
from quad_mpc_ros.extras.obstacles.neighbours import Shared, shared_space
from quad_mpc_ros.extras.obstacles.search import SearchBuffers, search, shortened
from quad_mpc_ros.extras.obstacles.world import ObstacleWorld

_SAMPLE_SPACING = 0.1  # m, between checked points of a path
_SEARCH_MARGIN = 0.05  # m, clearance of paths beyond that of the plan
_PREFERRED_CLEARANCE = 0.3  # m, further clearance that paths keep if possible
_MIN_PREFERRED_CLEARANCE = 0.1  # m, of that, at any speed
_TYPICAL_SPEED = 10.0  # m/s
_MAP_RANGE_FACTORS = np.array([1.0, 1.25, 1.6, 2.0])  # of the range at the typical speed
_REPLAN_PERIOD_NS = 100_000_000  # between two searches
# m, by which a new stop must be nearer, or a new path shorter.
_MIN_IMPROVEMENT = 0.5
_MIN_PATH_SEPARATION = 0.5  # m, between paths on different sides of an obstacle
_MAX_TRACKING_ERROR = 0.3  # m, from the vehicle to the guide
# Error of the predicted speed of moving obstacles, over the speed.
_RELATIVE_SPEED_ERROR = 0.1
# Static obstacles: drift since their last detection [m/s], and its longest duration [s].
_POSITION_DRIFT, _MAX_AGE = 0.05, 2.0  # m/s
_PLAN_DRIFT = 0.3  # m/s, position error of neighbours over the age of their plan
_MIN_SPEED = 0.3  # m/s, of paths to a moving reference


class _Perception(NamedTuple):
    """The vehicle and its surroundings at the time when the command acts."""

    start_ns: int
    p_W: Array
    v_W: Array
    map: LocalMap
    movers: Movers
    keep: float  # m, distance to keep between the vehicle's centre and points


class _LocalPath(NamedTuple):
    """A path (n, 3), speed limits along it (n,), and the time at which the reference is left.

    A ``complete`` path reaches the reference and continues along it.
    """

    points: Array
    speeds: Array
    complete: bool
    leave_ns: int
    found_ns: int
    revision: int

    @property
    def length(self) -> float:
        """Length [m]."""
        return _length(self.points)


class _Goal(NamedTuple):
    """End of a path, and the bypassed part of the reference; None leaves the reference at once."""

    p_W: Array
    ahead: Preview
    find_bypass: Bypass | None

    @property
    def leave(self) -> float:
        """Time at which the reference is left [s]."""
        return 0.0 if self.find_bypass is None else float(self.ahead.times[self.find_bypass.leave])


class ObstacleAvoidance(Guide):
    """Guide around obstacles."""

    def __init__(self, config: MpcConfig, obstacles: ObstacleWorld, *, radius: float) -> None:
        """``radius`` [m] of the bounding sphere of the vehicle, and of each neighbour."""
        self._obstacles, self._radius = obstacles, radius
        self.surroundings = LocalMapProvider(obstacles)
        self._path: _LocalPath | None = None
        self._guide_state: tuple[int, GuideMotion] | None = None  # with its start [ns]
        self._search_buffers = SearchBuffers.of(0)
        _compile()
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed live parameters."""
        self._config, self._own = config, config.obstacles
        self._delay_ns = round(config.input_delay * 1e9)

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Discard map and path, which are in the old coordinates."""
        self._obstacles.reset_estimate(reset)
        self.surroundings.forget()
        self._path = self._guide_state = None

    def guide(
        self, odometry: OdometrySample, window: ReferenceWindow, plan: Plan | None
    ) -> Guided:
        """Return window and corridor for an odometry, given the last plan."""
        view = self._perceive(odometry)
        clearance = self._clearance(odometry.p_WB, view)
        own = self._planned(view, plan)
        shared = self._shared(view, own)
        if not math.isfinite(clearance) or self._is_free(view, window, plan):
            self._path = self._guide_state = None
            if shared is None:
                return Guided(window, None, Avoidance("free", "", clearance))
            avoidance = Avoidance("around", "a neighbour is near", clearance)
            return Guided(window, self._corridor(view, own, shared), avoidance)
        goal = self._goal(view, window)
        path = self._path = self._select_path(view, goal)
        motion = self._motion(view, path, goal.ahead)
        corridor = self._corridor(view, self._along(path, motion), shared)
        state, reason = "around", "the reference is blocked by obstacles"
        if not path.complete:
            away = _distance(path.points[-1], goal.p_W)
            state, reason = "stopped", f"no path leads closer to the reference than {away:.1f} m"
        flown = window_of(motion, window, start_ns=view.start_ns, gravity=self._config.gravity)
        return Guided(flown, corridor, Avoidance(state, reason, clearance))

    # --- perception

    def _perceive(self, odometry: OdometrySample) -> _Perception:
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        v_W = R_WB @ odometry.v_WB_B
        p_W = odometry.p_WB + 1e-9 * self._delay_ns * v_W
        stamp_ns, obstacles, own = odometry.stamp_ns, self._obstacles, self._own
        moving = obstacles.moving(stamp_ns + self._delay_ns, near=p_W, radius=own.range)
        speeds = np.linalg.norm(moving.v_W, axis=1)
        keep = self._radius + own.margin + own.margin_growth * float(np.linalg.norm(v_W))
        keep += _POSITION_DRIFT * min(obstacles.age(stamp_ns), _MAX_AGE)
        movers = Movers(
            np.ascontiguousarray(moving.p_W),
            np.ascontiguousarray(moving.v_W),
            keep + _RELATIVE_SPEED_ERROR * speeds * moving.age,
            _RELATIVE_SPEED_ERROR * float(speeds.max(initial=0.0)),
            moving.body,
        )
        # A surface may be nearer than its sampled points.
        spacing = max(obstacles.spacing, VOXEL_SIZE)
        keep += math.hypot(keep, 0.5 * math.sqrt(2.0) * spacing) - keep
        local_map = self.surroundings.at(
            p_W, stamp_ns, radius=own.range, far=self._map_range(keep)
        )
        return _Perception(
            start_ns=stamp_ns + self._delay_ns,
            p_W=p_W,
            v_W=v_W,
            map=local_map,
            movers=movers,
            keep=keep,
        )

    def _map_range(self, keep: float) -> float:
        """Return the largest distance that the map must resolve [m].

        The distance is the clearance of paths at the typical speed and the oldest data, rounded
        up, so that a map is valid for many control steps.
        """
        most = self._own.margin_growth * _TYPICAL_SPEED + _POSITION_DRIFT * _MAX_AGE
        usual = self._radius + self._own.margin + most + _PREFERRED_CLEARANCE
        needed = keep + _SEARCH_MARGIN + _MIN_PREFERRED_CLEARANCE
        return next((far for far in usual * _MAP_RANGE_FACTORS if far >= needed), 2.0 * usual)

    def _clearance(self, p_W: Array, view: _Perception) -> float:
        """Return the distance from the vehicle's surface to the nearest point [m]."""
        nearest = float(view.map.distances(p_W[None])[0])
        movers = view.movers
        if len(movers.keep):
            apart = np.linalg.norm(movers.p_W - p_W, axis=1)
            balls = movers.keep - (self._radius + self._own.margin)
            nearest = min(nearest, float((apart - balls).min()))
        return nearest - self._radius

    def _is_free(self, view: _Perception, window: ReferenceWindow, plan: Plan | None) -> bool:
        """Return whether the reference can be flown unchanged."""
        since = (window.stamp_ns - view.start_ns) * 1e-9
        times = np.arange(0.0, self._horizon + 1e-9, STEP)
        offsets = window.offset_ns * 1e-9 + since
        reference = interpolated(times, offsets, window.p_WB)
        # The vehicle flies at most this far within the horizon.
        fastest = max(float(np.linalg.norm(view.v_W)), self._own.speed_max)
        reach = self._horizon * fastest
        ends = [reference[0]]
        bends = not is_nearly_straight(reference)
        if not bends or _distance(view.p_W, reference[0]) > _MAX_TRACKING_ERROR:
            ends.append(reference[-1])
        straight = [_sampled_line(view.p_W, end, reach) for end in ends]
        places = [_densified(reference), *straight]
        if plan is not None:
            elapsed = (view.start_ns - plan.stamp_ns) * 1e-9
            at = plan.step * np.arange(len(plan.p_WB)) - elapsed
            places.append(interpolated(times, at, plan.p_WB))
        if not view.map.are_clear(np.vstack(places), view.keep).all():
            return False
        planned = places[1 + len(ends) :]
        return not any(view.movers.meet(times, place) for place in (reference, *planned))

    @property
    def _horizon(self) -> float:
        return self._config.horizon_steps * self._config.horizon_step

    # --- path

    def _goal(self, view: _Perception, window: ReferenceWindow) -> _Goal:
        """Return the point at which to rejoin the reference, or a nearer point."""
        ahead = Preview.of(window, view.start_ns)
        near = np.linalg.norm(ahead.p_W - view.p_W, axis=1) < self._search_range
        around = find_bypass(
            ahead,
            view.map.are_clear(ahead.p_W, view.keep + _SEARCH_MARGIN),
            near,
            speed_max=self._own.speed_max,
            astray=_distance(view.p_W, ahead.p_W[0]) > _MAX_TRACKING_ERROR,
        )
        if around is not None:
            return _Goal(ahead.p_W[around.rejoin], ahead, around)
        to_reference = ahead.p_W[0] - view.p_W
        distance = max(float(np.linalg.norm(to_reference)), 1e-6)
        shortened_to = min(distance, self._search_range) / distance
        return _Goal(view.p_W + shortened_to * to_reference, ahead, None)

    @property
    def _search_range(self) -> float:
        """Greatest distance to the end of a path [m]."""
        return self._own.range - 0.5

    def _select_path(self, view: _Perception, goal: _Goal) -> _LocalPath:
        """Return the previous path if it is still valid, else a new one."""
        path, keep = self._path, view.keep + _SEARCH_MARGIN
        if path is not None and view.start_ns - path.found_ns < _REPLAN_PERIOD_NS:
            if path.revision == view.map.revision:
                return path
            if view.map.are_clear(path.points, view.keep).all():
                return path
        found = self._search_path(view, goal)
        kept = None if path is None or not path.complete else self._extended(view, path, goal)
        if kept is not None and _is_worse(found, kept):
            return kept
        if path is not None and not (found.complete or path.complete):
            # Keep the previous stop unless the new one is clearly nearer, or on the way.
            before, stop = path.points[-1], found.points[-1]
            nearer = _distance(before, goal.p_W) - _distance(stop, goal.p_W)
            needed = min(max(0.5 * _distance(before, stop), VOXEL_SIZE), _MIN_IMPROVEMENT)
            if nearer < needed and view.map.are_clear(before[None], keep).all():
                there = self._search_path(view, _Goal(before, goal.ahead, None))
                found = there._replace(complete=False)
        return found

    def _extended(self, view: _Perception, path: _LocalPath, goal: _Goal) -> _LocalPath | None:
        """Return the rest of a path, extended straight to the current goal.

        None if the path is not clear, and near moving obstacles, which need a timed search.
        """
        if goal.find_bypass is None or goal.find_bypass.leave > 0 or len(view.movers.keep) > 0:
            return None
        nearest, last = (
            int(np.linalg.norm(path.points - place, axis=1).argmin())
            for place in (view.p_W, goal.p_W)
        )
        corners = np.vstack([view.p_W, path.points[nearest + 1 : last + 1], goal.p_W])
        # Rounded corners have less clearance than the search.
        if not view.map.are_clear(smoothed(corners), view.keep - _SEARCH_MARGIN).all():
            return None
        return self._path_through(view, goal, corners, complete=True)

    def _search_path(self, view: _Perception, goal: _Goal) -> _LocalPath:
        """Return a new path."""
        start, leave = view.p_W, goal.leave
        if goal.find_bypass is not None and leave > 0.0:
            start = goal.ahead.p_W[goal.find_bypass.leave]
        corners, complete = self._corners(view, start, goal.p_W, view.movers.after(leave))
        return self._path_through(view, goal, corners, complete=complete)

    def _path_through(
        self, view: _Perception, goal: _Goal, corners: Array, *, complete: bool
    ) -> _LocalPath:
        """Return the path through corners (n, 3), continued along the reference if complete."""
        fastest, onward = self._own.speed_max, goal.ahead.part(0, 0)
        if complete and goal.find_bypass is not None:
            onward = self._reference_after(view, goal.ahead, goal.find_bypass.rejoin)
            there = float(onward.speeds[0])
            fastest = max(fastest, there)
            if there > REST_SPEED:  # arrive no sooner than the reference
                time = max(float(onward.times[0]) - goal.leave, 1e-3)
                fastest = min(fastest, max(_length(corners) / time, _MIN_SPEED))
        points = smoothed(np.vstack([corners, onward.p_W[1:]]))
        return _LocalPath(
            points,
            _speeds_of(points, corners, fastest, onward),
            complete,
            view.start_ns + round(1e9 * goal.leave),
            view.start_ns,
            view.map.revision,
        )

    def _reference_after(self, view: _Perception, ahead: Preview, rejoin: int) -> Preview:
        """Return the reference after the rejoin point, as far as known and clear."""
        onward = ahead.p_W[rejoin + 1 : ahead.known]
        clear = view.map.are_clear(onward, view.keep + _SEARCH_MARGIN)
        clear &= np.linalg.norm(onward - view.p_W, axis=1) < self._search_range
        ends = np.flatnonzero(~clear)
        return ahead.part(rejoin, rejoin + 1 + int(ends[0] if len(ends) else len(onward)))

    def _corners(
        self, view: _Perception, start: Array, goal: Array, movers: Movers
    ) -> tuple[Array, bool]:
        """Return the corners (n, 3) of a path between points, and whether it is complete."""
        grid = view.map.grid
        keep = min(view.keep + _SEARCH_MARGIN, grid.far - _MIN_PREFERRED_CLEARANCE)
        speed = max(float(np.linalg.norm(view.v_W)), 1.0)
        floor = min(self._own.floor, float(start[2]), float(goal[2]))
        if len(self._search_buffers.cost) != grid.distances.size:
            self._search_buffers = SearchBuffers.of(grid.distances.size)
        cells, complete = search(
            grid,
            start=start,
            goal=goal,
            keep=keep,
            floor=floor - 0.1,
            speed=speed,
            movers=movers,
            workspace=self._search_buffers,
        )
        cells[0] = start
        if complete:
            cells = np.vstack([cells, goal]) if len(cells) == 1 else cells
            cells[-1] = goal
        if len(cells) > 2:
            cells = shortened(grid, cells, keep, speed, movers)
        return cells, complete

    def _motion(self, view: _Perception, path: _LocalPath, ahead: Preview) -> GuideMotion:
        """Return the guide's motion along the reference, then along the path."""
        hardest = max(self._own.acceleration, ahead.acceleration)
        duration = self._horizon + 5 * STEP
        count = max(math.ceil((path.leave_ns - view.start_ns) * 1e-9 / STEP), 0)
        if count == 0:
            p_W, v_W = self._guide_position(view)
            motion = follow_path(
                path.points, path.speeds, hardest, p_W=p_W, v_W=v_W, duration=duration
            )
        else:
            p_W, v_W = ahead.at(np.linspace(0.0, STEP * count, count + 1))
            rest = max(duration - count * STEP, STEP)
            then = follow_path(
                path.points, path.speeds, hardest, p_W=p_W[-1], v_W=v_W[-1], duration=rest
            )
            motion = then.after(p_W[:-1], v_W[:-1])
        self._guide_state = view.start_ns, motion
        return motion

    def _guide_position(self, view: _Perception) -> tuple[Array, Array]:
        """Return the current position and velocity of the guide.

        If the vehicle is too far away from the guide, the vehicle's values are returned.
        """
        if self._guide_state is not None:
            start_ns, motion = self._guide_state
            since = (view.start_ns - start_ns) * 1e-9
            at = STEP * np.arange(len(motion.p_W))
            now = np.array([since])
            p_W = interpolated(now, at, motion.p_W)[0]
            v_W = interpolated(now, at, motion.v_W)[0]
            if since < at[-1] and _distance(p_W, view.p_W) < _MAX_TRACKING_ERROR:
                return p_W, v_W
        return view.p_W, view.v_W

    # --- corridor

    @property
    def _times(self) -> Array:
        """The times of the N + 1 stages [s]."""
        config = self._config
        return np.asarray(config.horizon_step * np.arange(config.horizon_steps + 1), float)

    def _along(self, path: _LocalPath, motion: GuideMotion) -> Array:
        """Return the points of the path (N + 1, 3) that the guide reaches at the stages."""
        places = np.vstack([motion.p_W[: motion.before], path.points])
        along = np.interp(self._times, STEP * np.arange(len(motion.along)), motion.along)
        return interpolated(along, np.arange(len(places)), places)

    def _planned(self, view: _Perception, plan: Plan | None) -> Array:
        """Return the previous plan (N + 1, 3) at the stages; without a plan a straight line."""
        if plan is None:
            return view.p_W + self._times[:, None] * view.v_W
        since = (view.start_ns - plan.stamp_ns) * 1e-9
        at = plan.step * np.arange(len(plan.p_WB)) - since
        return interpolated(self._times, at, plan.p_WB)

    def _shared(self, view: _Perception, own_W: Array) -> Shared | None:
        """Return the half-spaces between this vehicle's plan and its neighbours' plans."""
        if not self._own.neighbours:
            return None
        stamps_ns = [view.start_ns + round(1e9 * time) for time in self._times[1:]]
        plans = self._obstacles.plans(stamps_ns)
        if len(plans.p_W) == 0:
            return None
        drift = _PLAN_DRIFT * np.minimum(plans.age, _MAX_AGE)
        keep = 2.0 * self._radius + self._own.margin + drift
        return shared_space(own_W[1:], plans, keep=keep, heights_count=1.0 / self._own.downwash)

    def _corridor(self, view: _Perception, guide: Array, shared: Shared | None) -> Corridor:
        """Return half-spaces around a path (N + 1, 3): neighbours, moving, static obstacles."""
        config, rows, used = self._config, self._own.half_spaces, 0
        normals = np.zeros((config.horizon_steps, rows, 3))
        offsets = np.full((config.horizon_steps, rows), np.inf)
        if shared is not None:
            most = rows if len(view.map.points) == 0 else (rows + 1) // 2
            used = min(shared.offsets.shape[1], most)
            normals[:, :used] = shared.normals[:, :used]
            offsets[:, :used] = shared.offsets[:, :used]
        used += view.movers.write_half_spaces(
            self._times[1:], guide[1:], normals=normals[:, used:], offsets=offsets[:, used:]
        )
        still, bounds = corridor_about(guide, view.map.points, radius=view.keep, rows=rows - used)
        normals[:, used:], offsets[:, used:] = still, bounds
        return Corridor(
            stamp_ns=view.start_ns, step=config.horizon_step, normals=normals, offsets=offsets
        )


@functools.cache
def _compile() -> None:
    """Compile all functions of a control step."""
    points = np.array([[0.5, 0.0, 0.0]])
    local_map = LocalMap(points, centre=np.zeros(3), radius=1.0, far=0.8, revision=0)
    goal = np.array([0.8, 0.0, 0.0])
    path, _ = search(
        local_map.grid,
        start=np.zeros(3),
        goal=goal,
        keep=0.3,
        floor=-1.0,
        speed=1.0,
        movers=Movers.none(),
        workspace=SearchBuffers.of(local_map.grid.distances.size),
    )
    corners = smoothed(shortened(local_map.grid, path, 0.3, 1.0, Movers.none()))
    start, speeds = np.zeros(3), np.ones(len(corners))
    motion = follow_path(corners, speeds, 1.0, p_W=start, v_W=start, duration=0.2)
    window_of(motion, ReferenceWindow.hover(goal), start_ns=0, gravity=9.81)
    corridor_about(np.vstack([np.zeros(3), goal]), points, radius=0.3, rows=2)


def _is_worse(path: _LocalPath, kept: _LocalPath) -> bool:
    """Return whether a path is incomplete, or on another side and not clearly shorter."""
    if not path.complete:
        return True
    if path.length < kept.length - _MIN_IMPROVEMENT:
        return False
    apart = np.linalg.norm(path.points[:, None] - kept.points, axis=2).min(axis=1)
    return bool(apart.max() > _MIN_PATH_SEPARATION)


def _length(places: Array) -> float:
    """Return the length of a path (n, 3) [m]."""
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _distance(place: Array, other: Array) -> float:
    """Return the distance between two points (3,) [m]."""
    return float(np.linalg.norm(place - other))


def _speeds_of(points: Array, corners: Array, fastest: float, onward: Preview) -> Array:
    """Return the speed limits (n,) along a path and its continuation on the reference.

    The speed is 0 at the end of a path that does not reach the reference.
    """
    along = lengths_along(np.vstack([corners, onward.p_W[1:]]))
    rejoined = along[len(corners) - 1 :]
    at = np.linspace(0.0, along[-1], len(points))
    speeds = np.full(len(points), fastest)
    if len(onward.times) == 0:
        speeds[-1] = 0.0
        return speeds
    beyond = at > rejoined[0]
    speeds[beyond] = np.interp(at[beyond], rejoined, onward.speeds)
    last = float(onward.speeds[-1])
    speeds[-1] = min(speeds[-1], last if last > REST_SPEED else 0.0)
    return speeds


def _densified(places: Array) -> Array:
    """Return points (n, 3) with samples of straight lines in gaps."""
    jumps = np.flatnonzero(np.linalg.norm(np.diff(places, axis=0), axis=1) > 4.0 * _SAMPLE_SPACING)
    ways = [_sampled_line(places[k], places[k + 1], math.inf) for k in jumps]
    return np.vstack([places, *ways])


def _sampled_line(start: Array, end: Array, reach: float) -> Array:
    """Return points (n, 3) on the line between two points, up to a length ``reach`` [m]."""
    distance = float(np.linalg.norm(end - start))
    share = min(1.0, reach / max(distance, 1e-9))
    count = max(math.ceil(share * distance / _SAMPLE_SPACING), 1) + 1
    return start + np.linspace(0.0, share, count)[:, None] * (end - start)
