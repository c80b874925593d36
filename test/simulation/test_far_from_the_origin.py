# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Flights in UTM coordinates are those at the origin, moved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from quad_mpc_ros import Flight, load_config, simulate, summarise

EAST, NORTH = 500_000.0, 5_400_000.0
PILLARS = Path(__file__).parents[2] / "examples" / "pillars.yaml"
AROUND = ["mpc.obstacles.half_spaces=8", "reference.trajectory=minimum_snap"]
AROUND += ["reference.waypoints=[0.0,0.0,1.5,9.0,0.0,1.5]", "reference.max_speed=2.5"]
LEMNISCATE = ["reference.trajectory=lemniscate", "simulator.wind=[2.0,1.0,0.0]"]
OPEN = {
    "manifold": LEMNISCATE,
    "contouring": [*LEMNISCATE, "mpc.formulation=contouring"],
}
OBSTACLES = {
    "known": (AROUND, ["simulator.obstacles", "mpc.obstacles"]),
    "scanned": ([*AROUND, "simulator.obstacles.sensor=rays"], ["simulator.obstacles"]),
}


def flown(given: list[str], x: float, y: float) -> Flight:
    places = [f"reference.origin=[{x},{y}]", f"simulator.initial_position=[{x},{y},1.5]"]
    flight = simulate(*load_config(assignments=[*given, *places]), duration=5.0)
    assert set(flight.stats["source"]) == {"mpc"}
    return flight


def moved(scene: dict[str, Any]) -> dict[str, Any]:
    """Return a file of obstacles with all places moved from the origin to UTM coordinates."""
    places = [each["position"] for each in scene["obstacles"]] + [*scene["volume"].values()]
    for place in places:
        place[0], place[1] = place[0] + EAST, place[1] + NORTH
    return scene


@pytest.mark.parametrize("name", OPEN)
def test_a_flight_in_utm_coordinates_is_that_at_the_origin(name: str) -> None:
    here, there = flown(OPEN[name], 0.0, 0.0), flown(OPEN[name], EAST, NORTH)
    expected, found = summarise(here), summarise(there)
    assert found["position_rmse_m"] == pytest.approx(expected["position_rmse_m"], abs=1e-3)
    assert np.abs(there.p_WB - here.p_WB - [EAST, NORTH, 0.0]).max() < 1e-3


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_path_around_obstacles_in_utm_coordinates_is_one_at_the_origin(
    name: str, tmp_path: Path
) -> None:
    """Points lie in other cells of the grids of the search, as from a start beside this one."""
    given, files = OBSTACLES[name]
    far = tmp_path / "far.yaml"
    far.write_text(yaml.safe_dump(moved(yaml.safe_load(PILLARS.read_text()))))
    there = summarise(flown([*given, *(f"{each}.file={far}" for each in files)], EAST, NORTH))
    scene = [f"{each}.file={PILLARS}" for each in files]
    near = [summarise(flown([*given, *scene], 0.0, y)) for y in (0.0, 0.02, 0.05)]
    for value, margin in {"clearance_min_m": 0.05, "position_rmse_m": 0.08}.items():
        found = [each[value] for each in near]
        assert min(found) - margin < there[value] < max(found) + margin
