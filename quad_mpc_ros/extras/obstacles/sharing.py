"""Between vehicles that know each other's plans: a plane at each time, and each keeps to his side.

At each stage's time the plane lies half way between the two plans, across the line that joins
them, turned by an angle about the vertical: both know the same plans and turn the same way, so
each slides along it to his right, and a meeting that is its own mirror image does not block. In
distances heights count less, for the air below rotors comes down: ellipsoids longer in z
(Luis, Vukosavljev, Schoellig, "Online trajectory generation with distributed model predictive
control for multi-robot motion planning", RA-L 2020). With n of unit length in scaled space,

    n' p_i <= n' (p_i + q_i) / 2 - d / 2      n' q_i >= n' (p_i + q_i) / 2 + d / 2

so that, where both keep to it, the scaled distance is at least d.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from quad_mpc_ros.control.lie import Array

_ACTIVATION_DISTANCE = 0.4  # m, beyond the distance kept: a plane separates nearer plans
_AVOIDANCE_ANGLE = 0.35  # rad, to the right


class Plans(NamedTuple):
    """Where m neighbours plan to be at n times (m, n, 3) [m], and how old that is (m,) [s]."""

    p_W: Array
    age: Array


class Neighbours(Protocol):
    """Who else flies, in the frame of the odometry."""

    def plans(self, stamps_ns: Sequence[int]) -> Plans:
        """Return where neighbours with a recent message plan to be at times [ns]."""
        ...


class Shared(NamedTuple):
    """Half-spaces (n, m, 3) and (n, m) of m neighbours, the nearest first."""

    normals: Array
    offsets: Array


def shared_space(
    own_W: Array, plans: Plans, *, keep: Array, heights_count: float
) -> Shared | None:
    """Return this vehicle's half of the space between its plan (n, 3) and others' at the times.

    Scaled distances ``keep`` (m,) [m] are kept, in which heights count for a share. None where no
    plan is near.
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
