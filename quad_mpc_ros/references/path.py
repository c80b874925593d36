# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Paths: the position of the vehicle's centre over time, and its yaw.

By differential flatness (``flatness.py``) position with its derivatives up to jerk, and yaw,
determine everything else.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from quad_mpc_ros.control.lie import Array

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# The rate of a smooth turn is flat in the middle, where it is 1.52 times the mean.
_RATE_SHAPE = Polynomial([1.0, 0.0, 0.0, 0.0, -1.0]) ** 3
_ANGLE_SHAPE = _RATE_SHAPE.integ(lbnd=-1.0)
# The completed share of the turn at u, and its derivatives.
_SHARES = [
    _ANGLE_SHAPE / _ANGLE_SHAPE(1.0),
    *((_RATE_SHAPE / _ANGLE_SHAPE(1.0)).deriv(order) for order in range(3)),
]

PEAK = float(2.0 * _SHARES[1](0.0))
"""Ratio of the highest to the mean rate of a turn."""

_SAMPLE_STEP, _MAX_SAMPLES = 0.002, 20_000  # s


class SmoothTurn:
    """A turn by ``angle`` [rad] in ``duration`` [s], from rest to rest.

    The rate is proportional to (1 - u^4)^3 for u from -1 to 1: zero with its first two derivatives
    at both ends.
    """

    def __init__(self, angle: float, *, duration: float) -> None:
        self._angle = angle
        self.duration = duration

    @staticmethod
    def with_peak_rate(angle: float, *, rate: float) -> SmoothTurn:
        """Return the turn with a peak rate [rad/s]."""
        return SmoothTurn(angle, duration=PEAK * abs(angle) / rate)

    def at(self, seconds: Array) -> tuple[Array, Array, Array, Array]:
        """Return the angle and its first three derivatives, (n,) each; held at both ends."""
        u = np.clip(2.0 * seconds / self.duration - 1.0, -1.0, 1.0)
        speed = 2.0 / self.duration
        angle, rate, rate_1, rate_2 = (
            self._angle * speed**order * np.asarray(share(u))
            for order, share in enumerate(_SHARES)
        )
        return angle, rate, rate_1, rate_2


@dataclass(frozen=True, kw_only=True, eq=False)
class PathSamples:
    """A path at n times, in the world.

    Shapes: ``p_WB``, ``v_WB_W``, ``a_WB_W``, ``j_WB_W`` (n, 3) in m, m/s, m/s^2, m/s^3; ``yaw``
    [rad] and ``yaw_rate`` [rad/s] (n,) or one number, about the body's z axis.
    """

    p_WB: Array
    v_WB_W: Array
    a_WB_W: Array
    j_WB_W: Array
    yaw: ArrayLike = 0.0
    yaw_rate: ArrayLike = 0.0


class Path(Protocol):
    """A path over time, three times continuously differentiable."""

    @property
    def duration(self) -> float:
        """Duration, or period of a ``periodic`` path [s]."""

    @property
    def periodic(self) -> bool:
        """Whether the path repeats; otherwise it ends at rest."""

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s] from 0 to its duration, or endless."""


class Chain:
    """Successive paths, each starting in the final state of the previous path.

    With ``periodic`` the path repeats: its first state equals its last.
    """

    def __init__(self, links: Sequence[Path], *, periodic: bool = False) -> None:
        self._links = list(links)
        self.periodic = periodic
        self._ends = np.cumsum([link.duration for link in links])
        self.duration = float(self._ends[-1])

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]."""
        if self.periodic:
            seconds = np.mod(seconds, self.duration)
        owner = np.minimum(np.searchsorted(self._ends, seconds, side="right"), len(self._ends) - 1)
        starts = np.append(0.0, self._ends[:-1])
        p, v, a, j = (np.empty((len(seconds), 3)) for _ in range(4))
        yaw, yaw_rate = np.zeros(len(seconds)), np.zeros(len(seconds))
        for number in np.unique(owner).tolist():
            mine = owner == number
            found = self._links[number].at(seconds[mine] - starts[number])
            p[mine], v[mine] = found.p_WB, found.v_WB_W
            a[mine], j[mine] = found.a_WB_W, found.j_WB_W
            yaw[mine], yaw_rate[mine] = found.yaw, found.yaw_rate
        return PathSamples(p_WB=p, v_WB_W=v, a_WB_W=a, j_WB_W=j, yaw=yaw, yaw_rate=yaw_rate)


class Straight:
    """A straight path at a constant velocity (3,) [m/s] from a position (3,) [m]."""

    periodic = True

    def __init__(self, p_WB: Array, *, v_WB_W: Array, duration: float = 1.0) -> None:
        self._p_WB, self._v_WB_W = p_WB, v_WB_W
        self.duration = duration

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]."""
        rest = np.zeros((len(seconds), 3))
        return PathSamples(
            p_WB=self._p_WB + seconds[:, None] * self._v_WB_W,
            v_WB_W=rest + self._v_WB_W,
            a_WB_W=rest,
            j_WB_W=rest,
        )


class RestPath(Straight):
    """A path that stays at a position (3,) [m]."""

    def __init__(self, p_WB: Array, *, duration: float) -> None:
        super().__init__(p_WB, v_WB_W=np.zeros(3), duration=duration)


class CircularPath:
    """A part of a circle from rest to rest."""

    periodic = False

    def __init__(
        self, start: Array, *, forwards: Array, inwards: Array, radius: float, turn: SmoothTurn
    ) -> None:
        """Take the circle at its start.

        Args:
            start: Position (3,) [m].
            forwards: Unit vector (3,) of the first motion.
            inwards: Unit vector (3,) from the start to the centre.
            radius: Radius [m].
            turn: The angle over time.
        """
        self._centre = start + radius * inwards
        self._forwards, self._inwards = radius * forwards, radius * inwards
        self._turn = turn
        self.duration = turn.duration

    def at(self, seconds: Array) -> PathSamples:
        """Return the circle at times (n,) [s]."""
        angle, w, w_1, w_2 = (each[:, None] for each in self._turn.at(seconds))
        along = np.cos(angle) * self._forwards + np.sin(angle) * self._inwards
        inwards = np.cos(angle) * self._inwards - np.sin(angle) * self._forwards
        return PathSamples(
            p_WB=self._centre - inwards,
            v_WB_W=w * along,
            a_WB_W=w**2 * inwards + w_1 * along,
            j_WB_W=3.0 * w * w_1 * inwards + (w_2 - w**3) * along,
        )


class SplinePath:
    """A spline of degree 5 or more from 0 to ``duration`` [s].

    The values are positions [m] (n, 3), or (n, 4) with the yaw [rad] as the last column.
    """

    periodic = False

    def __init__(self, curve: BSpline, *, duration: float) -> None:
        self.duration = duration
        self._curves = [curve.derivative(order) if order else curve for order in range(4)]

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s] from 0 to its duration."""
        seconds = np.clip(seconds, 0.0, self.duration)
        p, v, a, j = (np.asarray(curve(seconds)) for curve in self._curves)
        still = np.zeros(len(seconds))
        return PathSamples(
            p_WB=p[:, :3],
            v_WB_W=v[:, :3],
            a_WB_W=a[:, :3],
            j_WB_W=j[:, :3],
            yaw=p[:, 3] if p.shape[1] > 3 else still,
            yaw_rate=v[:, 3] if v.shape[1] > 3 else still,
        )


class DisplacedPath:
    """A path displaced by ``offset`` (3,) [m]."""

    def __init__(self, path: Path, offset: Array) -> None:
        self._path, self._offset = path, offset
        self.duration, self.periodic = path.duration, path.periodic

    def at(self, seconds: Array) -> PathSamples:
        """Return the displaced path at times (n,) [s]."""
        found = self._path.at(seconds)
        return dataclasses.replace(found, p_WB=found.p_WB + self._offset)


class Slowed:
    """A path that takes ``factor`` times as long: uniform time scaling."""

    def __init__(self, path: Path, factor: float) -> None:
        self._path, self._factor = path, factor
        self.duration, self.periodic = factor * path.duration, path.periodic

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]; the n-th derivative shrinks by factor^n."""
        k, found = self._factor, self._path.at(seconds / self._factor)
        return PathSamples(
            p_WB=found.p_WB,
            v_WB_W=found.v_WB_W / k,
            a_WB_W=found.a_WB_W / k**2,
            j_WB_W=found.j_WB_W / k**3,
            yaw=found.yaw,
            yaw_rate=np.asarray(found.yaw_rate) / k,
        )


class Turned:
    """A path whose yaw [rad] is the first coordinate of another path."""

    def __init__(self, path: Path, yaw: Path) -> None:
        self._path, self._yaw = path, yaw
        self.duration, self.periodic = path.duration, path.periodic

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]."""
        yaw = self._yaw.at(seconds)
        return dataclasses.replace(
            self._path.at(seconds), yaw=yaw.p_WB[:, 0], yaw_rate=yaw.v_WB_W[:, 0]
        )


def with_lowest_point(path: Path, height: float) -> Path:
    """Return the path lifted until its lowest point is at ``height`` [m]."""
    count = min(2 + round(path.duration / _SAMPLE_STEP), _MAX_SAMPLES)
    times = np.linspace(0.0, path.duration, count)
    lowest = float(path.at(times).p_WB[:, 2].min())
    return DisplacedPath(path, (height - lowest) * np.array([0.0, 0.0, 1.0]))
