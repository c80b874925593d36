# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Your own controller: PID on the position, P on the attitude, body rates and throttle out.

    python examples/own_controller.py
    quad_mpc simulate --controller own_controller:Pid --reference hover
    quad_mpc campaign hover --flights 50 --controller own_controller:Pid

The commands find the module in the working directory. docs/tutorials/your_controller.md explains
each line.
"""

import numpy as np

from quad_mpc_ros import (
    CommandSample,
    FunctionPath,
    MpcConfig,
    OdometrySample,
    ReferenceWindow,
    simulate,
    so3,
    summarise,
)

K_P, K_I, K_D = 4.0, 1.0, 3.0  # 1/s^2, 1/s^3, 1/s
TILT_GAIN, YAW_GAIN = 6.0, 2.0  # 1/s
MAX_INTEGRAL = 2.0  # m s


class Pid:
    """PID on the position; the attitude follows the desired acceleration."""

    def __init__(self, config: MpcConfig) -> None:
        self.vehicle = config.vehicle()
        self.period = 1.0 / config.control_rate
        self.reset()

    def reset(self) -> None:
        """Reset the integral."""
        self.integral = np.zeros(3)

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> CommandSample:
        """Return throttle and body rates for an odometry; the first sample is for its stamp."""
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        R_ref = so3.rotation_from_quaternion_xyzw(reference.q_WB_xyzw[0])
        p_error = reference.p_WB[0] - odometry.p_WB
        v_error = reference.v_WB_W[0] - R_WB @ odometry.v_WB_B
        wanted = self.integral + self.period * p_error
        self.integral = np.clip(wanted, -MAX_INTEGRAL, MAX_INTEGRAL)
        acceleration = reference.a_WB_W[0] + K_P * p_error + K_I * self.integral + K_D * v_error
        acceleration[2] += self.vehicle.gravity
        force = self.vehicle.mass * acceleration
        tilt_error = R_WB.T @ np.cross(R_WB[:, 2], force / np.linalg.norm(force))
        yaw_error = so3.log(R_WB.T @ R_ref)[2]
        return CommandSample(
            stamp_ns=odometry.stamp_ns,
            throttle=self.vehicle.nearest_throttle(float(force @ R_WB[:, 2])),
            w_WB_B=TILT_GAIN * tilt_error + np.array([0.0, 0.0, YAW_GAIN * yaw_error]),
        )


def circle(t: float) -> tuple[float, float, float]:
    """Return a position [m] at a time [s]."""
    return 2.0 * np.cos(t), 2.0 * np.sin(t), 2.0


if __name__ == "__main__":
    path, rmse = FunctionPath(circle, duration=2.0 * np.pi, periodic=True), {}
    for name, controller in {"MPC": None, "PID": Pid(MpcConfig())}.items():
        flight = simulate(trajectory=path, controller=controller, on_reference=True, duration=12.0)
        rmse[name] = summarise(flight)["position_rmse_m"]
        print(f"{name}: two laps of a circle at 2 m/s, RMSE {1000 * rmse[name]:.2f} mm")
