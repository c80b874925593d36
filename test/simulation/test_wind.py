# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Effects of wind and gusts on the vehicle, and statistics of the gusts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation.internal_plant import InternalPlant
from quad_mpc_ros.simulation.plant import Wind

SECOND = 1_000_000_000
GUST_PERIOD_NS = 10_000_000
HOVER = Vehicle().hover_throttle


def command(throttle: float, rates: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> CommandSample:
    return CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(rates))


def hovering(**changes: Any) -> InternalPlant:
    start = {"initial_position": (0.0, 0.0, 50.0), "initial_throttle": HOVER}
    return InternalPlant(ideal({**start, **changes}))


def gusts(*, seconds: float, airspeed: float, **changes: Any) -> Array:
    """Return the gusts met by a vehicle that flies at an airspeed, one row each 10 ms."""
    wind = Wind(ideal({"gust_intensity": 1.0, **changes}))
    steady = np.array(changes.get("wind", (0.0, 0.0, 0.0)))
    v_WB_W = steady + np.array([airspeed, 0.0, 0.0])
    rows = []
    for k in range(round(seconds * 1e9) // GUST_PERIOD_NS):
        wind.advance_to(k * GUST_PERIOD_NS, v_WB_W=v_WB_W)
        rows.append(wind.velocity_W - steady)
    return np.array(rows)


@pytest.mark.parametrize("dynamics", ["rigid_body", "paper"])
def test_wind_accelerates_a_level_vehicle_through_drag(dynamics: str) -> None:
    wind, drag = np.array([5.0, -2.0, 0.5]), 0.2
    body = hovering(wind=tuple(wind), dynamics=dynamics, drag=drag)
    for seconds in (1, 5, 60):
        body.advance_to(seconds * SECOND)
        assert_allclose(
            body.state.v_WB_W, wind * (1.0 - math.exp(-drag * seconds)), rtol=1e-8, atol=1e-9
        )
    body.advance_to(200 * SECOND)
    assert_allclose(body.state.v_WB_W, wind, rtol=1e-9)


def test_flight_in_steady_wind_is_galilean_invariant() -> None:
    """Galileo: seen from the air, the same tumbling flight."""
    wind = np.array([3.0, -4.0, 1.0])
    calm = hovering(initial_velocity=(1.0, 2.0, 3.0))
    windy = hovering(initial_velocity=tuple(np.array([1.0, 2.0, 3.0]) + wind), wind=tuple(wind))
    for body in (calm, windy):
        body.apply(command(0.6, (4.0, -3.0, 2.0)))
        body.advance_to(SECOND)
    assert_allclose(windy.state.p_WB - wind, calm.state.p_WB, atol=1e-6)
    assert_allclose(windy.state.v_WB_W - wind, calm.state.v_WB_W, atol=1e-6)


@pytest.mark.parametrize("sigma", [0.5, 3.0])
def test_gusts_have_the_intensity_as_standard_deviation(sigma: float) -> None:
    """6,000 s of a correlation time of 2 s are 1,500 independent values per axis: 2 %."""
    values = gusts(seconds=6000.0, airspeed=10.0, gust_length=20.0, gust_intensity=sigma)
    assert_allclose(values.std(axis=0), sigma, rtol=0.06)
    assert_allclose(values.mean(axis=0), 0.0, atol=0.15 * sigma)
    correlation = np.corrcoef(values.T) - np.eye(3)
    assert np.abs(correlation).max() < 0.12


@pytest.mark.parametrize(
    ("airspeed", "length", "wind"),
    [(10.0, 20.0, (0.0, 0.0, 0.0)), (2.0, 5.0, (4.0, 1.0, 0.0)), (0.0, 2.0, (0.0, 0.0, 0.0))],
)
def test_gusts_are_correlated_over_the_scale_length(
    airspeed: float, length: float, wind: tuple[float, float, float]
) -> None:
    """The longitudinal Dryden spectrum is that of the correlation exp(-V t / L)."""
    values = gusts(seconds=4000.0, airspeed=airspeed, gust_length=length, wind=wind)
    time_constant = length / max(airspeed, 1.0)
    for share in (0.25, 0.5, 1.0):
        lag = round(share * time_constant / 0.01)
        correlation = np.mean(values[lag:] * values[:-lag]) / np.mean(values**2)
        assert correlation == pytest.approx(math.exp(-lag * 0.01 / time_constant), abs=0.06)


def test_gusts_do_not_depend_on_how_time_is_divided() -> None:
    whole, divided = (hovering(gust_intensity=2.0, wind=(3.0, 0.0, 0.0)) for _ in range(2))
    whole.advance_to(SECOND)
    for k in range(1, 334):
        divided.advance_to(3_000_000 * k + 17)
    divided.advance_to(SECOND)
    assert_allclose(whole.state.p_WB, divided.state.p_WB, atol=1e-9)
    assert_allclose(whole.wind_W, divided.wind_W, atol=1e-12)
    assert np.linalg.norm(whole.state.v_WB_W) > 0.1
