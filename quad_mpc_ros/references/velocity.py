# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A path that follows velocity commands, within a box and limits of speed and acceleration.

In steps of ``STEP`` a double integrator follows a valid command and then brakes to rest. The
positions are the control points of a uniform B-spline of degree 5, the path. A spline is in the
convex hull of its control points; velocity and acceleration are in the hulls of first and second
differences (de Boor, "A Practical Guide to Splines", 1978, chapter X). So for any commands, the
path satisfies the limits of the control points: box, speed, acceleration. The path is continuous
up to its fourth derivative.

A new command moves the control points after the current step: the path before is unchanged. A
command takes effect three to four steps later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import SplinePath
from quad_mpc_ros.references.transition import FlatState

STEP_NS = 80_000_000
_STEP = 1e-9 * STEP_NS
_DEGREE = 5
_CENTRE_STEPS = 2  # from the time of the first control point to the start of the path
# The values of uniform B-splines of degree 5 to 1 at their knots.
_AT_KNOTS = (
    np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0,
    np.array([1.0, 11.0, 11.0, 1.0]) / 24.0,
    np.array([1.0, 4.0, 1.0]) / 6.0,
    np.array([1.0, 1.0]) / 2.0,
    np.array([1.0]),
)
# s: how much earlier than it must a velocity slows down in front of a wall. A vehicle that turns
# and then brakes as the hover controller does stops behind the path's own place to stop otherwise.
_WALL_MARGIN = 0.75
_AXES = 3
_LONGEST_STOP = 30.0  # s
_MIN_SPEED = 1e-9  # m/s, rad/s
_MAX_COMMAND = 1e6  # m/s, rad/s


@dataclass(frozen=True, kw_only=True, eq=False)
class VelocityCommand:
    """A velocity (3,) [m/s] and a yaw rate [rad/s] about the vertical.

    With ``heading_aligned`` its x axis points along the heading, level, and y to the left; else
    the velocity is in the world. Raises ``ValueError`` for numbers not finite or too large.
    """

    velocity: Array
    yaw_rate: float
    heading_aligned: bool

    def __post_init__(self) -> None:
        """Reject numbers that are not finite or too large."""
        if not np.all(np.abs([*self.velocity, self.yaw_rate]) <= _MAX_COMMAND):
            raise ValueError(
                f"velocity {self.velocity.tolist()} m/s and yaw rate {self.yaw_rate} rad/s, "
                f"expected finite numbers up to {_MAX_COMMAND:g}"
            )

    @property
    def moves(self) -> bool:
        """Whether a nonzero velocity is commanded."""
        return bool(np.any(self.velocity)) or self.yaw_rate != 0.0


@dataclass(frozen=True, kw_only=True)
class VelocityLimits:
    """Limits of velocity paths, in SI units; the box by its corners."""

    speed: float
    acceleration: float
    yaw_rate: float
    yaw_acceleration: float
    lowest: Sequence[float]
    highest: Sequence[float]


class VelocityPath(SplinePath):
    """The uniform B-spline of control points (n, 4): position [m] and yaw [rad]."""

    def __init__(self, points: Array) -> None:
        from scipy.interpolate import BSpline  # slow to import

        count = len(points)
        self.points = points
        knots = (np.arange(count + _DEGREE + 1) - _DEGREE) * _STEP
        super().__init__(BSpline(knots, points, _DEGREE), duration=(count - _DEGREE) * _STEP)

    def fixed(self, steps: int) -> Array:
        """Return the control points (6, 4) of the step that begins after a number of points."""
        return self.points[steps : steps + _DEGREE + 1]


def first_points(state: FlatState) -> Array:
    """Return the control points (5, 4) of a path that begins in a flat state, without snap.

    The n-th derivative is a spline of degree 5 - n of the n-th differences over the step.
    """
    end = state.end
    derivatives = np.array(
        [
            (*state.p_WB, state.yaw),
            (*end.v_WB_W, state.yaw_rate),
            (*end.a_WB_W, 0.0),
            (*end.j_WB_W, 0.0),
            (0.0, 0.0, 0.0, 0.0),
        ]
    )
    differences = [
        values @ np.diff(np.eye(_DEGREE), order, axis=0) / _STEP**order
        for order, values in enumerate(_AT_KNOTS)
    ]
    # Relative to the place: rounding would otherwise be amplified by its size.
    derivatives[0], place = 0.0, derivatives[0].copy()
    return np.asarray(np.linalg.solve(np.array(differences), derivatives) + place)


def followed(
    known: Array, command: VelocityCommand, limits: VelocityLimits, *, held: float
) -> VelocityPath:
    """Return the path that continues known control points (n, 4), n >= 5.

    The path follows the command for ``held`` [s], then brakes and ends at rest.
    """
    pursuit = _Pursuit(known, command, limits)
    while (len(pursuit.points) - _CENTRE_STEPS) * _STEP <= held:
        pursuit.step(braking=False)
    while not pursuit.rests:
        pursuit.step(braking=True)
    rest = pursuit.points[-1]
    return VelocityPath(np.array([*pursuit.points, *[rest] * (_DEGREE - 1)]))


class _Pursuit:
    """The double integrator, in plain numbers, because small arrays are slow."""

    def __init__(self, known: Array, command: VelocityCommand, limits: VelocityLimits) -> None:
        self.points: list[tuple[float, ...]] = [tuple(point) for point in known.tolist()]
        *self._place, self._yaw = self.points[-1]
        *self._velocity, self._yaw_rate = (
            (after - before) / _STEP
            for before, after in zip(self.points[-2], self.points[-1], strict=True)
        )
        self._limits = limits
        # In a step, of the speed; more where it begins so fast that it would never stop.
        needed = math.hypot(*self._velocity) / _LONGEST_STOP
        self._slowing = max(limits.acceleration, needed) * _STEP
        self._speed = min(limits.speed, _LONGEST_STOP * limits.acceleration)
        self._wanted: list[float] = command.velocity.tolist()
        self._aligned = command.heading_aligned
        self._wanted_yaw_rate = _clipped(command.yaw_rate, limits.yaw_rate)
        # A path that begins outside must not lead further out.
        stop = self._stop(self._place, self._velocity)
        places = [*zip(*(point[:_AXES] for point in [*self.points, stop]), strict=True)]
        self._lowest = [min(low, *axis) for low, axis in zip(limits.lowest, places, strict=True)]
        self._highest = [max(top, *axis) for top, axis in zip(limits.highest, places, strict=True)]

    @property
    def rests(self) -> bool:
        """Whether the motion has ended."""
        return not any(self._velocity) and self._yaw_rate == 0.0

    def step(self, *, braking: bool) -> None:
        """Add a control point."""
        wanted = [0.0] * _AXES if braking else self._target()
        velocity = _towards(self._velocity, wanted, most=self._slowing)
        if not braking and not self._stops_inside(velocity):
            velocity = _towards(self._velocity, [0.0] * _AXES, most=self._slowing)
        yaw_rate = 0.0 if braking else self._wanted_yaw_rate
        (self._yaw_rate,) = _towards(
            [self._yaw_rate], [yaw_rate], most=self._limits.yaw_acceleration * _STEP
        )
        self._velocity = velocity
        self._place = [p + v * _STEP for p, v in zip(self._place, velocity, strict=True)]
        self._yaw += self._yaw_rate * _STEP
        self.points.append((*self._place, self._yaw))

    def _target(self) -> list[float]:
        """Return the commanded velocity, in the world, limited by speed and walls."""
        x, y, z = self._wanted
        if self._aligned:
            cos, sin = math.cos(self._yaw), math.sin(self._yaw)
            x, y = cos * x - sin * y, sin * x + cos * y
        share = min(1.0, self._speed / max(math.hypot(x, y, z), _MIN_SPEED))
        walls = zip(self._place, self._lowest, self._highest, (x, y, z), strict=True)
        return [
            min(max(share * wanted, -self._before(place - low)), self._before(high - place))
            for place, low, high, wanted in walls
        ]

    def _before(self, distance: float) -> float:
        """Return the speed at a distance from a wall that requires less than the acceleration.

        For all three axes together: d = v T + v^2 / 2 a, with an a for each axis.
        """
        most = self._limits.acceleration / math.sqrt(_AXES)
        root = math.sqrt(1.0 + 2.0 * max(distance, 0.0) / (most * _WALL_MARGIN**2))
        return most * _WALL_MARGIN * (root - 1.0)

    def _stops_inside(self, velocity: list[float]) -> bool:
        """Whether the vehicle can still stop in the box after a step with a velocity."""
        place = [p + v * _STEP for p, v in zip(self._place, velocity, strict=True)]
        stop = self._stop(place, velocity)
        return all(
            low <= p <= high
            for low, p, high in zip(self._lowest, stop, self._highest, strict=True)
        )

    def _stop(self, place: list[float], velocity: list[float]) -> list[float]:
        """Return the position at rest after braking from a position and a velocity."""
        speed = math.hypot(*velocity)
        if speed == 0.0:
            return place
        count = math.floor(speed / self._slowing)
        travelled = _STEP * (count * speed - 0.5 * self._slowing * count * (count + 1))
        return [p + travelled * v / speed for p, v in zip(place, velocity, strict=True)]


def _towards(values: list[float], wanted: list[float], *, most: float) -> list[float]:
    """Return a vector moved towards another by at most a length."""
    change = [after - before for before, after in zip(values, wanted, strict=True)]
    length = math.hypot(*change)
    if length <= most:
        return wanted
    return [before + most / length * each for before, each in zip(values, change, strict=True)]


def _clipped(value: float, most: float) -> float:
    return min(max(value, -most), most)
