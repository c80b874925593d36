# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The table of Sun et al.: its references are theirs, and every cell of it flies."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from fixtures.scripts import script_module

from quad_mpc_ros import load_config
from quad_mpc_ros.references.configured import judged_trajectory


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return script_module("bench/sun_2022.py")


def test_of_144_references_76_are_flown_and_the_rotors_can_lift_each(script: ModuleType) -> None:
    feasible = [course for course in script.COURSES if course.feasible]
    assert (len(script.COURSES), len(feasible)) == (144, 76)
    for course in feasible:
        config = load_config(
            "vehicles/sun_2022", str(script.SETTINGS), assignments=course.assignments()
        )
        _, verdict = judged_trajectory(config.reference)
        needs = verdict.over_time
        # Speed V and acceleration a, at their largest and in turns.
        assert needs.speed.max() == pytest.approx(course.speed, rel=1e-3)
        assert needs.acceleration.max() == pytest.approx(course.acceleration, rel=1e-3)
        # Near free fall some push down by a little, which no rotor here does.
        assert needs.throttle.min() > -0.11
        assert needs.throttle.max() <= 1.0


def test_every_condition_of_every_row_is_flown_from_the_reference(script: ModuleType) -> None:
    arguments = script.parsed(["--duration", "0.1"])
    jobs = [*script.jobs(arguments)]
    assert len(jobs) == 76 * (14 * 2 + 3)
    for job in jobs[::76]:
        flown = script.flown(job)
        assert not flown.crashed
        assert flown.rmse < 0.3
    lines = script.table([script.flown(job) for job in jobs[:2]])
    assert len(lines) == 2
    assert float(lines[1][4]) < 0.05


def test_latency_is_hidden_or_configured(script: ModuleType) -> None:
    arguments = script.parsed(["--conditions", "latency 30 ms", "--rows", "on", "declared"])
    hidden, *_, configured = script.jobs(arguments)
    hidden, configured = (
        load_config(*job.sources, assignments=job.assignments) for job in (hidden, configured)
    )
    assert (hidden.simulator.odom_delay, hidden.simulator.odom_stamp) == (0.03, "sent")
    assert (configured.simulator.odom_delay, configured.simulator.odom_stamp) == (0.03, "measured")
    np.testing.assert_allclose(configured.mpc.input_delay - hidden.mpc.input_delay, 0.03)


def test_large_deviation_counts_as_a_crash_with_an_error_of_five_metres(
    script: ModuleType,
) -> None:
    arguments = script.parsed(
        [
            *("--conditions", "baseline", "--rows", "off", "--duration", "4"),
            *("--set", "simulator.push.force=[0.0, 0.0, 60.0]"),
        ]
    )
    flown = script.flown(next(script.jobs(arguments)))
    assert flown.crashed
    assert flown.rmse == 5.0
    assert script.cell([flown]) == "5.000 (100.0)"


def test_late_odometry_causes_a_proportional_error_without_oscillation(script: ModuleType) -> None:
    """At 20 m/s a pose that is 50 ms old and taken as current is off by 1 m."""
    arguments = script.parsed(["--conditions", "latency 50 ms", "--rows", "on", "--duration", "6"])
    course = script.Course("horizontal", 30.0, 20.0, 1)
    flown = script.flown(next(job for job in script.jobs(arguments) if job.course == course))
    assert flown.rmse < 1.1
    assert flown.largest < 1.5


@pytest.mark.parametrize(
    ("condition", "course"),
    [
        ("baseline", ("horizontal", 10.0, 5.0, 5)),  # yaw takes more torque than there is
        ("mass -30 %", ("horizontal", 30.0, 20.0, 5)),
        ("mass +30 %", ("horizontal", 40.0, 5.0, 1)),  # level at full throttle
        ("centre of mass 10 % off", ("horizontal", 30.0, 15.0, 5)),
        ("centre of mass 10 % off", ("vertical", 20.0, 20.0, 1)),
        ("push of 15 N", ("horizontal", 20.0, 20.0, 5)),
        ("push of 15 N", ("vertical", 10.0, 10.0, 1)),
        ("latency 50 ms", ("vertical", 30.0, 5.0, 5)),
    ],
)
def test_the_model_may_be_wrong_without_contradicting_the_odometry(
    script: ModuleType, condition: str, course: tuple[str, float, float, int]
) -> None:
    arguments = script.parsed(["--conditions", condition, "--rows", "on"])
    jobs = script.jobs(arguments)
    flown = script.flown(next(job for job in jobs if job.course == script.Course(*course)))
    assert flown.fallbacks == 0
    assert not flown.crashed
