# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""In the air the plant agrees with the plant ``rotors`` for the same commands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fixtures.rotors import VEHICLES, command, configured

from quad_mpc_ros.extras.plants.mujoco.plant import MujocoPlant
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant

pytest.importorskip("mujoco")

PERIOD_NS = 20_000_000
HIGH: dict[str, Any] = {"initial_position": (0.0, 0.0, 300.0)}
WINDY: dict[str, Any] = {
    "wind": (4.0, -3.0, 1.0),
    "gust_intensity": 1.0,
    "airframe__center_of_mass": (0.003, -0.002, 0.004),
    "push__force": (0.1, 0.2, 0.0),
    "push__begin": 1.0005,
    "push__duration": 1.0,
}


def largest_distance(config: SimulatorConfig) -> tuple[float, float]:
    """Return the largest distance between both plants [m], and the largest speed [m/s].

    Both roll, pitch and yaw with up to 2.5 rad/s.
    """
    bodies = MujocoPlant(config.updated({"plant": "mujoco"})), RotorsPlant(config)
    hover = config.vehicle().hover_throttle
    furthest, fastest = 0.0, 0.0
    for tick in range(250):
        t = tick * 0.02
        rates = (2.0 * np.sin(3.0 * t), 2.5 * np.cos(2.0 * t), 0.8 * np.sin(t))
        for body in bodies:
            body.apply(command(hover * (1.0 + 0.2 * np.sin(4.0 * t)), rates))
            body.advance_to((tick + 1) * PERIOD_NS)
        seen, truth = (body.odometry(0) for body in bodies)
        furthest = max(furthest, float(np.linalg.norm(seen.p_WB - truth.p_WB)))
        fastest = max(fastest, float(np.linalg.norm(truth.v_WB_B)))
        assert np.abs(seen.w_WB_B - truth.w_WB_B).max() < 1e-3
    return furthest, fastest


@pytest.mark.parametrize("name", VEHICLES)
def test_agrees_with_the_plant_rotors_in_wind_and_gusts(name: str) -> None:
    """Measured: at most 0.2 mm after 5 s at up to 36 m/s."""
    furthest, fastest = largest_distance(configured(name, **HIGH, **WINDY))
    assert fastest > 8.0
    assert furthest < 5e-4


def test_ground_effect_agrees_with_the_plant_rotors() -> None:
    """In a climb from 3 cm, where it is strongest."""
    config = configured(initial_position=(0.0, 0.0, 0.03))
    assert config.airframe.ground_effect == 1.0
    bodies = MujocoPlant(config.updated({"plant": "mujoco"})), RotorsPlant(config)
    without = RotorsPlant(config.updated({"airframe.ground_effect": 0.0}))
    for body in (*bodies, without):
        body.apply(command(1.02 * config.vehicle().hover_throttle))
        body.advance_to(500_000_000)
    heights = [body.state.p_WB[2] for body in (*bodies, without)]
    assert heights[0] == pytest.approx(heights[1], abs=1e-6)
    assert heights[1] - heights[2] > 0.01
