"""acados as a peer: one real-time iteration with HPIPM on the same problem."""

from __future__ import annotations

from typing import Any

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.limits import SPEED_MARGIN, TILT_MARGIN
from quad_mpc_ros.experiments.bench.acados_solver import FREE, REFERENCE_SIZE
from quad_mpc_ros.experiments.bench.peers import Effort

_SOLVED = 0


class AcadosPeer:
    """Sets state and reference through acados' Python interface and calls its C solver once.

    It samples the reference as the manifold formulation does: states at the stages' ends, inputs
    at their middles.
    """

    def __init__(self, config: MpcConfig, solver: Any) -> None:
        self._vehicle = config.vehicle()
        self._solver = solver
        self._steps, self._step = config.horizon_steps, config.horizon_step
        half_steps = np.arange(1, 2 * self._steps + 1)
        self._offsets_ns = np.rint(config.horizon_step * 0.5e9 * half_steps).astype(np.int64)
        self._references = np.zeros((self._steps + 1, REFERENCE_SIZE))
        self._u_min = np.array([config.throttle_min, *(-w for w in config.omega_max)])
        self._u_max = np.array([config.throttle_max, *config.omega_max])
        self._limits = config.limits
        self._q_xyzw: Array | None = None
        self._status = _SOLVED
        solver.reset()

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the first input of one real-time iteration; None when HPIPM failed."""
        x = self._state(odometry)
        self._set_references(odometry.stamp_ns, window, p_WB=x[:3])
        solver = self._solver
        if self._q_xyzw is None:
            self._start_from(x)
        self._q_xyzw = x[6:]
        solver.set(0, "lbx", x)
        solver.set(0, "ubx", x)
        self._status = solver.solve()
        if self._status != _SOLVED:
            return None
        u = solver.get(0, "u")
        return CommandSample(stamp_ns=odometry.stamp_ns, throttle=float(u[0]), w_WB_B=u[1:])

    def effort(self) -> Effort:
        """Return HPIPM's iterations and the time of the whole call of the C solver."""
        return Effort(
            solved=self._status == _SOLVED,
            iterations=int(np.sum(self._solver.get_stats("qp_iter"))),
            solve_time=float(self._solver.get_stats("time_tot")[0]),
        )

    def inputs(self) -> Array:
        """Return the planned inputs (N, 4)."""
        return np.array([self._solver.get(stage, "u") for stage in range(self._steps)])

    def _state(self, odometry: OdometrySample) -> Array:
        """Return the state of acados' model, the quaternion with the sign of the last one."""
        q_xyzw = odometry.q_WB_xyzw
        v_WB_W = so3.rotation_from_quaternion_xyzw(q_xyzw) @ odometry.v_WB_B
        if self._q_xyzw is not None and q_xyzw @ self._q_xyzw < 0.0:
            q_xyzw = -q_xyzw
        return np.concatenate((odometry.p_WB, v_WB_W, q_xyzw))

    def _start_from(self, x: Array) -> None:
        """Begin the first iteration at the state held, with the inputs of the reference."""
        for stage in range(self._steps + 1):
            self._solver.set(stage, "x", x)
        for stage in range(self._steps):
            self._solver.set(stage, "u", self._references[stage, 15:])

    def _set_references(self, stamp_ns: int, window: ReferenceWindow, *, p_WB: Array) -> None:
        points = sample(window, stamp_ns + self._offsets_ns)
        ends, middles = slice(1, None, 2), slice(0, None, 2)
        references = self._references
        references[1:, 0:3] = points.p_WB[ends]
        references[1:, 3:6] = points.v_WB_W[ends]
        references[1:, 6:15] = points.R_WB[ends].reshape(-1, 9)

        if self._limits.in_use:
            self._set_limits(references[1:], p_WB)

        thrust = self._vehicle.mass * self._vehicle.specific_thrust(
            a_WB_W=points.a_WB_W[middles],
            v_WB_W=points.v_WB_W[middles],
            R_WB=points.R_WB[middles],
        )
        throttles = [self._vehicle.nearest_throttle(t) for t in thrust.tolist()]
        inputs = np.column_stack((throttles, points.w_WB_B[middles]))
        references[:-1, 15:] = np.clip(inputs, self._u_min, self._u_max)
        for stage, reference in enumerate(references):
            self._solver.set(stage, "p", reference)

    def _set_limits(self, references: Array, p_WB: Array) -> None:
        """Draw a far reference (N, ...) near, and set what the limits allow beyond its own."""
        away = p_WB - references[0, 0:3] + self._step * references[0, 3:6]
        far = np.array([np.hypot(away[0], away[1])] * 2 + [abs(away[2])])
        distance = self._limits.pull_distance
        references[:, 0:3] += (1.0 - distance / np.maximum(far, distance)) * away
        most = []
        if "tilt_max" in self._limits.in_use:
            own = np.arccos(np.clip(references[:, 14], -1.0, 1.0))
            tilt = np.maximum(self._limits.tilt_max, own + TILT_MARGIN)
            most += 2 * [np.where(tilt < 0.5 * np.pi, np.sin(tilt), FREE)]
        if "speed_max" in self._limits.in_use:
            own = np.linalg.norm(references[:, 3:6], axis=1)
            most.append(np.maximum(self._limits.speed_max, own + SPEED_MARGIN))
        for stage, bound in enumerate(np.stack(most, axis=1), start=1):
            self._solver.constraints_set(stage, "uh", bound)
            self._solver.constraints_set(stage, "lh", -bound)
