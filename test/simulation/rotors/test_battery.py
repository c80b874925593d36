# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The battery reduces the thrust."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fixtures.rotors import SECOND, Equations, command, configured, plant
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.simulation.rotors.equations import battery
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant
from quad_mpc_ros.simulation.sensors import OdometryStream

CELLS: dict[str, Any] = {"battery__capacity": 1.3}
FULL, EMPTY, RESISTANCE, EFFICIENCY, CAPACITY = 16.8, 13.2, 0.02, 0.7, 1.3 * 3600.0


def under_load(power: float, used: float) -> tuple[float, float]:
    """Return voltage [V] and current [A]."""
    craft = Equations.of(configured(**CELLS)).craft[()]
    share, current = battery(power, used=used, craft=craft)
    return share * FULL, current


@settings(deadline=None)
@given(st.floats(0.0, 1500.0), st.floats(0.0, 1.2))
def test_power_balance_of_the_battery(power: float, used_share: float) -> None:
    voltage, current = under_load(power, used_share * CAPACITY)
    idle = EMPTY + max(1.0 - used_share, 0.0) * (FULL - EMPTY)
    assert voltage * current * EFFICIENCY == pytest.approx(power, rel=1e-9, abs=1e-9)
    assert voltage == pytest.approx(idle - RESISTANCE * current, rel=1e-9)
    assert voltage >= 0.5 * idle


def greatest_climb(**changes: Any) -> float:
    """Return the acceleration at full throttle after 0.2 s [m/s^2]."""
    body = plant(initial_throttle=1.0, **changes)
    body.advance_to(SECOND // 5)
    before = body.state.v_WB_W[2]
    body.advance_to(SECOND // 5 + 1_000_000)
    return float((body.state.v_WB_W[2] - before) / 1e-3)


@pytest.mark.parametrize("compensated", [True, False])
def test_the_maximum_thrust_falls_with_the_charge(compensated: bool) -> None:
    ideal = greatest_climb()
    climbs = [
        greatest_climb(**CELLS, battery__charge=charge, battery__compensated=compensated)
        for charge in (1.0, 0.6, 0.2)
    ]
    assert (np.diff([ideal, *climbs]) < 0.0).all()
    # Thrust goes with the square of the voltage.
    thrust = (climbs[-1] + 9.81) / (ideal + 9.81)
    assert thrust < ((EMPTY + 0.2 * (FULL - EMPTY)) / FULL) ** 2


def test_sinks_without_voltage_compensation() -> None:
    for compensated, sinks in ((True, False), (False, True)):
        body = plant(**CELLS, battery__charge=0.3, battery__compensated=compensated)
        body.apply(command(configured().vehicle().hover_throttle))
        body.advance_to(SECOND)
        assert (body.state.v_WB_W[2] < -1.0) == sinks


def test_hover_uses_charge_at_the_power_of_hover() -> None:
    body = plant(**CELLS, battery__compensated=True)
    begun = body.charge_used
    body.advance_to(10 * SECOND)
    speed = body.rotor_speeds[0]
    power = 4 * 1.83e-9 * speed**3 / EFFICIENCY
    assert body.charge_used - begun == pytest.approx(10.0 * power / FULL, rel=5e-3)


def test_voltage_is_measured_five_times_a_second() -> None:
    config = configured(**CELLS, duration=2.0, odom_delay=0.05)
    stream = OdometryStream(RotorsPlant(config), config, start_stamp_ns=0)
    measured = []
    while (sent := stream.step()) is not None:
        if sent.voltage is not None:
            measured.append((sent.odometry.stamp_ns, sent.voltage))
    assert [stamp_ns for stamp_ns, _ in measured] == [k * SECOND // 5 for k in range(10)]
    assert (np.diff([voltage for _, voltage in measured]) < 0.0).all()
