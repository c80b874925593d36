# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The thrust that the MPC means must be the thrust that the stack's throttle makes."""

from __future__ import annotations

from typing import Any

import pytest

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.ros.bridges.config import BridgeConfig, ThrustParameters
from quad_mpc_ros.ros.bridges.thrust import ThrustMap

SECOND = 1_000_000_000
WEIGHT = 0.396893 * 9.81
THROTTLES = [0.0, 0.1, 0.2923008, 0.5, 0.8]


def made(**parameters: Any) -> ThrustMap:
    return ThrustMap(BridgeConfig(thrust_map=ThrustParameters(**parameters)))


def test_thrust_at_hover_equals_the_weight() -> None:
    thrust = made()
    assert thrust.thrust_newton(0.2923008) == pytest.approx(WEIGHT, rel=1e-6)
    assert thrust.specific_thrust(0.2923008) == pytest.approx(9.81, rel=1e-6)


@pytest.mark.parametrize("throttle", THROTTLES)
def test_model_map_keeps_the_throttle(throttle: float) -> None:
    assert made().stack_throttle(throttle) == throttle


@pytest.mark.parametrize("throttle", THROTTLES)
@pytest.mark.parametrize("kind", ["linear", "quadratic", "table"])
def test_every_map_produces_the_commanded_thrust(kind: str, throttle: float) -> None:
    throttles, thrusts = (0.0, 0.25, 0.5, 1.0), (0.0, 2.0, 6.0, 30.0)
    thrust = made(
        kind=kind,
        full_thrust=30.0,
        motor_curve=(5.0, 1.0, 0.0),
        table_throttle=throttles,
        table_thrust=thrusts,
    )
    u = thrust.stack_throttle(throttle)

    def piecewise(u: float) -> float:
        i = next(i for i in range(3) if throttles[i] <= u <= throttles[i + 1])
        along = (u - throttles[i]) / (throttles[i + 1] - throttles[i])
        return thrusts[i] + along * (thrusts[i + 1] - thrusts[i])

    makes = {"linear": 30.0 * u, "quadratic": 4.0 * (5.0 * u * u + u), "table": piecewise(u)}
    meant = thrust.thrust_newton(throttle)
    assert makes[kind] == pytest.approx(meant, abs=1e-9 if meant > 0.0 else 0.03)


def test_unreachable_thrust_is_full_throttle() -> None:
    assert made(kind="linear", full_thrust=5.0).stack_throttle(1.0) == 1.0
    assert made(kind="quadratic", motor_curve=(1.0, 0.5, 0.0)).stack_throttle(1.0) == 1.0


def test_a_lower_voltage_requires_more_throttle() -> None:
    thrust = made(kind="linear", full_thrust=20.0, battery_voltage=16.0)
    full = thrust.stack_throttle(0.2923008)
    thrust.receive_voltage(16.0, now_ns=0)
    assert thrust.stack_throttle(0.2923008) == pytest.approx(full)
    thrust.receive_voltage(14.0, now_ns=60 * SECOND)  # long enough for the filter
    u = thrust.stack_throttle(0.2923008)
    assert 20.0 * u * (14.0 / 16.0) ** 2 == pytest.approx(WEIGHT, rel=1e-6)


def test_follows_sag_slowly_and_ignores_invalid_voltage() -> None:
    thrust = made(battery_voltage=16.0)
    thrust.receive_voltage(16.0, now_ns=0)
    thrust.receive_voltage(12.0, now_ns=SECOND // 50)
    assert 0.98 < thrust.battery_scale < 1.0
    for nonsense in (0.0, -1.0, float("nan"), float("inf"), 65.535, 15_600.0, 1.0):
        before = thrust.battery_scale
        thrust.receive_voltage(nonsense, now_ns=SECOND)
        assert thrust.battery_scale == before
    thrust.receive_voltage(10.0, now_ns=1000 * SECOND)
    assert thrust.battery_scale == 0.5


@pytest.mark.parametrize("nominal", [3.7, 14.8, 48.0])  # 65.535 V is 1.37 times the last
def test_unknown_voltage_is_ignored_silently_and_an_implausible_one_is_reported_once(
    nominal: float,
) -> None:
    thrust = made(battery_voltage=nominal)
    assert thrust.receive_voltage(65.535, now_ns=0) == ""
    assert thrust.receive_voltage(float("nan"), now_ns=0) == ""
    said = thrust.receive_voltage(1000.0 * nominal, now_ns=0)
    assert f"given {1000.0 * nominal:g} V" in said and f"battery_voltage {nominal:g} V" in said
    assert thrust.receive_voltage(1000.0 * nominal, now_ns=SECOND) == ""
    assert thrust.battery_scale == 1.0
    assert thrust.receive_voltage(0.9 * nominal, now_ns=SECOND) == ""
    assert thrust.battery_scale == pytest.approx(0.81)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("motor_curve", {"motor_curve": (-1.0, 2.0, 0.0)}),
        ("table_throttle", {"table_throttle": (0.0,), "table_thrust": (0.0,)}),
        ("table_throttle", {"table_throttle": (0.5, 0.5)}),
        ("table_thrust", {"table_thrust": (5.0, 4.0)}),
        ("table_thrust", {"table_thrust": (1.0, 2.0, 3.0)}),
    ],
)
def test_a_map_without_an_inverse_is_refused(name: str, parameters: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=rf"^bridge\.thrust_map\.{name}"):
        ThrustParameters(**parameters)
