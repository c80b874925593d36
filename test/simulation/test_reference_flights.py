# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Smooth and acrobatic references in the loop, with the actuators' lags and delay modelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS

LAG, DELAY = 0.03, 0.02
MPC = agile(
    formulation="manifold",
    terminal_weight=30.0,
    rate_time_constant=LAG,
    thrust_time_constant=LAG,
    input_delay=DELAY,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flown:
    """The distance (n,) [m] to the reference, where that is upside down, and the steps."""

    distance: np.ndarray
    inverted: np.ndarray
    steps: list[LoopStep]

    def saturated(self) -> float:
        """Return the share of the commands with a body rate at its bound."""
        rates = np.array([step.tick.command.w_WB_B for step in self.steps])  # type: ignore[union-attr]
        return float(np.mean(np.any(np.abs(rates) > 0.999 * np.array(MPC.omega_max), axis=1)))

    def failures(self) -> int:
        """Return how often the solver failed or something else commanded."""
        last = self.steps[-1].tick
        assert last is not None
        return last.stats.solver_failures + last.stats.fallbacks


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def flown(**changes: object) -> Flown:
    """Fly a reference to its end and half a second on, from rest at its beginning."""
    config = ReferenceConfig.build(changes)
    trajectory = configured_trajectory(config)
    simulator = ideal(
        duration=1e-9 * trajectory.period_ns + 0.5,
        initial_position=tuple(trajectory.at([0]).p_WB[0].tolist()),
        initial_throttle=config.vehicle().hover_throttle,
        rate_time_constant=LAG,
        thrust_time_constant=LAG,
        command_delay=DELAY,
    )
    steps = list(fly(mpc=MPC, simulator=simulator, reference=config))
    reference = trajectory.at([step.truth.stamp_ns - SIMULATION_START_NS for step in steps])
    p_WB = np.array([step.truth.p_WB for step in steps])
    R_WB = so3.rotation_from_quaternion_xyzw(reference.q_WB_xyzw)
    return Flown(
        distance=np.linalg.norm(p_WB - reference.p_WB, axis=1),
        inverted=R_WB[:, 2, 2] < 0.0,
        steps=steps,
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"trajectory": "vertical_loop", "loop_speed": 7.0},
        {"trajectory": "flip", "flip_axis": "roll"},
    ],
)
def test_tracks_inverted_flight_within_a_centimetre(changes: dict[str, object]) -> None:
    run = flown(**changes)
    assert run.failures() == 0
    assert np.count_nonzero(run.inverted) >= 10
    assert rms(run.distance[run.inverted]) <= 0.01
    assert rms(run.distance) <= 0.01


def test_minimum_snap_through_the_squares_corners_without_saturation() -> None:
    smooth = flown(trajectory="minimum_snap", max_acceleration=2.0)
    assert smooth.failures() == 0
    assert rms(smooth.distance) <= 0.001
    steps = flown(trajectory="square")
    assert steps.saturated() > 0.02
    assert smooth.saturated() <= 0.1 * steps.saturated()
