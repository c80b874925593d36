# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The Hummingbird of the plant ``rotors`` compared with rotorpy."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.rotors import command, plant
from numpy.testing import assert_allclose

from quad_mpc_ros.recordings.evaluation.simulated import load_config
from quad_mpc_ros.simulation.config import make_plant

PERIOD_NS = 20_000_000


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (4.0, -3.0, 1.0)])
def test_manoeuvre_agrees_with_rotorpy(
    wind: tuple[float, float, float],
) -> None:
    """Rolls, pitches and turns at once, up to 10 m/s; the largest distance is below 1 cm."""
    pytest.importorskip("rotorpy.vehicles.multirotor")
    config = load_config("rotorpy").simulator
    hover = config.vehicle().hover_throttle
    start = {"initial_position": (0.0, 0.0, 50.0), "initial_throttle": hover, "wind": wind}
    theirs = make_plant(config.updated(start))
    mine = plant("hummingbird", wind=wind)
    furthest, fastest = 0.0, 0.0
    for tick in range(250):
        t = tick * 0.02
        rates = (2.0 * np.sin(3.0 * t), 2.5 * np.cos(2.0 * t), 0.8 * np.sin(t))
        for body in (mine, theirs):
            body.apply(command(hover * (1.0 + 0.2 * np.sin(4.0 * t)), rates))
            body.advance_to((tick + 1) * PERIOD_NS)
        seen, truth = mine.odometry(0), theirs.odometry(0)
        furthest = max(furthest, float(np.linalg.norm(seen.p_WB - truth.p_WB)))
        fastest = max(fastest, float(np.linalg.norm(truth.v_WB_B)))
        assert_allclose(seen.w_WB_B, truth.w_WB_B, atol=0.01)
    assert fastest > 5.0
    assert furthest < 0.01
