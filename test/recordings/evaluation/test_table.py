# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The table for the terminal."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.evaluation.table import summary_table
from quad_mpc_ros.recordings.flight import Flight

FlightMaker = Callable[..., Flight]


def test_figures_and_units(make_flight: FlightMaker) -> None:
    summary: dict[str, Any] = summarise(make_flight(501), wall_seconds=2.0)
    summary |= {
        "position_rmse_m": 0.78806,
        "waypoint_error_m": [0.0135, 0.0242],
        "rate_saturation_fraction": 0.076,
        "fallbacks": 3,
        "iterations": {"p50": 25, "p99": 50, "max": 75},
    }
    rows = {row[:20].strip(): row[20:].strip() for row in summary_table(summary).splitlines()}
    assert rows["flight"] == "10.00 s, 5.0 x real time"
    assert rows["commands"] == "501 for 501 odometries, 0 unanswered"
    assert rows["position error"] == "RMSE 0.788 m, max 0.000 m"
    assert rows["error at waypoints"].startswith("0.01")
    assert rows["error at waypoints"].endswith(" 0.024 m")
    assert rows["rates at bound"] == "7.6% of the commands"
    assert rows["safety"] == "3 fallbacks, 0 solver failures, 0 deadline misses"
    assert rows["solver iterations"].split() == ["25", "-", "50", "75"]
    assert rows["control step"].split() == ["us", "400", "400", "400", "400"]
    assert rows["odometry to command"].split() == ["ms", "1.000", "1.000", "1.000", "1.000"]


def test_table_without_data(make_flight: FlightMaker, build: SimpleNamespace) -> None:
    none = np.zeros(0, dtype=np.int64)
    flight = make_flight(1, reference=None, commands=build.commands(none), stats=build.stats([]))
    text = summary_table(summarise(flight, wall_seconds=None))
    assert "None" not in text
    rows = {row[:20].strip(): row[20:].strip() for row in text.splitlines()}
    assert rows["position error"] == rows["attitude error"] == rows["error at waypoints"] == "-"
    assert rows["rates at bound"] == "-"
    assert rows["solver iterations"].split() == ["-"] * 4
