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
lift, change only the thrust. Drag of the rotors, mu + nu sqrt(T / m g), depends on the thrust,
which the same iteration finds. Body rates are then the difference of the attitudes shortly before
and after.

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
_SETTLED, _MOST_ITERATIONS = 1e-12, 100
_PLAIN_ITERATIONS = 30  # until the mean of two successive ones is taken, as they may alternate
_STEP = 1e-4  # s, before and after, between which attitudes give body rates


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
    air, rotors = per_axis(drag), per_axis(rotor_drag)
    x_drag, y_drag, _ = np.add(air, rotors).tolist()  # at the rotors' speed of hover
    z, z_rate, thrust = thrust_axis(
        v_WB_W=v_WB_W,
        a_WB_W=a_WB_W,
        j_WB_W=j_WB_W,
        gravity=gravity,
        drag=x_drag if x_drag == y_drag else 0.5 * (x_drag + y_drag),
    )
    if air[0] == air[1] and not any(rotors):
        if chart is not None:
            z, z_rate = (np.einsum("nji,nj->ni", chart, vector) for vector in (z, z_rate))
        turn = so3.exp(_along_z(yaw, z))
        tilt, tilt_rate = _shortest_tilt(z, z_rate)
        R_WB = np.asarray(tilt @ turn if chart is None else chart @ tilt @ turn)
        w_WB_B = np.einsum("...ji,...j->...i", turn, tilt_rate) + _along_z(yaw_rate, z)
        if air[2] != air[0]:
            thrust = thrust + (air[2] - air[0]) * np.sum(R_WB[..., 2] * v_WB_W, axis=-1)
        return FlatInputs(R_WB=R_WB, w_WB_B=w_WB_B, specific_thrust=thrust)

    def attitude(elapsed: float, start: tuple[Array, Array]) -> tuple[Array, Array]:
        return _with_drag(
            v_WB_W + elapsed * a_WB_W,
            a_WB_W + elapsed * j_WB_W + [0.0, 0.0, gravity],
            so3.exp(_along_z(np.asarray(yaw) + elapsed * np.asarray(yaw_rate), z)),
            start=start,
            air=np.array(air),
            rotors=np.array(rotors) / np.sqrt(gravity),
            chart=np.eye(3) if chart is None else chart,
        )

    R_WB, thrust = attitude(0.0, (z, thrust))
    before, after = (attitude(step, (R_WB[..., 2], thrust))[0] for step in (-_STEP, _STEP))
    w_WB_B = so3.log(np.swapaxes(before, -1, -2) @ after) / (2.0 * _STEP)
    return FlatInputs(R_WB=R_WB, w_WB_B=w_WB_B, specific_thrust=thrust)


def _with_drag(
    v: Array,
    force: Array,
    turn: Array,
    *,
    start: tuple[Array, Array],
    air: Array,
    rotors: Array,
    chart: Array,
) -> tuple[Array, Array]:
    """Return attitude (n, 3, 3) and specific thrust (n,) with drag of body axes and rotors.

    ``v`` and ``force`` (n, 3) are the velocity and the specific force without drag, ``turn``
    (n, 3, 3) the rotations by the yaw, ``start`` an initial direction and size of the specific
    thrust, ``rotors`` (3,) the drag per root of this thrust. An iteration reduces the error by the
    factor drag difference times speed over force, usually below 0.1.
    """
    z, thrust = start
    for count in range(_MOST_ITERATIONS):
        tilt, _ = _shortest_tilt(np.einsum("...ji,...j->...i", chart, z), np.zeros_like(z))
        R = np.asarray(chart @ tilt @ turn)
        drag = air + np.sqrt(np.maximum(thrust, _MIN_FORCE))[:, None] * rotors
        mean = 0.5 * (drag[:, :1] + drag[:, 1:2])
        slowed = (drag - mean) * np.einsum("nji,nj->ni", R, v)
        # With equal drag along x and y, this direction does not depend on the attitude.
        along = force + mean * v + np.einsum("nij,nj->ni", R[..., :2], slowed[:, :2])
        length = np.linalg.norm(along, axis=-1)
        before = np.column_stack((z, thrust))
        after = np.column_stack((along / np.maximum(length, _MIN_FORCE)[:, None], length))
        after[:, 3] += slowed[:, 2]
        if count >= _PLAIN_ITERATIONS:
            after = 0.5 * (before + after)
        z, thrust = after[:, :3], after[:, 3]
        if np.max(np.abs(after - before), initial=0.0) < _SETTLED:
            return R, thrust
    raise ValueError(
        "drag of the body's axes or of the rotors makes the path infeasible: too fast for the "
        "available thrust"
    )


def thrust_axis(
    *,
    v_WB_W: Array,
    a_WB_W: Array,
    j_WB_W: Array,
    gravity: float,
    drag: float,
    seconds: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Return the thrust's direction (n, 3), its time derivative (n, 3), and specific thrust (n,).

    ``drag`` [1/s] is isotropic. Raises ``ValueError`` in free fall, with the first time if
    ``seconds`` (n,) are given.
    """
    force = a_WB_W + drag * v_WB_W + [0.0, 0.0, gravity]
    force_rate = j_WB_W + drag * a_WB_W
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

    The rotation equals :func:`so3.shortest_rotation`, but is precise near straight down and
    shares terms with the rate.
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


def _along_z(amount: ArrayLike, like: Array) -> Array:
    """Return vectors along z, as many as ``like`` has."""
    vectors = np.zeros_like(like)
    vectors[..., 2] = amount
    return vectors
