# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The cascade of PX4's multicopter controllers, with its default gains.

PX4-Autopilot, ``mc_pos_control`` (``PositionControl.cpp``) and ``mc_att_control``
(``AttitudeControl.cpp``): P position, PID velocity, tilt from the acceleration setpoint, and the
quaternion controller of D. Brescianini, M. Hehn and R. D'Andrea (2013), in which yaw has a smaller
weight. The vehicle's rate loop replaces ``mc_rate_control``. Position, velocity, acceleration, yaw
and yaw rate of the reference are the setpoints, as in offboard control; PX4 has no setpoint for
roll and pitch rates.

Gains and limits: PX4's defaults, by the names of its parameters. Thrust is scaled with mass and
thrust curve, where PX4 uses MPC_THR_HOVER, so that the hover thrust is exact from the start.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.extras.controllers.tracking import (
    TrackingState,
    attitude_of_thrust,
    command,
    tracked,
)

POSITION_P = np.array([0.95, 0.95, 1.0])  # MPC_XY_P, MPC_Z_P
VELOCITY_P = np.array([1.8, 1.8, 4.0])  # MPC_XY_VEL_P_ACC, MPC_Z_VEL_P_ACC
VELOCITY_I = np.array([0.4, 0.4, 2.0])  # MPC_XY_VEL_I_ACC, MPC_Z_VEL_I_ACC
VELOCITY_D = np.array([0.2, 0.2, 0.0])  # MPC_XY_VEL_D_ACC, MPC_Z_VEL_D_ACC
SPEED_MAX, SPEED_UP, SPEED_DOWN = 12.0, 3.0, 1.5  # MPC_XY_VEL_MAX, MPC_Z_VEL_MAX_UP, _DN
TILT_MAX = math.radians(45.0)  # MPC_TILTMAX_AIR
THRUST_MIN, HORIZONTAL_MARGIN = 0.12, 0.3  # MPC_THR_MIN, MPC_THR_XY_MARG, of the largest thrust
DERIVATIVE_CUTOFF = 5.0  # Hz, MPC_VELD_LP
YAW_WEIGHT = 0.4  # MC_YAW_WEIGHT
ATTITUDE_P = np.array([6.5, 6.5, 2.8 / YAW_WEIGHT])  # MC_ROLL_P, MC_PITCH_P, MC_YAW_P
RATE_MAX = np.radians([220.0, 220.0, 200.0])  # MC_ROLLRATE_MAX, MC_PITCHRATE_MAX, MC_YAWRATE_MAX

_LONGEST_STEP = 0.1  # s; PX4 bounds the time between updates as well


class Px4Controller:
    """PX4's position and attitude controllers; see the module for source and gains."""

    def __init__(self, config: MpcConfig) -> None:
        """Take mass, thrust curve and gravity of the vehicle."""
        self._vehicle = config.vehicle()
        self._gravity = self._vehicle.gravity
        self._largest = self._vehicle.thrust(1.0) / self._vehicle.mass  # m/s^2
        self.reset()

    def reset(self) -> None:
        """Discard the integral and the filtered acceleration."""
        self._integral, self._acceleration = np.zeros(3), np.zeros(3)
        self._last: tuple[int, Array] | None = None

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> CommandSample:
        """Return the command for an odometry."""
        x = tracked(odometry, reference)
        duration = self._differentiate(odometry.stamp_ns, x.v_WB_W)
        thrust = self._thrust(x, duration)
        R_d = attitude_of_thrust(thrust, yaw=x.yaw)
        yaw_rate = float(reference.w_WB_W[0, 2])
        rates = _attitude_control(x.R_WB, R_d) + yaw_rate * x.R_WB[2]
        return command(
            odometry,
            throttle=self._vehicle.nearest_throttle(
                self._vehicle.mass * float(np.linalg.norm(thrust))
            ),
            w_WB_B=np.clip(rates, -RATE_MAX, RATE_MAX),
        )

    def _differentiate(self, stamp_ns: int, v_WB_W: Array) -> float:
        """Update the filtered acceleration; return the time since the last odometry [s]."""
        last, self._last = self._last, (stamp_ns, v_WB_W)
        if last is None or stamp_ns <= last[0]:
            return 0.0
        duration = min(1e-9 * (stamp_ns - last[0]), _LONGEST_STEP)
        share = duration / (duration + 1.0 / (math.tau * DERIVATIVE_CUTOFF))
        self._acceleration += share * ((v_WB_W - last[1]) / duration - self._acceleration)
        return duration

    def _thrust(self, x: TrackingState, duration: float) -> Array:
        """Return the specific thrust (3,) [m/s^2] in the world, and update the integral."""
        wanted = _velocity_setpoint(-POSITION_P * x.p_error, x.v_ref)
        error = wanted - x.v_WB_W
        acceleration = (
            x.a_ref + VELOCITY_P * error + self._integral - VELOCITY_D * self._acceleration
        )
        tilted = np.array([acceleration[0], acceleration[1], self._gravity])
        horizontal = math.hypot(tilted[0], tilted[1])
        tilt = min(math.atan2(horizontal, self._gravity), TILT_MAX)
        direction = np.array([0.0, 0.0, math.cos(tilt)])
        if horizontal > 0.0:
            direction[:2] = math.sin(tilt) * tilted[:2] / horizontal
        least = THRUST_MIN * self._largest
        upward = acceleration[2] + self._gravity
        thrust = direction * max(upward / direction[2], least)
        if (upward <= least and error[2] <= 0.0) or (upward >= self._largest and error[2] >= 0.0):
            error[2] = 0.0
        thrust = self._saturated(thrust)
        produced = thrust[:2] * 1.0
        missing = acceleration[:2] - produced
        if np.linalg.norm(acceleration[:2]) > np.linalg.norm(produced):
            error[:2] -= 2.0 / VELOCITY_P[0] * missing
        self._integral += duration * VELOCITY_I * error
        self._integral[2] = np.clip(self._integral[2], -self._gravity, self._gravity)
        return thrust

    def _saturated(self, thrust: Array) -> Array:
        """Return the thrust within its bound; vertical thrust has priority but for a margin."""
        horizontal = float(np.linalg.norm(thrust[:2]))
        kept = min(horizontal, HORIZONTAL_MARGIN * self._largest)
        up = min(float(thrust[2]), math.sqrt(self._largest**2 - kept**2))
        left = math.sqrt(max(self._largest**2 - up**2, 0.0))
        share = 1.0 if horizontal <= left else left / horizontal
        return np.array([share * thrust[0], share * thrust[1], up])


def _velocity_setpoint(correction: Array, forward: Array) -> Array:
    """Return correction plus feed-forward (3,) [m/s] in the limits; the correction comes first."""
    total = correction + forward
    first = float(np.linalg.norm(correction[:2]))
    if first > SPEED_MAX:
        total[:2] = correction[:2] * SPEED_MAX / first
    elif np.linalg.norm(total[:2]) > SPEED_MAX:
        # The largest share of the feed-forward that keeps the sum within the limit.
        a, b = float(forward[:2] @ forward[:2]), float(correction[:2] @ forward[:2])
        share = (-b + math.sqrt(b * b - a * (first**2 - SPEED_MAX**2))) / a
        total[:2] = correction[:2] + share * forward[:2]
    total[2] = np.clip(total[2], -SPEED_DOWN, SPEED_UP)
    return total


def _attitude_control(R_WB: Array, R_d: Array) -> Array:
    """Return body rates (3,) [rad/s] towards an attitude, with less weight on yaw."""
    reduced = R_WB @ so3.exp(so3.shortest_turn_of_z(R_WB.T @ R_d[:, 2]))
    turn = so3.log(reduced.T @ R_d)
    target = reduced @ so3.exp(YAW_WEIGHT * turn)
    q_xyzw = so3.quaternion_xyzw_from_rotation(R_WB.T @ target)
    return np.asarray(2.0 * math.copysign(1.0, q_xyzw[3]) * ATTITUDE_P * q_xyzw[:3])
