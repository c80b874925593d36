# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle whose hover throttle is not the modelled one, from its first tick on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly

MODELLED = Vehicle()
HEIGHT = 2.0  # m
LAGS = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03}

IN_THE_AIR: dict[str, Any] = {
    "initial_position": (0.0, 0.0, HEIGHT),
    "initial_throttle": MODELLED.hover_throttle,
}


@pytest.mark.parametrize(
    ("lags", "wrong_by", "start"),
    [(True, 1.3, {}), (True, 0.7, IN_THE_AIR), (False, 1.3, IN_THE_AIR), (False, 0.7, {})],
)
def test_holds_the_height_with_a_hover_throttle_wrong_by_30_percent(
    lags: bool, wrong_by: float, start: dict[str, Any]
) -> None:
    hover = MODELLED.hover_throttle
    scale = MODELLED.thrust(hover) / MODELLED.thrust(wrong_by * hover)
    plant = ideal(
        duration=8.0,
        thrust_scale=scale,
        **(LAGS | {"command_delay": 0.02} if lags else {}),
        **start,
    )
    assert plant.vehicle().hover_throttle == pytest.approx(wrong_by * hover)
    mpc = MpcConfig(**(LAGS | {"input_delay": 0.02} if lags else {}))
    steps = list(
        fly(
            mpc=mpc,
            simulator=plant,
            reference=ReferenceConfig(trajectory="hover", height=HEIGHT),
        )
    )
    last = steps[-1].tick
    assert last is not None
    above = np.array([step.truth.p_WB[2] for step in steps]) - HEIGHT
    seconds = np.arange(len(above)) / 50.0
    assert last.stats.fallbacks == 0
    assert np.abs(above[seconds >= 5.0]).max() <= 0.02
    assert above.max() <= 0.20
    # The thrust scale of the model is estimated, not only a disturbance.
    assert (last.stats.thrust_scale - 1.0) * (scale - 1.0) > 0.0
