# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The thrust map of a vehicle file: its bridge makes the thrust that its curve states."""

from __future__ import annotations

from typing import Any

import pytest

from quad_mpc_ros.analysis.identification import vehicle_file
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.thrust import ThrustMap

MAPS: dict[str, dict[str, Any]] = {
    "linear": {"full_thrust": 25.0},
    "quadratic": {"motor_curve": [4.0, 2.0, 0.0]},
    "table": {"table_throttle": [0.0, 0.5, 1.0], "table_thrust": [0.0, 10.0, 26.0]},
}
WEAKER = 0.8  # true thrust over that of the map


def bridge(recorded: dict[str, Any], curve: tuple[float, ...]) -> ThrustMap:
    return ThrustMap(BridgeConfig.build({**recorded, "thrust_curve": curve}))


def true_thrust(kind: str, stack_throttle: float) -> float:
    u = stack_throttle
    thrusts = {
        "linear": 25.0 * u,
        "quadratic": 4.0 * (4.0 * u * u + 2.0 * u),
        "table": 20.0 * u if u < 0.5 else 10.0 + 32.0 * (u - 0.5),
    }
    return WEAKER * thrusts[kind]


@pytest.mark.parametrize("kind", MAPS)
@pytest.mark.parametrize("throttle", [0.2, 0.4, 0.6])
def test_identified_thrust_curve_matches_the_vehicles_thrust(kind: str, throttle: float) -> None:
    given = MpcConfig()
    recorded = {
        "thrust_map.kind": kind,
        **{f"thrust_map.{name}": value for name, value in MAPS[kind].items()},
    }
    before = bridge(recorded, given.thrust_curve).stack_throttle(throttle)
    assert true_thrust(kind, before) == pytest.approx(WEAKER * given.thrust(throttle), rel=1e-6)

    entries = vehicle_file.map_entries(recorded, WEAKER)
    found = {name: value for name, (value, _) in entries.items()}
    curve = tuple(WEAKER * c for c in given.thrust_curve)
    after = bridge(found, curve).stack_throttle(throttle)
    assert true_thrust(kind, after) == pytest.approx(WEAKER * given.thrust(throttle), rel=1e-3)
