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
FLIGHTS: dict[str, tuple[list[str], list[str]]] = {
    "manifold": (LEMNISCATE, []),
    "contouring": ([*LEMNISCATE, "mpc.formulation=contouring"], []),
    "paper": (["reference.trajectory=circle", "mpc.formulation=paper"], []),
    "around known obstacles": (AROUND, ["simulator.obstacles", "mpc.obstacles"]),
    "around scanned obstacles": (
        [*AROUND, "simulator.obstacles.sensor=rays"],
        ["simulator.obstacles"],
    ),
}


def moved(scene: dict[str, Any]) -> dict[str, Any]:
    """Return a file of obstacles with all places moved from the origin to UTM coordinates."""
    places = [each["position"] for each in scene["obstacles"]] + [*scene["volume"].values()]
    for place in places:
        place[0], place[1] = place[0] + EAST, place[1] + NORTH
    return scene


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_flight_in_utm_coordinates_is_that_at_the_origin(name: str, tmp_path: Path) -> None:
    given, files = FLIGHTS[name]
    far = tmp_path / "far.yaml"
    far.write_text(yaml.safe_dump(moved(yaml.safe_load(PILLARS.read_text()))))

    def flown(x: float, y: float, obstacles: Path) -> Flight:
        places = [f"reference.origin=[{x},{y}]", f"simulator.initial_position=[{x},{y},1.5]"]
        scene = [f"{each}.file={obstacles}" for each in files]
        return simulate(*load_config(assignments=[*given, *places, *scene]), duration=5.0)

    here, there = flown(0.0, 0.0, PILLARS), flown(EAST, NORTH, far)
    assert set(there.stats["source"]) == {"mpc"}
    expected, found = summarise(here), summarise(there)
    if files:  # points lie in other cells of the grids in which paths are searched: other paths
        assert found["clearance_min_m"] == pytest.approx(expected["clearance_min_m"], abs=0.03)
        assert found["position_rmse_m"] == pytest.approx(expected["position_rmse_m"], abs=0.08)
    else:
        assert found["position_rmse_m"] == pytest.approx(expected["position_rmse_m"], abs=1e-3)
        assert np.abs(there.p_WB - here.p_WB - [EAST, NORTH, 0.0]).max() < 1e-3
