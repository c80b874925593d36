# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Drag that differs between the body axes, and lift: what it costs to know it, and not to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.simulation.closed_loop import fly, start_on
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS

AIR: dict[str, Any] = {
    "drag": (0.25, 0.1, 0.35),
    "rotor_drag": (0.1, 0.1, 0.2),
    "translational_lift": 0.015,
}
NONE: Mapping[str, Any] = {}
LAGS: dict[str, Any] = {"rate_time_constant": (0.03, 0.035, 0.1), "thrust_time_constant": 0.03}


def flown(
    *,
    known: bool,
    formulation: str = "manifold",
    plant: Mapping[str, Any] = NONE,
    model: Mapping[str, Any] = NONE,
    **reference: Any,
) -> tuple[float, Array]:
    """Return the RMSE [m] of the true position, and the disturbances estimated (n, 3) [m/s^2].

    ``plant`` and ``model`` are what else the two have.
    """
    air = AIR if known else {}
    lags = LAGS if formulation == "manifold" else {}
    wanted = ReferenceConfig(trajectory="lemniscate", yaw=0.6, **reference, **air)
    trajectory = configured_trajectory(wanted)
    simulator = ideal(lockstep=True, duration=8.0, **lags, **AIR, **plant)
    steps = list(
        fly(
            mpc=agile(formulation=formulation, lockstep=True, **lags, **air, **model),
            simulator=simulator.updated(start_on(trajectory, simulator)),
            reference=wanted,
            trajectory=trajectory,
        )
    )
    times = [step.truth.stamp_ns - SIMULATION_START_NS for step in steps]
    off = [step.truth.p_WB for step in steps] - trajectory.at(times).p_WB
    stats = [step.tick.stats for step in steps if step.tick is not None]
    estimated = [[s.disturbance_x, s.disturbance_y, s.disturbance_z] for s in stats]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), np.array(estimated)


@pytest.mark.parametrize(("angular_frequency", "rmse"), [(1.0, 0.0003), (1.8, 0.001)])
def test_configured_anisotropic_drag_is_compensated(angular_frequency: float, rmse: float) -> None:
    error, estimated = flown(known=True, angular_frequency=angular_frequency)
    assert error < rmse
    assert np.abs(estimated).max() < 0.06


def test_unknown_anisotropic_drag_is_estimated_as_disturbance() -> None:
    error, estimated = flown(known=False, angular_frequency=2.0)
    assert error > 0.005
    assert np.abs(estimated).max() > 0.5


@pytest.mark.parametrize(("known", "rmse"), [(True, 0.001), (False, 0.005)])
def test_rate_gain_compensates_incomplete_rate_loop(known: bool, rmse: float) -> None:
    gain = {"rate_gain": (0.85, 0.8, 0.9)}
    error, _ = flown(known=True, angular_frequency=1.8, plant=gain, model=gain if known else {})
    assert (error < rmse) == known


def test_paper_formulation_flies_with_anisotropic_drag() -> None:
    known, _ = flown(known=True, formulation="paper", angular_frequency=1.0)
    unknown, _ = flown(known=False, formulation="paper", angular_frequency=1.0)
    assert known < 0.8 * unknown
