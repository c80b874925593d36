"""Separation of vehicles that share their plans, by a plane at each stage.

At each stage the plane is half way between the two plans, perpendicular to the line between them
but turned about the vertical. Both vehicles know both plans and turn the plane equally, so each
evades to its right, and a symmetric encounter does not block. Heights have a lower weight in
distances because of downwash: ellipsoids longer in z (Luis, Vukosavljev, Schoellig, "Online
trajectory generation with distributed model predictive control for multi-robot motion planning",
RA-L 2020). With n of unit length in scaled space,

    n' p_i <= n' (p_i + q_i) / 2 - d / 2      n' q_i >= n' (p_i + q_i) / 2 + d / 2

so that the scaled distance is at least d if both vehicles stay on their side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import Array

_ACTIVATION_DISTANCE = 0.4  # m, beyond the distance kept: a plane separates nearer plans
_AVOIDANCE_ANGLE = 0.35  # rad, to the right


class Plans(NamedTuple):
    """Planned positions of m neighbours at n times (m, n, 3) [m], and their ages (m,) [s]."""

    p_W: Array
    age: Array


class Shared(NamedTuple):
    """Half-spaces (n, m, 3) and (n, m) of m neighbours, nearest first."""

    normals: Array
    offsets: Array


def shared_space(
    own_W: Array, plans: Plans, *, keep: Array, heights_count: float
) -> Shared | None:
    """Return half-spaces that separate this vehicle's plan (n, 3) from the neighbours' plans.

    ``keep`` (m,) [m] are the scaled distances to keep, ``heights_count`` the weight of heights.
    None if no plan is near.
    """
    scale = np.array([1.0, 1.0, heights_count])
    away = (plans.p_W - own_W) * scale
    apart = np.linalg.norm(away, axis=2)
    room = (apart - keep[:, None]).min(axis=1, initial=math.inf)
    near = np.flatnonzero(room < _ACTIVATION_DISTANCE)
    if len(near) == 0:
        return None
    near = near[np.argsort(room[near], kind="stable")]
    away, apart = away[near], apart[near]
    beside = np.maximum(apart, 1e-6)[..., None]
    n = np.where(apart[..., None] > 1e-6, away / beside, [1.0, 0.0, 0.0])
    x, y = n[..., 0].copy(), n[..., 1].copy()
    n[..., 0] = math.cos(_AVOIDANCE_ANGLE) * x - math.sin(_AVOIDANCE_ANGLE) * y
    n[..., 1] = math.sin(_AVOIDANCE_ANGLE) * x + math.cos(_AVOIDANCE_ANGLE) * y
    middle = 0.5 * (own_W + plans.p_W[near]) * scale
    offsets = (n * middle).sum(axis=2) - 0.5 * keep[near, None]
    normals = n * scale
    lengths = np.linalg.norm(normals, axis=2)
    return Shared(
        np.swapaxes(normals / lengths[..., None], 0, 1).copy(),
        np.swapaxes(offsets / lengths, 0, 1).copy(),
    )
