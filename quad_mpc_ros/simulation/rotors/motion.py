"""The motion of the plant ``rotors`` while neither command nor wind changes, compiled.

One call moves it over any time: the rate loop runs at its own regular times, and between two of
them Runge-Kutta steps of order 4 integrate the equations. The ground is at height 0.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.rotors import rate_loop
from quad_mpc_ros.simulation.rotors.craft import craft_in
from quad_mpc_ros.simulation.rotors.equations import Outside, derivative
from quad_mpc_ros.simulation.rotors.state import origin_height, put, rotation_in, stands

_BODY = slice(0, 13)  # all of a state that the ground holds


@compiled
def advance(
    x: Array,
    memory: Array,
    wanted: Array,
    inputs: Array,
    craft: Array,
    rotors: Array,
    loop: Array,
    mix: Array,
    times_ns: Array,
) -> None:
    """Move a state (14 + n,), the loop's memory (3, 5) and the wanted speeds (n,) over a time.

    ``inputs`` (10,) are throttle and rates commanded, the wind [m/s] and a push [N]; ``times_ns``
    (4,) [ns] are how long to go on, how long until the loop runs next (renewed), its period, and
    the longest step of the integrator.
    """
    center_B = craft_in(craft).center_B
    left = times_ns[0]
    while left > 0:
        if times_ns[1] == 0:
            standing = stands(x, center_B)
            rate_loop.run(
                memory,
                w_WB_B=x[10:13],
                command=inputs[0:4],
                stands=standing,
                loop=loop,
                mix=mix,
                out=wanted,
            )
            times_ns[1] = times_ns[2]
        until = min(left, times_ns[1])
        coast(
            x,
            wanted=wanted,
            inputs=inputs,
            craft=craft,
            rotors=rotors,
            duration_ns=until,
            longest_ns=times_ns[3],
        )
        left -= until
        times_ns[1] -= until


@compiled
def coast(
    x: Array,
    wanted: Array,
    inputs: Array,
    craft: Array,
    rotors: Array,
    duration_ns: int,
    longest_ns: int,
) -> None:
    """Move a state (14 + n,) over a time in which the wanted speeds (n,) stay.

    ``inputs`` are those of :func:`advance`; no step is longer than ``longest_ns``.
    """
    outside = kernels.vector(inputs[4:7]), kernels.vector(inputs[7:10])
    steps = -(-duration_ns // longest_ns)
    for _ in range(steps):
        step(x, wanted, outside, craft=craft, rotors=rotors, duration=duration_ns * 1e-9 / steps)


@compiled
def step(
    x: Array, wanted: Array, outside: Outside, craft: Array, rotors: Array, duration: float
) -> None:
    """Move a state (14 + n,) by one step [s] of the integrator; nothing sinks into the ground."""
    center_B = craft_in(craft).center_B
    stood = stands(x, center_B)
    before = x[_BODY].copy()
    runge_kutta(x, wanted, outside, craft=craft, rotors=rotors, duration=duration)
    above = origin_height(x, center_B) > 0.0
    if stood and not (above and x[5] > 0.0):  # lifted, and not just tipped about its centre
        x[_BODY] = before
    elif not above:
        _land(x, center_B)


@compiled
def runge_kutta(
    x: Array, wanted: Array, outside: Outside, craft: Array, rotors: Array, duration: float
) -> None:
    """Move a state (14 + n,) in free flight by one Runge-Kutta step of order 4 [s]."""
    rate, at, mean = np.empty_like(x), x.copy(), np.zeros_like(x)
    for stage in range(4):
        derivative(at, wanted, outside, craft=craft, rotors=rotors, out=rate)
        weight = (1.0 if stage in (0, 3) else 2.0) / 6.0
        ahead = 0.5 * duration if stage < 2 else duration
        for k in range(x.shape[0]):
            mean[k] += weight * rate[k]
            at[k] = x[k] + ahead * rate[k]
    for k in range(x.shape[0]):
        x[k] += duration * mean[k]
    length = math.sqrt(x[6] * x[6] + x[7] * x[7] + x[8] * x[8] + x[9] * x[9])
    for k in range(6, 10):
        x[k] /= length


@compiled
def odometry(x: Array, craft: Array) -> Array:
    """Return what there is to be measured of the body's origin in a state (14 + n,): (13,).

    Position in the world, attitude as a quaternion x, y, z, w, velocity and body rates in the
    body.
    """
    R_WB, w, center_B = rotation_in(x), kernels.vector(x[10:13]), craft_in(craft).center_B
    seen = np.empty(13)
    to_origin = kernels.scaled(-1.0, center_B)
    p = kernels.plus(kernels.vector(x[0:3]), kernels.apply(R_WB, to_origin))
    v = kernels.apply_transposed(R_WB, kernels.vector(x[3:6]))
    kernels.store_vector(p, seen[0:3])
    seen[3], seen[4], seen[5], seen[6] = kernels.quaternion(R_WB)
    kernels.store_vector(kernels.plus(v, kernels.cross(w, to_origin)), seen[7:10])
    kernels.store_vector(w, seen[10:13])
    return seen


@compiled
def _land(x: Array, center_B: kernels.Vector) -> None:
    """Let the ground make of a body what it does: at rest, level, heading kept."""
    R_WB = rotation_in(x)
    half_yaw = 0.5 * math.atan2(R_WB[3], R_WB[0])
    origin = kernels.plus(
        kernels.vector(x[0:3]), kernels.scaled(-1.0, kernels.apply(R_WB, center_B))
    )
    x[_BODY] = 0.0
    x[8], x[9] = math.sin(half_yaw), math.cos(half_yaw)
    put(x, (origin[0], origin[1], 0.0), center_B)
