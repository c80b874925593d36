# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of merit, compared with hand calculations."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.evaluation.verdict import verdict_on
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Scene, Sphere

FlightMaker = Callable[..., Flight]

P50_P99_MAX = ("p50", "p99", "max")


def yawed(angles: np.ndarray) -> np.ndarray:
    """Return the quaternions x, y, z, w of turns about z."""
    zeros = np.zeros_like(angles)
    return np.column_stack((zeros, zeros, np.sin(angles / 2), np.cos(angles / 2)))


def test_a_perfect_flight(make_flight: FlightMaker) -> None:
    summary = summarise(make_flight(101), wall_seconds=4.0)
    assert summary["position_rmse_m"] == summary["position_max_m"] == 0.0
    assert summary["attitude_rmse_rad"] == 0.0
    assert summary["waypoint_error_m"] == []
    assert summary["commands"] == summary["odometries"] == 101
    assert summary["duration_s"] == pytest.approx(2.0)
    assert summary["realtime_factor"] == pytest.approx(0.5)
    assert summary["odom_to_command_ms"] == {"p50": 1.0, "p90": 1.0, "p99": 1.0, "max": 1.0}
    assert summary["iterations"] == {"p50": 25, "p99": 25, "max": 25}
    for name in ("solver_failures", "fallbacks", "deadline_misses", "unanswered_odometries"):
        assert summary[name] == 0
    assert summary["rate_saturation_fraction"] == 0.0


class TestGaps:
    """A flight of 10 s at 50 Hz that has no odometry from 4.00 to 5.02 s."""

    @staticmethod
    def flight(make_flight: FlightMaker) -> Flight:
        times = np.delete(np.arange(501), range(201, 251))
        stamp_ns = 10**18 + 20_000_000 * times
        p_WB = np.column_stack((0.02 * times, np.zeros((len(times), 2))))
        return make_flight(len(times), stamp_ns=stamp_ns, publish_time_ns=stamp_ns, p_WB=p_WB)

    def test_gaps_are_found_and_named(self, make_flight: FlightMaker) -> None:
        flight = self.flight(make_flight)
        ((begin, end),) = flight.gaps
        assert (begin, end) == pytest.approx((4.0, 5.02))
        summary = summarise(flight)
        assert summary["odometry_gaps_s"] == [[begin, end]]
        said = "Odometry is missing for 1.02 s, longest from 4.00 to 5.02 s; errors are"
        assert any(sentence.startswith(said) for sentence in verdict_on(summary).wrong)

    def test_curves_are_interrupted_at_gaps(self, make_flight: FlightMaker) -> None:
        flight = self.flight(make_flight)
        time, p_WB = flight.broken(flight.time, flight.p_WB)
        (place,) = np.flatnonzero(np.isnan(p_WB[:, 0]))
        assert time[place] == pytest.approx(4.51)
        assert len(time) == len(p_WB) == len(flight.time) + 1
        thinned = flight.time[::7]
        assert np.isnan(flight.broken(thinned, flight.p_WB[::7])[1]).any(axis=1).sum() == 1


class TestObstacles:
    """A vehicle of 0.2 m radius that flies east at 1 m/s, at a height of 2 m."""

    @staticmethod
    def flight(make_flight: FlightMaker, *, start: float = 0.0, y: float = 0.0) -> Flight:
        x = start + 0.02 * np.arange(201)
        p_WB = np.column_stack((x, np.full(201, y), np.full(201, 2.0)))
        return make_flight(201, p_WB=p_WB, v_WB_B=np.tile([1.0, 0.0, 0.0], (201, 1)))

    def test_clearance_is_from_surface_to_surface(self, make_flight: FlightMaker) -> None:
        pillar = Cylinder(p_WO=np.array([2.0, 0.7, 1.5]), radius=0.2, height=3.0)
        flight = replace(self.flight(make_flight), scene=Scene([pillar]))
        summary = summarise(flight)
        assert summary["clearance_min_m"] == pytest.approx(0.7 - 0.2 - 0.2, abs=1e-3)
        assert (summary["collided"], summary["collision"]) == (False, None)

    def test_collision_is_a_crash_with_position_and_speed(self, make_flight: FlightMaker) -> None:
        wall = Box(p_WO=np.array([3.0, 0.0, 1.5]), size=np.array([0.2, 4.0, 3.0]))
        summary = summarise(replace(self.flight(make_flight), scene=Scene([wall])))
        assert summary["collided"] and summary["crash"] == "obstacle"
        assert summary["crash_time_s"] == summary["collision"]["time_s"]
        assert summary["collision"]["position_m"][0] == pytest.approx(2.7, abs=0.021)
        assert summary["collision"]["speed_m_s"] == 1.0

    def test_moving_obstacles_are_evaluated_at_their_position_over_time(
        self, make_flight: FlightMaker
    ) -> None:
        ahead = Sphere(
            p_WO=np.array([1.0, 0.0, 2.0]), radius=0.3, v_WO_W=np.array([1.0, 0.0, 0.0])
        )
        summary = summarise(replace(self.flight(make_flight), scene=Scene([ahead])))
        assert summary["clearance_min_m"] == pytest.approx(1.0 - 0.3 - 0.2, abs=1e-6)


def test_position_error_is_the_distance_to_the_reference(make_flight: FlightMaker) -> None:
    p_WB = np.zeros((100, 3))
    p_WB[:25] = [0.0, 3.0, -4.0]
    summary = summarise(make_flight(100, p_WB=p_WB), wall_seconds=None)
    assert summary["position_rmse_m"] == pytest.approx(2.5)  # 5 m for a quarter of the time
    assert summary["position_max_m"] == pytest.approx(5.0)


@pytest.mark.parametrize("angle", [0.0, 0.3, -2.0, math.pi])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_attitude_error_is_the_angle(make_flight: FlightMaker, angle: float, sign: float) -> None:
    flight = make_flight(10, q_WB_xyzw=sign * yawed(np.full(10, angle)))
    summary = summarise(flight, wall_seconds=None)
    assert summary["attitude_rmse_rad"] == pytest.approx(abs(angle), abs=1e-9)


class TestWaypoints:
    """Errors just before each switch; 50 odometries are one second."""

    @staticmethod
    def flight(
        make_flight: FlightMaker, build: SimpleNamespace, counts: list[int], errors: list[float]
    ) -> Flight:
        """Return a flight to waypoints 1 m apart, each held for a number of odometries.

        It is 0.7 m off but for the last odometry of each, where it is off by the error given.
        """
        p_WB_r = np.repeat([[1.0 * n, 0.0, 2.0] for n in range(len(counts))], counts, axis=0)
        offset = np.full(len(p_WB_r), 0.7)
        offset[np.cumsum(counts) - 1] = errors
        p_WB = p_WB_r + offset[:, None] * [0.0, 0.6, 0.8]
        return make_flight(len(p_WB), p_WB=p_WB, reference=build.reference(p_WB_r))

    def test_errors_before_switches_and_at_the_end(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        flight = self.flight(make_flight, build, [50, 50, 50], [0.1, 0.2, 0.3])
        found = summarise(flight, wall_seconds=None)["waypoint_error_m"]
        assert found == pytest.approx([0.1, 0.2, 0.3])

    def test_the_end_counts_only_after_a_full_dwell(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        flight = self.flight(make_flight, build, [50, 50, 45], [0.1, 0.2, 0.3])
        found = summarise(flight, wall_seconds=None)["waypoint_error_m"]
        assert found == pytest.approx([0.1, 0.2])

    @pytest.mark.parametrize("counts", [[50, 51, 50], [51, 50, 49], [50, 50, 51]])
    def test_switch_between_two_odometries(
        self, make_flight: FlightMaker, build: SimpleNamespace, counts: list[int]
    ) -> None:
        flight = self.flight(make_flight, build, counts, [0.1, 0.2, 0.3])
        assert len(summarise(flight, wall_seconds=None)["waypoint_error_m"]) == 3

    def test_a_moving_reference_has_no_waypoints(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        # 10 m/s along x, as a reference without preview comes: at every fourth odometry.
        x = 0.8 * (np.arange(200) // 4)
        reference = build.reference(np.column_stack((x, 0 * x, 0 * x)))
        summary = summarise(make_flight(200, reference=reference), wall_seconds=None)
        assert summary["waypoint_error_m"] == []

    def test_smooth_departure_is_no_switch(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        t = np.maximum(0.02 * np.arange(200) - 2.0, 0.0)  # then 5 m/s^2
        reference = build.reference(np.column_stack((2.5 * t**2, 0 * t, 0 * t)))
        summary = summarise(make_flight(200, reference=reference), wall_seconds=None)
        assert summary["waypoint_error_m"] == []


class TestTiming:
    def test_command_after_a_period_is_a_deadline_miss(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        flight = make_flight(6)
        commands = build.commands(flight.stamp_ns, latency_ms=[1.0, 9.0, 12.0, 20.0, 20.1, 35.0])
        flight = dataclasses.replace(flight, commands=commands)
        assert summarise(flight, wall_seconds=None)["deadline_misses"] == 2
        faster = dataclasses.replace(flight, mpc=MpcConfig(control_rate=100.0))
        assert summarise(faster, wall_seconds=None)["deadline_misses"] == 4

    def test_latency_is_between_publications(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        flight = make_flight(10)
        published = flight.stamp_ns + 30_000_000  # stamps of a slow camera
        commands = build.commands(flight.stamp_ns, latency_ms=32.0)
        flight = dataclasses.replace(flight, publish_time_ns=published, commands=commands)
        found = summarise(flight, wall_seconds=None)
        assert found["odom_to_command_ms"]["max"] == pytest.approx(2.0)
        assert found["deadline_misses"] == 0

    def test_watchdog_command_answers_no_odometry(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        flight = make_flight(10)
        stamp_ns = np.insert(flight.stamp_ns, 5, flight.stamp_ns[4] + 7_000_000)
        commands = build.commands(stamp_ns, latency_ms=[1.0] * 5 + [500.0] + [1.0] * 5)
        found = summarise(dataclasses.replace(flight, commands=commands), wall_seconds=None)
        assert found["commands"] == 11
        assert found["odom_to_command_ms"]["max"] == pytest.approx(1.0)
        assert found["deadline_misses"] == 0


class TestUnanswered:
    @staticmethod
    def count(
        make_flight: FlightMaker,
        build: SimpleNamespace,
        *,
        answered: list[int],
        total: int,
        rate: float = 50.0,
    ) -> int:
        """Return how many of the odometries at a rate count as unanswered at 50 Hz control."""
        stamp_ns = build.start_ns + np.round(np.arange(total) * 1e9 / rate).astype(np.int64)
        flight = make_flight(total, stamp_ns=stamp_ns, commands=build.commands(stamp_ns[answered]))
        return int(summarise(flight, wall_seconds=None)["unanswered_odometries"])

    def test_counts_unanswered_from_first_command_to_last_odometry(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        answered = [n for n in range(50) if n >= 5 and n not in (10, 11, 30, 49)]
        assert self.count(make_flight, build, answered=answered, total=50) == 4

    @pytest.mark.parametrize(
        ("rate", "every"), [(30.0, 1), (50.0, 1), (100.0, 2), (200.0, 4), (500.0, 10)]
    )
    def test_decimated_odometry_needs_no_answer(
        self, make_flight: FlightMaker, build: SimpleNamespace, rate: float, every: int
    ) -> None:
        answered = list(range(0, 400, every))
        count = lambda some: self.count(  # noqa: E731
            make_flight, build, answered=some, total=400, rate=rate
        )
        assert count(answered) == 0
        assert count(answered[:20] + answered[21:]) == 1

    def test_odometry_gap_is_not_unanswered(
        self, make_flight: FlightMaker, build: SimpleNamespace
    ) -> None:
        stamp_ns = build.start_ns + build.period_ns * np.array([0, 1, 2, 12, 13, 14])
        commands = build.commands(stamp_ns[[0, 1, 2, 4, 5]])
        flight = make_flight(6, stamp_ns=stamp_ns, commands=commands)
        assert summarise(flight, wall_seconds=None)["unanswered_odometries"] == 1


def test_saturation_is_the_fraction_of_commands_at_any_bound(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    rates = np.zeros((8, 3))
    rates[0] = [6 * math.pi, 0.0, 0.0]
    rates[1] = [0.0, -6 * math.pi + 5e-4, 0.0]
    rates[2] = [0.0, 0.0, -3 * math.pi]
    rates[3] = [-6 * math.pi, 6 * math.pi, 3 * math.pi]
    rates[4] = [6 * math.pi - 2e-3, 3 * math.pi, 0.0]
    flight = make_flight(8)
    commands = build.commands(flight.stamp_ns, w_WB_B=rates)
    flight = dataclasses.replace(flight, commands=commands)
    assert summarise(flight, wall_seconds=None)["rate_saturation_fraction"] == 0.5
    tighter = dataclasses.replace(flight, mpc=MpcConfig(omega_max=(18.0, 18.0, 9.0)))
    assert summarise(tighter, wall_seconds=None)["rate_saturation_fraction"] == 0.625


def test_ticks_without_a_solve_are_excluded(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    idle = {"solver_status": "not run", "iterations": 0, "solve_time_us": 0.0, "step_time_us": 0.0}
    failed = {"solver_status": "maximum iterations reached", "iterations": 400}
    ticks = [
        build.tick(1, source="waiting", **idle),
        build.tick(2, iterations=50, solve_time_us=90.0, step_time_us=300.0),
        build.tick(3, iterations=75, solve_time_us=110.0, step_time_us=500.0),
        build.tick(4, source="plan", **failed),
        build.tick(5, source="plan", solver_status="not finite", iterations=1),
        build.tick(6, source="hover", **idle),
        build.tick(7, source="blind", **idle),
        build.tick(8, source="silent", **idle),
    ]
    found = summarise(make_flight(8, stats=build.stats(ticks)), wall_seconds=None)
    assert found["iterations"] == {"p50": 50, "p99": 400, "max": 400}
    assert found["solve_time_us"]["p50"] == 100.0
    assert found["step_time_us"] == {"p50": 400.0, "p90": 500.0, "p99": 500.0, "max": 500.0}
    assert found["solver_failures"] == 2
    assert found["fallbacks"] == 4  # silent sends nothing


def test_missing_data_is_null(make_flight: FlightMaker, build: SimpleNamespace) -> None:
    none = np.zeros(0, dtype=np.int64)
    flight = make_flight(1, reference=None, commands=build.commands(none), stats=build.stats([]))
    found = json.loads(json.dumps(summarise(flight, wall_seconds=0.0), allow_nan=False))
    for name in ("position_rmse_m", "position_max_m", "attitude_rmse_rad", "clearance_min_m"):
        assert found[name] is None, name
    for name in ("rate_saturation_fraction", "realtime_factor", "crashed", "lap_time_s"):
        assert found[name] is None, name
    for name in ("step_time_us", "solve_time_us", "odom_to_command_ms", "iterations"):
        assert set(found[name].values()) == {None}, name
    for name in ("odom_age_ms", "reference_age_ms"):
        assert found["margins"][name] == dict.fromkeys(P50_P99_MAX), name
    assert found["margins"]["fence_margin_m"] is None
    assert found["commands"] == found["unanswered_odometries"] == found["duration_s"] == 0
    assert found["odometries"] == 1


def test_the_summary_is_strict_json(make_flight: FlightMaker, build: SimpleNamespace) -> None:
    flight = make_flight(
        20,
        parameters={"mpc": {"Q": (1.0, math.inf), "name": "x"}, "other": {"a": [math.nan, 2]}},
        stats=build.stats([build.tick(1, step_time_us=math.nan), build.tick(2)]),
        commands=build.commands(
            build.start_ns + build.period_ns * np.arange(20), w_WB_B=np.full((20, 3), math.nan)
        ),
    )
    summary = summarise(flight, wall_seconds=3.0)
    read = json.loads(json.dumps(summary, allow_nan=False))
    assert read["config"] == {"mpc": {"Q": [1.0, None], "name": "x"}, "other": {"a": [None, 2]}}
    assert read["step_time_us"]["max"] == 400.0
    assert read["rate_saturation_fraction"] == 0.0
