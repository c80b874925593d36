# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of a vehicle's parameters."""

from __future__ import annotations

import pytest

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.simulation.rotors.parameters import (
    AirframeParameters,
    BatteryParameters,
    RateLoopParameters,
    RotorParameters,
)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RotorParameters(y=(0.1, 0.1)), r"rotors\.y: given .*4 numbers, like x"),
        (lambda: RotorParameters(spin=(1.0, 0.5, 1.0, 1.0)), r"rotors\.spin"),
        (lambda: RotorParameters(speed_min=3000.0), r"rotors\.speed_min: .*below 1966"),
        (
            lambda: AirframeParameters(inertia=(1.0, 1.0, 1.0, 2.0, 0.0, 0.0)),
            r"airframe\.inertia: .*positive definite",
        ),
        (lambda: RateLoopParameters(rate=100.0), r"rate_loop\.d_cutoff: .*half of 100 Hz"),
        (
            lambda: BatteryParameters(voltage_empty=20.0),
            r"battery\.voltage_empty: .*most 16\.8",
        ),
    ],
)
def test_refuses_impossible_vehicles(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(ConfigurationError, match=rf"^simulator\.{message}"):
        make()
