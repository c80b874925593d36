# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference ``gates``: the smooth path through a course, and plans of it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.extras.racing.gate_passages import Lap, passages
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.course import Course

ROUND: dict[str, Any] = {
    "start": [0.0, 0.0, 1.0],
    "gates": [
        {"position": [4.0, 0.0, 1.5], "yaw": 0.3, "width": 1.5, "height": 1.5},
        {"position": [4.0, 4.0, 2.0], "yaw": math.pi, "width": 1.5, "height": 1.5},
        {"position": [0.0, 4.0, 1.5], "tolerance": 0.3},
    ],
    "laps": 2,
}


def flown(course: Course, **changes: Any) -> Lap:
    trajectory = configured_trajectory(ReferenceConfig(trajectory="gates", **changes))
    times = list(range(0, trajectory.period_ns, 5_000_000))
    p_WB = trajectory.at(times).p_WB
    return passages(course, seconds=1e-9 * np.array(times), p_WB=p_WB)


@pytest.mark.parametrize("gates", ["split_s", "seven_gates", str(ROUND)])
def test_smooth_path_passes_every_gate_in_its_middle(gates: str) -> None:
    """At a gate that the path passes twice, the first passage counts and may be off the middle."""
    lap = flown(read_course(gates), gates=gates)
    assert lap.missed == 0
    misses = np.sort([passage.miss or 0.0 for passage in lap.passages])
    assert misses[-1] < 0.2 and misses[-3] < 1e-3


def test_smooth_path_turns_to_pass_in_the_direction_of_a_gate() -> None:
    """The way on leads back, so that a path through the middles would not cross the plane."""
    gates = [
        {"position": [5.0, 0.0, 1.5], "yaw": math.pi / 2.0, "width": 1.0, "height": 1.0},
        {"position": [9.0, 0.0, 1.5], "yaw": -math.pi / 2.0, "width": 1.0, "height": 1.0},
    ]
    text = str({"start": [0.0, 0.0, 1.0], "gates": gates, "end": [14.0, 0.0, 1.0]})
    assert flown(read_course(text), gates=text).missed == 0


def test_course_is_needed() -> None:
    with pytest.raises(ConfigurationError, match="given '', expected a gate file"):
        configured_trajectory(ReferenceConfig(trajectory="gates"))


def test_plan_of_another_course_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "plan.csv"
    rows = [f"{0.2 * k}, {0.1 * k}, 0, 1" for k in range(60)]
    file.write_text("\n".join(("time [s], x [m], y [m], z [m]", *rows)))
    config = ReferenceConfig(trajectory="gates", gates=str(ROUND), file=str(file))
    with pytest.raises(ConfigurationError, match=r"it misses gates\[1\]: plan again"):
        configured_trajectory(config)


def test_origin_moves_neither_the_course_nor_a_plan_through_it(tmp_path: Path) -> None:
    file, config = tmp_path / "plan.csv", ReferenceConfig(trajectory="gates", gates=str(ROUND))
    path = configured_trajectory(config)
    times = list(range(0, path.period_ns, 20_000_000))
    samples = path.at(times)
    rows = [f"{1e-9 * t}, {x}, {y}, {z}" for t, (x, y, z) in zip(times, samples.p_WB, strict=True)]
    file.write_text("\n".join(("time [s], x [m], y [m], z [m]", *rows)))
    plan = configured_trajectory(dataclasses.replace(config, file=str(file), origin=(3.0, -2.0)))
    assert np.abs(plan.at([0]).p_WB - samples.p_WB[0]).max() < 0.01
