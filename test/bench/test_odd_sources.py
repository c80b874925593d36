# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles and odometries beyond the campaigns fly without a false alarm."""

from __future__ import annotations

import odd_sources
import pytest


@pytest.mark.parametrize(
    ("source", "flight"),
    [
        ("lemniscate, velocity noise 0.3 m/s", 10),
        ("lemniscate, velocity noise 0.3 m/s", 12),
        ("hover, position noise 0.1 m", 0),
        ("hover, attitude noise 0.03 rad", 4),
    ],
)
def test_noise_does_not_contradict_the_commands(source: str, flight: int) -> None:
    """A bound on single samples turned the noise of 0.3 m/s into a force of 3 m/s^2."""
    assert not odd_sources.flown(source, flight).crashed
