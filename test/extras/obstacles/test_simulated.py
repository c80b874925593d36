# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated sensors of obstacles, and the detection of collisions."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.obstacles.files import scene_of
from quad_mpc_ros.extras.obstacles.simulated import SimulatedSurroundings, scan
from quad_mpc_ros.messages.obstacle_messages import ADD, DELETE
from quad_mpc_ros.simulation.shapes import Scene
from quad_mpc_ros.simulation.surroundings import ObstacleSensorParameters

SECOND = 1_000_000_000


def scene(*entries: str) -> Scene:
    import yaml

    return scene_of({"obstacles": [yaml.safe_load(f"{{{each}}}") for each in entries]}, "test")


def at(p_WB: Array | list[float], *, tilt: float = 0.0, v: float = 0.0) -> OdometrySample:
    R_WB = so3.exp(np.array([0.2, tilt, 0.9]))
    return OdometrySample(
        stamp_ns=SECOND,
        p_WB=np.array(p_WB, dtype=float),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
        v_WB_B=np.array([v, 0.0, 0.0]),
        w_WB_B=np.zeros(3),
    )


PILLAR = "shape: cylinder, position: [3, 0, 1.5], radius: 0.1, height: 3"
BEHIND = "shape: box, position: [5, 0, 1.5], size: [0.2, 0.15, 3]"
WALL = "shape: box, position: [0, 4, 1.5], size: [8, 0.2, 3], yaw: 0.2"
MOVING = "shape: sphere, position: [3, -3, 1], radius: 0.3, velocity: [0, 2, 0], appears_at: 0.5"


class TestRays:
    def test_points_are_on_surfaces_in_range_and_in_sight(self) -> None:
        s, truth = scene(PILLAR, BEHIND, WALL), at([0, 0, 1.5], tilt=0.3)
        cloud = scan(s, truth, seconds=0.0, reach=6.0)
        assert cloud is not None and cloud.frame_id == "base_link"
        R_WB = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)
        points = cloud.p_SQ @ R_WB.T + truth.p_WB
        assert np.abs(s.clearances(points, np.zeros(len(points)))).max() < 1e-5
        assert np.linalg.norm(cloud.p_SQ, axis=1).max() <= 6.0
        # Between the eye and a point there is nothing.
        for share in np.linspace(0.05, 0.98, 40):
            between = truth.p_WB + share * (points - truth.p_WB)
            assert s.clearances(between, np.zeros(len(between))).min() > 0.0

    def test_detects_a_pillar_of_20_cm_at_full_range(self) -> None:
        for bearing in np.linspace(0.0, 2.0, 60):
            place = [5.9 * math.cos(bearing), 5.9 * math.sin(bearing), 1.5]
            s = scene(f"shape: box, position: {place}, size: [0.2, 0.2, 3]")
            assert scan(s, at([0, 0, 1.5]), seconds=0.0, reach=6.0) is not None

    def test_no_cloud_without_obstacles_in_range(self) -> None:
        assert scan(scene(PILLAR), at([-4, 0, 1.5]), seconds=0.0, reach=6.0) is None

    def test_sensor_runs_at_10_hz(self) -> None:
        config = ObstacleSensorParameters(sensor="rays")
        around = SimulatedSurroundings(config, scene(PILLAR), radius=0.2)
        seen = [around.look(at([0, 0, 1.5]), n * 20_000_000).cloud for n in range(100)]
        assert sum(cloud is not None for cloud in seen) == 20


def test_markers_come_and_go_with_the_range_and_move() -> None:
    config = ObstacleSensorParameters(sensor="markers", sensor_rate=10.0)
    around = SimulatedSurroundings(config, scene(PILLAR, MOVING), radius=0.2)
    first = around.look(at([0, 0, 1.5]), 0).markers
    assert [(m.name[1], m.action) for m in first] == [(0, ADD)]
    later = around.look(at([0, 0, 1.5]), SECOND).markers
    assert [(m.name[1], m.action) for m in later] == [(0, ADD), (1, ADD)]
    assert later[1].p.tolist() == [3.0, -2.0, 1.0]
    away = around.look(at([-50, 0, 1.5]), 2 * SECOND).markers
    assert [(m.name[1], m.action) for m in away] == [(0, DELETE), (1, DELETE)]
    assert around.look(at([-50, 0, 1.5]), 3 * SECOND).markers == ()


class TestCollisions:
    def test_collision_is_detected_at_first_contact(self) -> None:
        around = SimulatedSurroundings(ObstacleSensorParameters(), scene(PILLAR), radius=0.25)
        hits = []
        for number in range(200):
            time_ns = number * 20_000_000
            hit = around.collision(at([2.0 * time_ns * 1e-9, 0, 1.5], v=2.0), time_ns)
            hits += [hit] if hit is not None else []
        first = hits[0]
        assert first.p_WB[0] == pytest.approx(3.0 - 0.1 - 0.25, abs=0.01)
        assert first.time == pytest.approx(first.p_WB[0] / 2.0) and first.speed == 2.0
        assert "with 2.00 m/s" in first.text

    def test_a_fast_vehicle_does_not_pass_through_a_thin_wall(self) -> None:
        thin = scene("shape: box, position: [3, 0, 1.5], size: [0.02, 4, 3]")
        around = SimulatedSurroundings(ObstacleSensorParameters(), thin, radius=0.1)
        places = [
            around.collision(at([x, 0, 1.5]), n * 20_000_000)
            for n, x in enumerate(np.arange(0.1, 6.0, 0.6))
        ]
        assert any(place is not None for place in places)

    def test_no_collision_before_an_obstacle_appears(self) -> None:
        around = SimulatedSurroundings(ObstacleSensorParameters(), scene(MOVING), radius=0.2)
        assert around.collision(at([3, -3, 1]), 0) is None
        assert around.collision(at([3, -3, 1]), SECOND // 2) is not None


FORWARD = [
    "reference.trajectory=minimum_snap",
    "reference.waypoints=[0.0, 0.0, 1.5, 4.0, 0.0, 1.5]",
    "reference.max_speed=2.0",
]


def test_a_flight_into_a_pillar_ends_as_crashed_with_where_and_how_fast(tmp_path: Path) -> None:
    """The MPC receives no obstacles and flies straight on."""
    from quad_mpc_ros import load_config, simulate, summarise

    config = load_config("default", assignments=FORWARD)
    flight = simulate(*config, duration=6.0, scene=scene(PILLAR), on_reference=True)
    summary = summarise(flight)
    assert summary["crashed"] and summary["crash"] == "obstacle" and summary["collided"]
    assert flight.time[-1] < 5.9 and summary["clearance_min_m"] <= 0.0
    collision = summary["collision"]
    assert collision["position_m"][0] == pytest.approx(2.7, abs=0.06)
    assert 0.5 < collision["speed_m_s"] < 3.0


@pytest.mark.parametrize("sensor", ["rays", "markers"])
def test_flies_around_sensed_obstacles(sensor: str) -> None:
    from quad_mpc_ros import load_config, simulate, summarise

    seen = ["mpc.obstacles.half_spaces=8", f"simulator.obstacles.sensor={sensor}"]
    config = load_config("default", assignments=[*FORWARD, *seen])
    pillar = scene("shape: cylinder, position: [2.2, 0, 1.5], radius: 0.1, height: 3")
    flight = simulate(*config, duration=7.0, scene=pillar, on_reference=True)
    summary = summarise(flight)
    assert not summary["collided"] and summary["clearance_min_m"] > 0.02
    assert summary["fallbacks"] == 0 and summary["solver_failures"] == 0
    assert flight.p_WB[-1, 0] > 3.8
    assert {"free", "around"} <= set(flight.stats["avoidance"].tolist())


def test_a_start_in_contact_with_an_obstacle_is_refused() -> None:
    around = SimulatedSurroundings(ObstacleSensorParameters(), scene(PILLAR, MOVING), radius=0.2)
    with pytest.raises(UserError, match=r"0.15 m from the surface of the cylinder at \[3.0, 0.0"):
        around.check_start(np.array([3.0, 0.25, 1.0]))
    around.check_start(np.array([3.0, 0.35, 1.0]))
    around.check_start(np.array([3.0, -3.0, 1.0]))  # where an obstacle appears later
