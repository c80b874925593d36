# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""An independent quadrotor simulation with SciPy, to check race plans.

Rotation matrices and Newton-Euler's equations in the body, rotors as forces at their places;
nothing of it is shared with the planner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.extras.racing.planning.race_plan import RacePlan
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Check:
    """Largest deviations of a plan from the states that its inputs lead to.

    ``position`` [m], ``velocity`` [m/s], ``attitude`` [rad], ``rates`` [rad/s]: the largest
    difference of the states at its nodes. ``rotor`` and ``throttle`` by how much the thrust of a
    rotor and of all is beyond the bounds, over the greatest, ``rate`` and ``height`` by how much
    body rates [rad/s] and the ground [m] are. ``missed`` gates, and the ``worst`` miss over the
    opening [m].
    """

    position: float
    velocity: float
    attitude: float
    rates: float
    rotor: float
    throttle: float
    rate: float
    height: float
    missed: int

    @property
    def good(self) -> bool:
        """Whether all of it is small."""
        return (
            self.position < 0.001
            and self.velocity < 0.005
            and self.attitude < 0.001
            and self.rotor < 0.002
            and self.throttle < 0.002
            and self.rate < 0.01
            and self.height < 0.0
            and self.missed == 0
        )


def check(plan: RacePlan, config: FlightConfig) -> Check:
    """Integrate the vehicle with the inputs of a plan, step by step from each node, and compare.

    From node to node and not in one go: errors of a millimetre at a gate would grow, as nothing
    steers; where all steps agree, so does the whole.
    """
    mpc, given, body = config.mpc, config.simulator.rotors, config.simulator.airframe
    xx, yy, zz, xy, xz, yz = body.inertia
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    places = np.column_stack((given.x, given.y, given.z))
    ratio = given.torque_coefficient / given.thrust_coefficient
    axis = np.array([0.0, 0.0, 1.0])
    torques = np.cross(places, axis) - ratio * np.array(given.spin)[:, None] * axis
    mixer = np.vstack((np.ones(len(places)), torques.T))
    lags = np.array([*per_axis(mpc.rate_time_constant), mpc.thrust_time_constant])
    drag = np.array(per_axis(mpc.drag))
    nodes, worst = plan.nodes, np.zeros(4)
    thrusts, rates, heights = [], [], []

    def thrusts_at(since: float, x: Array, u: Array, w: Array) -> Array:
        start = np.append(x[10:13], x[13])
        now = u + (start - u) * np.exp(-since / lags)
        turn = ((u - now) / lags)[:3]
        torque = inertia @ turn + np.cross(w, inertia @ w)
        return np.linalg.solve(mixer, np.append(mpc.mass * now[3], torque))

    for x, u, h, after in zip(
        nodes.states[:-1], nodes.inputs, nodes.steps, nodes.states[1:], strict=True
    ):
        R0 = Rotation.from_quat(np.roll(x[6:10], -1)).as_matrix()

        def rate(time: float, y: Array, x: Array = x, u: Array = u) -> Array:
            v, R, w = y[3:6], y[6:15].reshape(3, 3), y[15:18]
            wrench = mixer @ thrusts_at(time, x, u, w)
            a = R @ (axis * wrench[0] / mpc.mass - drag * (R.T @ v)) - mpc.gravity * axis
            skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
            turn = np.linalg.solve(inertia, wrench[1:] - np.cross(w, inertia @ w))
            return np.concatenate((v, a, (R @ skew).ravel(), turn))

        begin = np.concatenate((x[:6], R0.ravel(), x[10:13]))
        grid = np.linspace(0.0, h, 5)
        found = solve_ivp(rate, (0.0, h), begin, t_eval=grid, rtol=1e-6, atol=1e-7).y.T
        R_after = Rotation.from_quat(np.roll(after[6:10], -1)).as_matrix()
        turned = Rotation.from_matrix(R_after.T @ found[-1, 6:15].reshape(3, 3)).magnitude()
        off = (
            np.abs(found[-1, :3] - after[:3]).max(),
            np.abs(found[-1, 3:6] - after[3:6]).max(),
            turned,
            np.abs(found[-1, 15:18] - after[10:13]).max(),
        )
        worst = np.maximum(worst, off)
        thrusts += [thrusts_at(t, x, u, y[15:18]) for t, y in zip(grid, found, strict=True)]
        rates.append(np.abs(found[:, 15:18]))
        heights.append(found[:, 2])
    every = np.array(thrusts)
    greatest = given.thrust_coefficient * given.speed_max**2
    least = given.thrust_coefficient * given.speed_min**2
    total, vehicle = every.sum(axis=1), mpc.vehicle()
    return Check(
        position=float(worst[0]),
        velocity=float(worst[1]),
        attitude=float(worst[2]),
        rates=float(worst[3]),
        rotor=float(max(every.max() - greatest, least - every.min()) / greatest),
        throttle=float((total.max() - vehicle.thrust(mpc.throttle_max)) / total.max()),
        rate=float((np.concatenate(rates) - mpc.omega_max).max()),
        height=-float(np.concatenate(heights).min()),
        missed=plan.lap.missed,
    )
