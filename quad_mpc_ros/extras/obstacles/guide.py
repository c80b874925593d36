# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The guide: a point mass that follows a path in time, and the resulting window.

The point mass starts with the vehicle's state and steers towards a point ahead on the path (pure
pursuit: Coulter, "Implementation of the pure pursuit path tracking algorithm", 1992). The
acceleration is bounded, and the speed is low enough for bends and for the end of the path. So the
vehicle can fly the window from its current state.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.extras.obstacles.bypass import interpolated, lengths_along

STEP = 0.04
"""s, between samples of a window."""
_POINT_SPACING = 0.1  # m, between points of a path
_SUBSTEPS = 4
_VELOCITY_TIME_CONSTANT = 0.12  # s, time constant of the velocity
# Lookahead distance [m], plus the distance flown in this time [s].
_LOOKAHEAD, _LOOKAHEAD_TIME = 0.25, 0.2
_ROUNDS, _HALF_WIDTH = 3, 3  # rounds of smoothing; points to both sides


def smoothed(corners: Array) -> Array:
    """Return a path (n, 3) of points 0.1 m apart with rounded corners."""
    along = lengths_along(corners)
    count = max(math.ceil(along[-1] / _POINT_SPACING), 1) + 1
    path = interpolated(np.linspace(0.0, along[-1], count), along, corners)
    width = 2 * _HALF_WIDTH + 1
    for _ in range(_ROUNDS if count > width else 0):
        padded = np.pad(path, ((_HALF_WIDTH, _HALF_WIDTH), (0, 0)), mode="edge")
        total = np.vstack([np.zeros(3), np.cumsum(padded, axis=0)])
        mean = (total[width:] - total[:-width]) / width
        path[1:-1] = mean[1:-1]
    return path


@compiled
def speeds_along(path: Array, fastest: Array, acceleration: float) -> Array:
    """Return the speeds at the points of a path (n, 3), limited in bends and before slow parts.

    ``fastest`` (n,) are the speed limits on a straight path.
    """
    speeds = fastest.copy()
    for k in range(1, len(path) - 1):
        here = kernels.vector(path[k])
        to, on = (
            kernels.minus(here, kernels.vector(path[k - 1])),
            kernels.minus(kernels.vector(path[k + 1]), here),
        )
        before, after = kernels.norm(to), kernels.norm(on)
        if min(before, after) < 1e-6:
            continue
        bend = (
            on[0] / after - to[0] / before,
            on[1] / after - to[1] / before,
            on[2] / after - to[2] / before,
        )
        curvature = kernels.norm(bend) / (0.5 * (before + after))
        if curvature > 1e-6:
            speeds[k] = min(speeds[k], math.sqrt(acceleration / curvature))
    for k in range(len(path) - 2, -1, -1):
        length = kernels.distance(path[k + 1], path[k])
        speeds[k] = min(speeds[k], math.sqrt(speeds[k + 1] ** 2 + 2.0 * acceleration * length))
    return speeds


@compiled
def simulate_pursuit(
    path: Array,
    speeds: Array,
    acceleration: float,
    p: Array,
    v: Array,
    positions: Array,
    velocities: Array,
    along: Array,
) -> None:
    """Write the motion of a point mass that follows a path (n, 3) from ``p`` and ``v`` (3,).

    ``positions`` and ``velocities`` (m, 3) are sampled every ``STEP`` seconds from now on;
    ``along`` (m,) is the index of the nearest point of the path.
    """
    dt = STEP / _SUBSTEPS
    position, velocity, at = p.copy(), v.copy(), 0
    for k in range(len(positions)):
        for _ in range(_SUBSTEPS if k > 0 else 0):
            _steer(path, speeds, acceleration, (position, velocity), dt, at)
            at = _nearest(path, position, at)
        if k == 0:
            at = _nearest(path, position, 0)
        positions[k], velocities[k], along[k] = position, velocity, at


@compiled
def _nearest(path: Array, position: Array, at: int) -> int:
    """Return the index of the nearest point of a path, from an index on."""
    least, best = math.inf, at
    for k in range(at, min(at + 12, len(path))):
        away = kernels.minus(kernels.vector(path[k]), kernels.vector(position))
        squared = kernels.dot(away, away)
        if squared < least:
            least, best = squared, k
    return best


@compiled
def _steer(
    path: Array,
    speeds: Array,
    acceleration: float,
    state: tuple[Array, Array],
    dt: float,
    at: int,
) -> None:
    """Advance the point mass by a step."""
    position, velocity = state
    ahead = _LOOKAHEAD + _LOOKAHEAD_TIME * kernels.length(velocity)
    to, length = at, 0.0
    while to < len(path) - 1 and length < ahead:
        length += kernels.distance(path[to + 1], path[to])
        to += 1
    distance = kernels.distance(path[to], position)
    wanted = speeds[at]
    if to == len(path) - 1:  # brake for the end
        end = speeds[len(path) - 1]
        wanted = min(wanted, math.sqrt(end * end + 2.0 * acceleration * distance))
        if end == 0.0:
            wanted = min(wanted, distance / (2.0 * _VELOCITY_TIME_CONSTANT))
    share, change = wanted / max(distance, 1e-6), np.empty(3)
    for c in range(3):
        change[c] = (share * (path[to, c] - position[c]) - velocity[c]) / _VELOCITY_TIME_CONSTANT
    factor = min(1.0, acceleration / max(kernels.length(change), 1e-9))
    for c in range(3):
        before = velocity[c]
        velocity[c] = before + dt * factor * change[c]
        position[c] += 0.5 * dt * (before + velocity[c])


class GuideMotion(NamedTuple):
    """Motion of the guide: positions and velocities (m, 3), and index on the path (m,).

    The first ``before`` samples precede the path and have separate indices.
    """

    p_W: Array
    v_W: Array
    along: Array
    before: int = 0

    def after(self, p_W: Array, v_W: Array) -> GuideMotion:
        """Return the motion with preceding positions and velocities (k, 3)."""
        along = np.concatenate((np.arange(len(p_W), dtype=float), self.along + len(p_W)))
        return GuideMotion(
            np.vstack([p_W, self.p_W]), np.vstack([v_W, self.v_W]), along, before=len(p_W)
        )


def follow_path(
    path: Array, fastest: Array, acceleration: float, *, p_W: Array, v_W: Array, duration: float
) -> GuideMotion:
    """Return the motion along a path (n, 3) from a state, for ``duration`` [s].

    ``fastest`` (n,) [m/s] are the speed limits at the points of the path; ``acceleration``
    [m/s^2] is bounded.
    """
    count = math.ceil(duration / STEP) + 1
    motion = GuideMotion(np.empty((count, 3)), np.empty((count, 3)), np.empty(count))
    simulate_pursuit(
        path,
        speeds_along(path, fastest, acceleration),
        acceleration,
        p=p_W,
        v=v_W,
        positions=motion.p_W,
        velocities=motion.v_W,
        along=motion.along,
    )
    return motion


def window_of(
    motion: GuideMotion, reference: ReferenceWindow, *, start_ns: int, gravity: float
) -> ReferenceWindow:
    """Return the window of a motion from a stamp on, with the heading of the reference.

    The thrust axis is along the force required by acceleration and gravity [m/s^2].
    """
    count = len(motion.p_W)
    a, w, q = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 4))
    _write_attitudes(motion.v_W, _heading(reference.q_WB_xyzw[0]), gravity, a_W=a, q_xyzw=q, w_W=w)
    return ReferenceWindow(
        stamp_ns=reference.stamp_ns,
        offset_ns=start_ns
        - reference.stamp_ns
        + np.arange(count, dtype=np.int64) * round(STEP * 1e9),
        p_WB=motion.p_W,
        q_WB_xyzw=q,
        v_WB_W=motion.v_W,
        a_WB_W=a,
        w_WB_W=w,
        frame_id=reference.frame_id,
    )


@compiled
def _write_attitudes(
    v_W: Array, heading: float, gravity: float, a_W: Array, q_xyzw: Array, w_W: Array
) -> None:
    """Write accelerations (n, 3), attitudes (n, 4) and angular velocities (n, 3) of velocities."""
    last, nose = len(v_W) - 1, kernels.exp((0.0, 0.0, heading))
    before = nose
    for k in range(last + 1):
        first, then = max(k - 1, 0), min(k + 1, last)
        for c in range(3):
            a_W[k, c] = (v_W[then, c] - v_W[first, c]) / (STEP * (then - first))
        force = a_W[k, 0], a_W[k, 1], a_W[k, 2] + gravity
        R_WB = kernels.multiply(kernels.shortest_rotation((0.0, 0.0, 1.0), force), nose)
        q_xyzw[k] = kernels.quaternion(R_WB)
        if k > 0:
            turn_B = kernels.log(kernels.multiply(kernels.transposed(before), R_WB))
            w_W[k - 1] = kernels.scaled(1.0 / STEP, kernels.apply(before, turn_B))
        before = R_WB
    w_W[last] = 0.0


def _heading(q_xyzw: Array) -> float:
    """Return the heading of an attitude [rad], from east to north."""
    x, y, z, w = q_xyzw.tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
