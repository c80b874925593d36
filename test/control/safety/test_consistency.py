# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle that climbs for long without commanded thrust is reported, also if it oscillates."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, State, odometry_from_state
from quad_mpc_ros.control.safety.consistency import ConsistencyMonitor

PERIOD_NS = 20_000_000
OSCILLATION = 20.0  # rad/s


def climbing(time: float, *, speed: float, acceleration: float) -> OdometrySample:
    """Return the odometry of a climb whose roll oscillates by 0.1 rad and 2 rad/s."""
    roll = 0.1 * np.sin(OSCILLATION * time)
    R_WB = so3.exp(np.array([roll, 0.0, 0.0]))
    v_WB_W = np.array([0.0, 0.0, speed + acceleration * time])
    height = 10.0 + speed * time + 0.5 * acceleration * time**2
    state = State(p_WB=np.array([0.0, 0.0, height]), v_WB_B=R_WB.T @ v_WB_W, R_WB=R_WB)
    return odometry_from_state(
        state,
        w_WB_B=np.array([0.1 * OSCILLATION * np.cos(OSCILLATION * time), 0.0, 0.0]),
        stamp_ns=round(1e9 * time),
        frame_id="odom",
        child_frame_id="base_link",
    )


def reported_after(duration: float, *, speed: float, acceleration: float) -> float | None:
    """Return when a climb at throttle 0 is reported [s], None if it is not."""
    config = MpcConfig()
    monitor = ConsistencyMonitor(config, GroundDetector(config.gravity))
    idle = Input(throttle=0.0, w_WB_B=np.zeros(3))
    for k in range(1, round(1e9 * duration / PERIOD_NS)):
        time = 1e-9 * k * PERIOD_NS
        odometry = climbing(time, speed=speed, acceleration=acceleration)
        breach = monitor.check(odometry, odometry, idle)
        if breach is not None:
            assert "climbs without commanded thrust" in breach.reason
            return time
    return None


def test_a_long_climb_without_thrust_is_reported_while_the_vehicle_oscillates() -> None:
    found = reported_after(5.0, speed=5.0, acceleration=0.0)
    assert found is not None and 2.0 < found < 3.5  # the rotors slow down first


def test_a_ballistic_climb_is_not_reported() -> None:
    assert reported_after(2.9, speed=30.0, acceleration=-9.81) is None
