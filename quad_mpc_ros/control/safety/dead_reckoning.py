# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Dead reckoning from the commands, for the descent after a contradiction."""

from __future__ import annotations

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, Vector3
from quad_mpc_ros.control.lie import kernels

_SMALL_SPEED = 0.5  # m/s, counts as 0


class Track(Record):
    """A state dead reckoned from commands, and a velocity from thrust and reported attitude."""

    v_WB_W: Vector3
    R_WB: Matrix3
    v_attitude_W: Vector3  # with the thrust along the reported attitude


@compiled
def start_track(track: Track, v: kernels.Vector, R: kernels.Matrix) -> None:
    """Start dead reckoning at an attitude and a velocity; a small velocity becomes 0."""
    small = kernels.dot(v, v) < _SMALL_SPEED**2
    begun = kernels.scaled(0.0 if small else 1.0, v)
    kernels.store_vector(begun, track.v_WB_W)
    kernels.store_vector(begun, track.v_attitude_W)
    kernels.store_matrix(R, track.R_WB)


@compiled
def dead_reckon(
    track: Track,
    turn: kernels.Vector,
    R_reported: kernels.Matrix,
    forces: tuple[float, float, float],
    duration: float,
    is_flying: bool,
) -> None:
    """Rotate a track by a rotation vector, and integrate its velocities for a duration [s].

    ``forces`` are the thrust over the mass [m/s^2], the drag [1/s] and the gravity [m/s^2].
    """
    R = kernels.multiply(kernels.matrix(track.R_WB), kernels.exp(turn))
    kernels.store_matrix(R, track.R_WB)
    thrust, drag, gravity = forces
    for v, up in (
        (track.v_WB_W, kernels.column(R, 2)),
        (track.v_attitude_W, kernels.column(R_reported, 2)),
    ):
        for k in range(3):
            v[k] += duration * (thrust * up[k] - drag * v[k])
        v[2] -= duration * gravity
        if not is_flying:  # the ground may carry it
            v[2] = max(v[2], 0.0)
