# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Differential flatness with drag: from a path and a yaw to attitude, body rates and thrust.

The model is the controller's: dv/dt = g + (T/m) z_B - mu v, so the specific thrust must be the
specific force f = a + mu v + g e_3. This force determines the direction z_B = f/|f| of the body's
z axis and, through df/dt = j + mu a, its rotation. The rotation about z_B remains free.

With a drag -R D R' v, D = diag(mu_x, mu_y, mu_z), the body's x axis must be across a + mu_x v + g
e_3 and its y axis across a + mu_y v + g e_3 (Faessler, Franchi, Scaramuzza, "Differential flatness
of quadrotor dynamics subject to rotor drag", RA-L 2018): the attitude depends on the yaw, and is
found by iteration from the attitude for the mean of both. Forces along the body's z axis, mu_z and
lift, change only the thrust.

Drag of the rotors, mu + nu sqrt(T / m g), depends on the thrust and its rate of change, which are
found by an outer iteration.

Attitude is the shortest rotation from the world's z axis to z_B, followed by the yaw about
z_B: the Hopf fibration of Watterson and Kumar, "Control of quadrotors using the Hopf fibration on
SO(3)" (ISRR 2017). Level and at yaw 0 the vehicle heads east. Unlike a heading, which is undefined
when the nose points up, this chart is singular only for z_B = -e_3, thrust exactly downwards;
``chart`` moves the centre of the map away from e_3.

No continuous map from the thrust direction to attitude exists on the whole sphere. A path flown
upside down therefore uses rotation-minimising frames: the body turns with its thrust axis and
never about this axis, w_z = 0, with the lowest body rates; a vertical loop is continuous pitching
through 180 degrees (Wang, Juettler, Zheng and Liu, "Computation of rotation minimizing frames",
2008). :class:`ThrustFrames` is a sequence of charts, one at each knot in time, centred on the
thrust direction at the knot and joined so that the attitude is continuous; no chart is used near
its singularity. The heading after a manoeuvre then depends on the path, so a path whose thrust
stays above the horizon uses the single chart, in which yaw is defined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from quad_mpc_ros.configuration import PerAxis, per_axis
from quad_mpc_ros.control.lie import Array, so3

# Below this specific thrust [m/s^2] the vehicle falls freely, and may do so in any attitude.
_MIN_FORCE = 1e-3
_REVERSAL_COSINE = -0.99  # cosine of a turn in 2 ms that is none
_UPSIDE_DOWN_COSINE = -1.0 + 1e-9  # cosine of the tilt
_UP = np.array([[0.0, 0.0, 1.0]])
_SETTLED, _MOST_ITERATIONS = 1e-13, 100
_PLAIN_ITERATIONS = 30  # until the mean of two successive ones is taken, as they may alternate
_ROTOR_TOLERANCE = 1e-10  # of their speed over that of hover, and per second


@dataclass(frozen=True, kw_only=True, eq=False)
class FlatInputs:
    """Attitude and inputs at n times.

    Shapes: ``R_WB`` (n, 3, 3); ``w_WB_B`` (n, 3) [rad/s]; ``specific_thrust`` (n,), thrust over
    mass along body z [m/s^2].
    """

    R_WB: Array
    w_WB_B: Array
    specific_thrust: Array


def flat_inputs(
    *,
    v_WB_W: Array,
    a_WB_W: Array,
    j_WB_W: Array,
    yaw: ArrayLike = 0.0,
    yaw_rate: ArrayLike = 0.0,
    gravity: float,
    drag: PerAxis,
    rotor_drag: PerAxis = 0.0,
    chart: Array | None = None,
) -> FlatInputs:
    """Return attitude, rates and thrust of a path; velocity, acceleration and jerk (n, 3), in W.

    ``yaw`` [rad] and ``yaw_rate`` [rad/s], (n,) or one number, are about the body's z axis;
    ``gravity`` [m/s^2], ``drag`` and ``rotor_drag`` [1/s] are the vehicle's. ``chart`` (n, 3, 3)
    are the rotations from which the shortest tilt starts, instead of level and heading east.
    Raises ``ValueError`` in free fall, if the thrust points exactly against the chart's z axis
    (downwards without a chart), and if anisotropic drag makes the path infeasible.
    """
    motion = _Motion(
        v=v_WB_W,
        a=a_WB_W,
        j=j_WB_W,
        yaw=yaw,
        yaw_rate=yaw_rate,
        gravity=gravity,
        chart=chart,
    )
    air, rotors = np.array([per_axis(drag)]), np.array([per_axis(rotor_drag)])
    if not rotors.any():
        return motion.inputs(air, np.zeros_like(air))
    speed, speed_rate = np.ones((len(v_WB_W), 1)), np.zeros((len(v_WB_W), 1))
    for count in range(_MOST_ITERATIONS):
        found = motion.inputs(air + speed * rotors, speed_rate * rotors)
        thrust = np.maximum(found.specific_thrust, _MIN_FORCE)
        rate = motion.thrust_rate(found, air + speed * rotors, speed_rate * rotors)
        before = speed, speed_rate
        speed = np.sqrt(thrust / gravity)[:, None]
        speed_rate = 0.5 * rate[:, None] / (gravity * speed)
        if count >= _PLAIN_ITERATIONS:
            speed, speed_rate = 0.5 * (before[0] + speed), 0.5 * (before[1] + speed_rate)
        off = max(np.max(np.abs(speed - before[0])), np.max(np.abs(speed_rate - before[1])))
        if off < _ROTOR_TOLERANCE:
            return found
    raise ValueError(
        "drag of the rotors makes the path infeasible: too fast for the available thrust"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motion:
    """A path at n times, see :func:`flat_inputs`, and constants of the vehicle."""

    v: Array
    a: Array
    j: Array
    yaw: ArrayLike
    yaw_rate: ArrayLike
    gravity: float
    chart: Array | None

    def inputs(self, drag: Array, drag_rate: Array) -> FlatInputs:
        """Return attitude, rates and thrust for a drag per axis and its rate, (1, 3) or (n, 3)."""
        chart, x_drag, y_drag = self.chart, drag[:, :1], drag[:, 1:2]
        is_even = bool(np.all(x_drag == y_drag))
        mean = x_drag if is_even else 0.5 * (x_drag + y_drag)
        z, z_rate, thrust = thrust_axis(
            v_WB_W=self.v,
            a_WB_W=self.a,
            j_WB_W=self.j,
            gravity=self.gravity,
            drag=mean,
            drag_rate=0.5 * (drag_rate[:, :1] + drag_rate[:, 1:2]),
        )
        if chart is not None:
            z, z_rate = (np.einsum("nji,nj->ni", chart, vector) for vector in (z, z_rate))
        turn = so3.exp(_along_z(self.yaw, z))
        if not is_even:
            anisotropic = self._anisotropic(drag, drag_rate)
            z, thrust = anisotropic.axis(z, turn)
            z_rate = anisotropic.axis_rate(z, turn, self.yaw_rate)
        tilt, tilt_rate = _shortest_tilt(z, z_rate)
        R_WB = np.asarray(tilt @ turn if chart is None else chart @ tilt @ turn)
        more = (drag[:, 2:] - mean)[:, 0]
        if more.any():
            v_WB_B = np.einsum("nji,nj->ni", R_WB, self.v)
            thrust = thrust + more * v_WB_B[:, 2]
        return FlatInputs(
            R_WB=R_WB,
            w_WB_B=np.einsum("...ji,...j->...i", turn, tilt_rate) + _along_z(self.yaw_rate, z),
            specific_thrust=thrust,
        )

    def thrust_rate(self, inputs: FlatInputs, drag: Array, drag_rate: Array) -> Array:
        """Return the time derivative of the specific thrust (n,) [m/s^3].

        Derivative of z'(a + g e_3) + mu_z u_z, with u = R' v.
        """
        R, w = inputs.R_WB, inputs.w_WB_B
        u, a, j = (np.einsum("nji,nj->ni", R, vector) for vector in (self.v, self.a, self.j))
        f = a + self.gravity * R[:, 2]
        u_rate = a - np.cross(w, u)
        # d(z'f) of the world is z'j + (w x e_3)' f of the body.
        turned = w[:, 1] * f[:, 0] - w[:, 0] * f[:, 1]
        dragged = drag[:, 2] * u_rate[:, 2] + drag_rate[:, 2] * u[:, 2]
        return np.asarray(j[:, 2] + turned + dragged)

    def _anisotropic(self, drag: Array, drag_rate: Array) -> _AnisotropicDrag:
        up = _along_z(self.gravity, self.v)
        parts: tuple[Array, ...] = (self.v, self.a + up, self.a, self.j)
        if self.chart is not None:
            parts = tuple(np.einsum("nji,nj->ni", self.chart, vector) for vector in parts)
        v, force, a, j = parts
        return _AnisotropicDrag(v=v, force=force, a=a, j=j, drag=drag, drag_rate=drag_rate)


@dataclass(frozen=True, kw_only=True, eq=False)
class _AnisotropicDrag:
    """Motions (n, 3) in a chart: velocity, acceleration with and without gravity, and jerk.

    ``drag`` [1/s] and its rate [1/s^2], (1, 3) or (n, 3), are along the body axes.
    """

    v: Array
    force: Array
    a: Array
    j: Array
    drag: Array
    drag_rate: Array

    def axis(self, z: Array, turn: Array) -> tuple[Array, Array]:
        """Return the thrust direction (n, 3), and the force along it without lift (n,).

        ``z`` (n, 3) is the initial direction. An iteration reduces the error by the factor drag
        difference times speed over force, usually below 0.1.
        """
        x_drag, y_drag = self.drag[:, :1], self.drag[:, 1:2]
        mean, half = 0.5 * (x_drag + y_drag), 0.5 * (x_drag - y_drag)
        for count in range(_MOST_ITERATIONS):
            tilt, _ = _shortest_tilt(z, np.zeros_like(z))
            R = tilt @ turn
            x, y = R[..., 0], R[..., 1]
            sideways = _along(x, self.v) * x - _along(y, self.v) * y
            force = self.force + mean * self.v + half * sideways
            length = np.sqrt(np.sum(force * force, axis=-1, keepdims=True))
            before, z = z, force / np.maximum(length, _MIN_FORCE)
            if count >= _PLAIN_ITERATIONS:
                z = 0.5 * (before + z)
            if np.max(np.abs(z - before), initial=0.0) < _SETTLED:
                return z, length[..., 0]
        raise ValueError(
            f"drag of {x_drag.max():g} and {y_drag.max():g} 1/s along body x and y makes the "
            "path infeasible: too fast for the available thrust"
        )

    def axis_rate(self, z: Array, turn: Array, yaw_rate: ArrayLike) -> Array:
        """Return the time derivative (n, 3) of the thrust's direction.

        Derivative of x'(force + mu_x v) = 0 and y'(force + mu_y v) = 0, in which the body rotates
        with (w_x, w_y) and, from tilt and yaw, about z.
        """
        tilt, _ = _shortest_tilt(z, np.zeros_like(z))
        R = tilt @ turn
        x, y = R[..., 0], R[..., 1]
        (x_drag, y_drag), (x_rate, y_rate) = (
            (each[:, :1], each[:, 1:2]) for each in (self.drag, self.drag_rate)
        )
        across_x, across_y = self.force + x_drag * self.v, self.force + y_drag * self.v
        # w_z = yaw_rate + along_x w_x + along_y w_y, from dz = w_y x - w_x y.
        _, by_x = _shortest_tilt(z, -y)
        _, by_y = _shortest_tilt(z, x)
        along_x, along_y = by_x[..., 2:], by_y[..., 2:]
        spin = np.broadcast_to(np.asarray(yaw_rate, dtype=np.float64), z.shape[:-1])[..., None]
        # w_y z'a - w_z y'a = x'da,   w_x z'b - w_z x'b = -y'db
        ya, xb = _along(y, across_x), _along(x, across_y)
        right_y = _along(x, self.j + x_drag * self.a + x_rate * self.v) + spin * ya
        right_x = -_along(y, self.j + y_drag * self.a + y_rate * self.v) + spin * xb
        yy, yx = _along(z, across_x) - along_y * ya, -along_x * ya
        xx, xy = _along(z, across_y) - along_x * xb, -along_y * xb
        determinant = xx * yy - xy * yx
        w_x = (right_x * yy - right_y * xy) / determinant
        w_y = (right_y * xx - right_x * yx) / determinant
        return np.asarray(w_y * x - w_x * y)


def thrust_axis(
    *,
    v_WB_W: Array,
    a_WB_W: Array,
    j_WB_W: Array,
    gravity: float,
    drag: float | Array,
    drag_rate: float | Array = 0.0,
    seconds: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Return the thrust's direction (n, 3), its time derivative (n, 3), and specific thrust (n,).

    ``drag`` [1/s] and its rate of change [1/s^2] are one number, or one for each time (n, 1).
    Raises ``ValueError`` in free fall, with the first time if ``seconds`` (n,) are given.
    """
    force = a_WB_W + drag * v_WB_W + [0.0, 0.0, gravity]
    force_rate = j_WB_W + drag * a_WB_W + drag_rate * v_WB_W
    thrust = np.sqrt(np.sum(force * force, axis=-1))
    falls = ~(np.isfinite(thrust) & (thrust > _MIN_FORCE))
    if falls.any():
        when = "" if seconds is None else f"at {seconds[np.argmax(falls)]:.3f} s "
        raise ValueError(
            f"{when}specific thrust {np.min(thrust):.3g} to {np.max(thrust):.3g} m/s^2, expected "
            f"finite values above {_MIN_FORCE:g}: in free fall the attitude is undefined"
        )
    z = force / thrust[..., None]
    along = np.sum(z * force_rate, axis=-1, keepdims=True)
    return z, (force_rate - along * z) / thrust[..., None], thrust


class ThrustFrames:
    """The charts of a path, by time."""

    def __init__(self, knots: Array, z: Array) -> None:
        """Join charts at ``knots`` (n,) [s], where the thrust points along ``z`` (n, 3).

        Raises ``ValueError`` if the thrust reverses between two knots.
        """
        about = np.flatnonzero(np.sum(z[:-1] * z[1:], axis=-1) < _REVERSAL_COSINE)
        if len(about):
            raise ValueError(f"at {knots[about[0]]:.3f} s the thrust direction reverses instantly")
        self._knots = knots
        self._charts = np.empty((len(knots), 3, 3))
        chart = so3.shortest_rotation(_UP, z[:1])[0]
        self._charts[0] = chart
        for place, step in enumerate(so3.shortest_rotation(z[:-1], z[1:]), start=1):
            chart = step @ chart
            self._charts[place] = chart

    def at(self, seconds: Array) -> Array:
        """Return the charts (n, 3, 3) for times (n,) [s]."""
        last = len(self._knots) - 1
        places = np.clip(np.searchsorted(self._knots, seconds, side="right") - 1, 0, last)
        return np.asarray(self._charts[places])


def yaw_of(R_WB: Array) -> float:
    """Return the yaw [rad] of an attitude (3, 3), the rotation after the shortest tilt.

    Exactly upside down, return the heading of the x axis.
    """
    if R_WB[2, 2] < _UPSIDE_DOWN_COSINE:
        return math.atan2(R_WB[1, 0], R_WB[0, 0])
    turn = so3.shortest_rotation(_UP, R_WB[None, :, 2])[0].T @ R_WB
    return math.atan2(turn[1, 0], turn[0, 0])


def _shortest_tilt(z: Array, z_rate: Array) -> tuple[Array, Array]:
    """Return the shortest rotation from e_3 to z (n, 3, 3), and its body rate (n, 3).

    The rotation is that of :func:`so3.shortest_rotation`, computed precisely near straight down
    and with terms shared with the rate.
    """
    a, b, c = np.moveaxis(z, -1, 0)
    a_rate, b_rate, c_rate = np.moveaxis(z_rate, -1, 0)
    # 1 + c, without cancellation where c is near -1.
    h = np.where(c < 0.0, (a * a + b * b) / (1.0 + np.abs(c)), 1.0 + c)
    if not np.all(h > 0.0):
        raise ValueError("the thrust points exactly downwards, where yaw is undefined")
    tilt = np.stack(
        (
            np.stack((1.0 - a * a / h, -a * b / h, a), axis=-1),
            np.stack((-a * b / h, 1.0 - b * b / h, b), axis=-1),
            np.stack((-a, -b, c), axis=-1),
        ),
        axis=-2,
    )
    tilt_rate = np.stack(  # vee(tilt.T d(tilt)/dt)
        (
            b * c_rate / h - b_rate,
            a_rate - a * c_rate / h,
            (b * a_rate - a * b_rate) / h,
        ),
        axis=-1,
    )
    return tilt, tilt_rate


def _along(axis: Array, vector: Array) -> Array:
    """Return components (n, 1)."""
    return np.asarray(np.sum(axis * vector, axis=-1, keepdims=True))


def _along_z(amount: ArrayLike, like: Array) -> Array:
    """Return vectors along z, as many as ``like`` has."""
    vectors = np.zeros_like(like)
    vectors[..., 2] = amount
    return vectors
