# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A reference that is too fast: the vehicle cuts corners without contouring, is late with it."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.evaluation.simulated import simulate
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory

REFERENCE = ReferenceConfig(trajectory="lemniscate", angular_frequency=2.2, height=3.0)
# Of the thrust that the eight asks for.
WEAK = 0.7


@cache
def flown(formulation: str, *, weak: bool = True) -> Flight:
    trajectory = configured_trajectory(REFERENCE)
    samples = trajectory.at([*range(0, trajectory.period_ns, 5_000_000)])
    force = np.linalg.norm(samples.a_WB_W + np.array([0.0, 0.0, 9.81]), axis=1).max()
    mpc = agile(formulation=formulation)
    throttle = mpc.vehicle().throttle_for(WEAK * mpc.mass * float(force))
    mpc = dataclasses.replace(mpc, throttle_max=throttle if weak else 1.0)
    return simulate(mpc, ideal(duration=12.0), REFERENCE, on_reference=True)


def distances(flight: Flight) -> Array:
    """Return how far the vehicle was from the way (n,) [m], whenever the reference was there."""
    trajectory = configured_trajectory(REFERENCE)
    way = trajectory.at([*range(0, trajectory.period_ns, 2_000_000)]).p_WB
    return np.array([np.linalg.norm(way - p, axis=1).min() for p in flight.p_WB])


def test_a_weak_vehicle_stays_on_the_path_with_a_delay() -> None:
    by_clock, late = flown("manifold"), flown("contouring")
    assert distances(by_clock).max() > 0.4
    assert distances(late).max() < 0.05
    behind = late.stats["progress_delay_s"]
    assert behind[-1] > 0.5
    assert (np.diff(behind) > -0.002).all()


def test_errors_are_relative_to_the_delayed_reference() -> None:
    flight = flown("contouring")
    summary = summarise(flight)
    assert summary["progress_delay_max_s"] == pytest.approx(flight.stats["progress_delay_s"].max())
    assert summary["position_rmse_m"] < 0.15
    assert flight.reference is not None
    by_clock = np.linalg.norm(flight.reference.p_WB - flight.p_WB, axis=1)
    assert by_clock.max() > 1.0
    assert not summary["crashed"]
    assert summarise(flown("manifold"))["progress_delay_max_s"] is None


def test_capable_vehicle_has_little_delay() -> None:
    able = flown("contouring", weak=False)
    assert distances(able).max() < 0.02
    assert able.stats["progress_delay_s"].max() < 0.1
