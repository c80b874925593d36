# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Your own plant: a class with ``apply``, ``advance_to`` and ``odometry``.

This plant has an additional mass that is not configured, and a battery that discharges during the
flight. Its equations: dv/dt = R_WB e3 T / m - g e3, dR/dt = R [w].
"""

import numpy as np

from quad_mpc_ros import CommandSample, OdometrySample, Vehicle, simulate, so3, summarise

STEP_NS = 2_000_000


class SaggingPlant:
    """A rigid body 10 % heavier than modelled; its thrust falls by 1 % per second."""

    def __init__(self) -> None:
        self.vehicle = Vehicle()
        self.time_ns, self.throttle = 0, self.vehicle.hover_throttle
        self.p_WB, self.v_WB_W, self.w_WB_B = np.array([0.0, 0.0, 2.0]), np.zeros(3), np.zeros(3)
        self.R_WB = np.eye(3)

    def apply(self, command: CommandSample) -> None:
        """Apply a command without lag."""
        self.throttle, self.w_WB_B = command.throttle, command.w_WB_B

    def advance_to(self, time_ns: int) -> None:
        """Integrate to a time from the start [ns]."""
        while self.time_ns < time_ns:
            dt = 1e-9 * min(STEP_NS, time_ns - self.time_ns)
            battery = 1.0 - 0.01 * 1e-9 * self.time_ns
            push = battery * self.vehicle.thrust(self.throttle) / (1.1 * self.vehicle.mass)
            self.R_WB = self.R_WB @ so3.exp(dt * self.w_WB_B)
            self.v_WB_W = self.v_WB_W + dt * (push * self.R_WB[:, 2] - [0.0, 0.0, 9.81])
            self.p_WB = self.p_WB + dt * self.v_WB_W
            self.time_ns += round(1e9 * dt)

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry, with the velocity in body axes."""
        return OdometrySample(
            stamp_ns=stamp_ns,
            p_WB=self.p_WB,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(self.R_WB),
            v_WB_B=self.R_WB.T @ self.v_WB_W,
            w_WB_B=self.w_WB_B,
        )


flight = simulate(plant=SaggingPlant(), duration=10.0)
summary = summarise(flight)
thrust_scale = float(flight.stats["thrust_scale"][-1])
print(f"the square on {SaggingPlant.__name__}: RMSE {summary['position_rmse_m']:.3f} m")
print(f"the controller has learned that the thrust is {thrust_scale:.3f} of the modelled one")
