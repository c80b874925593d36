"""Vehicles and odometries beyond the campaigns fly without a false alarm."""

from __future__ import annotations

import odd_sources
import pytest


@pytest.mark.parametrize("flight", [10, 12])
def test_noisy_velocities_do_not_contradict_the_commands(flight: int) -> None:
    """A bound on single samples turned the noise of 0.3 m/s into a force of 3 m/s^2."""
    assert not odd_sources.flown("lemniscate, velocity noise 0.3 m/s", flight).crashed
