# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans of races: as fast as published ones, and what an independent quadrotor makes of them."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import signal
from typing import Any

import numpy as np
import pytest
from full_quadrotor import check
from numpy.testing import assert_allclose, assert_array_equal
from race_plans import random_course

from quad_mpc_ros import load_config, simulate, summarise
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.racing.gates import course_from, read_course
from quad_mpc_ros.extras.racing.planning import transcription
from quad_mpc_ros.extras.racing.planning.race_plan import RacePlan, plan_race
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.references.feasibility import judged

pytest.importorskip("casadi")

SHORT: dict[str, Any] = {
    "start": {"position": [0.0, 0.0, 1.0], "yaw": 0.5},
    "gates": [
        {"position": [6.0, 0.0, 2.0], "yaw": 0.4, "width": 1.6, "height": 1.2},
        {"position": [8.0, 6.0, 1.5], "tolerance": 0.3},
        {"position": [2.0, 7.0, 1.5], "yaw": 3.4, "tolerance": 0.5},
    ],
    "end": [-2.0, 4.0, 1.0],
}
DRAG = ["mpc.drag=[0.3,0.3,0.5]", "simulator.drag=[0.3,0.3,0.5]", "reference.drag=[0.3,0.3,0.5]"]


@functools.cache
def vehicle(*assignments: str) -> FlightConfig:
    return load_config("vehicles/cpc", assignments=assignments)


@functools.cache
def short(*assignments: str) -> RacePlan:
    return plan_race(course_from(SHORT), *vehicle(*assignments), gate_margin=0.1, step=0.06)


@pytest.mark.parametrize("assignments", [(), tuple(DRAG)])
def test_independent_equations_of_motion_agree_with_the_plan(
    assignments: tuple[str, ...],
) -> None:
    found = check(short(*assignments), vehicle(*assignments))
    assert found.good, found


def test_gates_are_passed_with_their_margin_in_the_right_direction() -> None:
    plan = short()
    assert plan.lap.missed == 0
    times = np.array([passage.time for passage in plan.lap.passages], dtype=np.float64)
    for gate, time in zip(plan.course.gates, times, strict=True):
        samples = plan.trajectory().at([round(1e9 * time)])
        offset = samples.p_WB - gate.p_WG
        if gate.R_WG is not None:
            assert samples.v_WB_W[0] @ gate.R_WG[:, 0] > 0.0
            offset = offset @ gate.R_WG
        assert gate.room(offset)[0] > 0.1 - 2e-3


def test_starts_and_ends_in_hover() -> None:
    table = short().table
    assert_allclose(table.p_WB[[0, -1]], [[0.0, 0.0, 1.0], [-2.0, 4.0, 1.0]], atol=1e-5)
    assert_allclose(table.v_WB_W[[0, -1]], 0.0, atol=1e-5)
    assert_allclose(table.q_WB_xyzw[0], [0.0, 0.0, np.sin(0.25), np.cos(0.25)], atol=1e-5)
    assert_allclose(table.q_WB_xyzw[-1, :2], 0.0, atol=1e-5)  # level


@pytest.mark.parametrize("margin", [0.0, 0.15])
def test_passes_check_reference_with_its_margin(margin: float) -> None:
    assignment = f"reference.limit_margin={margin}"
    config = vehicle(assignment)
    bounds = dataclasses.replace(
        config.reference, omega_max=tuple(w + 0.02 for w in config.mpc.omega_max)
    )
    verdict = judged(short(assignment).trajectory(), bounds)
    assert verdict.feasible, verdict.reason()


def test_a_larger_margin_makes_the_race_slower() -> None:
    slower = short("reference.limit_margin=0.15").race_time
    assert short().race_time < slower < 1.25 * short().race_time


def test_planning_is_deterministic() -> None:
    again = plan_race(course_from(SHORT), *vehicle(), gate_margin=0.1, step=0.06)
    assert_array_equal(again.table.p_WB, short().table.p_WB)


def test_without_an_end_comes_to_rest_after_the_last_gate() -> None:
    course = course_from({key: value for key, value in SHORT.items() if key != "end"})
    plan = plan_race(course, *vehicle(), step=0.06)
    assert plan.race_time < plan.nodes.times[-1] - 0.3
    assert plan.lap.time == pytest.approx(plan.race_time, abs=0.01)
    assert plan.race_time < short().race_time
    assert check(plan, vehicle()).good


def test_without_rotors_throttle_and_rates_are_the_limits() -> None:
    config = load_config("agile")
    plan = plan_race(course_from(SHORT), *config, gate_margin=0.1, step=0.06)
    assert plan.vehicle.rotors is None and plan.lap.missed == 0
    table = plan.table
    assert np.all(np.abs(table.w_WB_B) <= np.array(config.mpc.omega_max) + 1e-3)


def test_flown_plan_passes_every_gate() -> None:
    plan = short("reference.limit_margin=0.1")
    settings = ("reference.advanced.window_step=0.02",)
    config = load_config("agile", "vehicles/cpc", assignments=settings)
    reference = dataclasses.replace(config.reference, gates=str(SHORT))
    flight = simulate(
        config.mpc,
        config.simulator,
        reference,
        trajectory=plan.trajectory(),
        on_reference=True,
        duration=plan.nodes.times[-1] + 0.5,
    )
    summary = summarise(flight)
    assert [gate["passed"] for gate in summary["gates"]] == [True] * 3
    assert not any(gate["clipped"] for gate in summary["gates"][1:2])  # a ball has no edge
    assert summary["lap_time_s"] < plan.race_time + 0.1
    assert summary["position_rmse_m"] < 0.02


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"gate_margin": 0.4}, r"gates\[2\]: unreachable: half of the opening is 0.3 m"),
        ({"step": 0.0}, "step: given 0.0"),
    ],
)
def test_rejects_bad_input_in_one_line(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(UserError, match=reason):
        plan_race(course_from(SHORT), *vehicle(), **changes)


def test_a_margin_that_leaves_no_thrust_is_refused() -> None:
    with pytest.raises(UserError, match=r"limit_margin: given 0.99, expected a value that leaves"):
        plan_race(course_from(SHORT), *vehicle("reference.limit_margin=0.99"))


def test_split_s_is_faster_than_published() -> None:
    """Published: 17.56 s (Foehn et al. 2021), planned for some 50 minutes."""
    plan = plan_race(read_course("split_s"), *vehicle())
    assert plan.race_time < 17.5
    assert check(plan, vehicle()).good


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1010))
def test_random_races_are_planned_and_feasible(seed: int) -> None:
    found = check(plan_race(course_from(random_course(seed)), *vehicle()), vehicle())
    assert found.good, found


def test_ctrl_c_is_not_lost_in_the_solver() -> None:
    lost = contextlib.suppress(KeyboardInterrupt)  # as a callback of CasADi may
    with pytest.raises(KeyboardInterrupt), transcription._interruptible(), lost:
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
