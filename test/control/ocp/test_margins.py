# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The stability margins: flights and a simulated axis oscillate beyond them, and not below."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from quad_mpc_ros import load_config, simulate
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.ocp.margins import stability_margins

PRESETS = "default", "agile"


def swing(preset: str, along: int, *changes: str) -> float:
    """Fly a hover off by 5 cm along an axis; return how far it still swings after 15 s [m]."""
    offset = np.eye(3)[along] * 0.05 + np.array([0.0, 0.0, 1.0])
    lags = [
        f"simulator.{name}={getattr(MpcConfig(), name)}"
        for name in ("rate_time_constant", "torque_time_constant", "thrust_time_constant")
    ]
    config = load_config(
        preset,
        assignments=[
            *lags,
            "mpc.estimate_disturbance=false",
            "mpc.consistency.action=warn",
            "mpc.advanced.oscillation.action=warn",
            "reference.trajectory=hover",
            f"simulator.initial_position={offset.tolist()}",
            *changes,
        ],
    )
    flight = simulate(*config, duration=18.0)
    return float(np.ptp(flight.p_WB[-150:, along]))


@pytest.mark.parametrize("preset", PRESETS)
def test_hover_oscillates_beyond_the_delay_margin(preset: str) -> None:
    mpc = load_config(preset)[0]
    margin = stability_margins(mpc).delay
    settled, oscillating = (
        swing(preset, 0, f"simulator.command_delay={mpc.input_delay + share * margin}")
        for share in (0.9, 1.1)
    )
    assert settled < 1e-3
    assert oscillating > 0.01


def test_vertical_axis_diverges_beyond_the_gain_margin() -> None:
    """By the time response of the linear axis, with thrust and prediction written out."""
    mpc = MpcConfig(Q=(0.0, 0.0, 10.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    margin = stability_margins(mpc).gain
    assert math.isfinite(margin)
    assert vertical_swing(mpc, 0.9 * margin) < 1e-4
    assert vertical_swing(mpc, 1.1 * margin) > 1.0


def vertical_swing(mpc: MpcConfig, factor: float) -> float:
    """Return the height range at the end of 20 s of a linear axis with a factor on the thrust."""
    a, b, _ = mpc.thrust_curve
    hover = mpc.vehicle().hover_throttle
    slope, tau = mpc.motor_count * (2.0 * a * hover + b) / mpc.mass, mpc.thrust_time_constant
    period, delay = 1.0 / mpc.control_rate, mpc.input_delay

    def motion(gain: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
        joint = np.zeros((4, 4))
        joint[0, 1], joint[1, 2], joint[2, 2:] = 1.0, gain, (-1.0 / tau, 1.0 / tau)
        step = expm(joint * duration)
        return step[:3, :3], step[:3, 3]

    # The optimal first input of the horizon: least squares over all its inputs.
    A, B = motion(slope, mpc.horizon_step)
    steps = mpc.horizon_steps
    free, forced = np.zeros((steps, 3, 3)), np.zeros((steps, 3, steps))
    power, inputs = np.eye(3), np.zeros((3, steps))
    for i in range(steps):
        power, inputs = A @ power, A @ inputs
        inputs[:, i] += B
        weights = np.array([mpc.Q[2], mpc.Q[5], 0.0])
        weights *= mpc.terminal_weight if i == steps - 1 else 1.0
        free[i], forced[i] = np.sqrt(weights)[:, None] * power, np.sqrt(weights)[:, None] * inputs
    F, G = forced.reshape(-1, steps), free.reshape(-1, 3)
    feedback = np.linalg.solve(F.T @ F + mpc.R[0] * np.eye(steps), F.T @ G)[0]

    A, B = motion(factor * slope, period)
    predicted, known = motion(slope, delay)
    _, spool = motion(slope, period)
    assert delay == period  # one command is on its way
    x, throttle, sent = np.array([0.05, 0.0, 0.0]), 0.0, 0.0
    heights = []
    for _ in range(round(20.0 / period)):
        # Height and velocity are measured, the throttle follows from the commands.
        ahead = predicted @ np.array([x[0], x[1], throttle]) + known * sent
        acting, sent = sent, -float(feedback @ ahead)
        x = A @ x + B * acting
        throttle += spool[2] * (acting - throttle)
        heights.append(x[0])
    return float(np.ptp(heights[-100:]))
