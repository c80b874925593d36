"""Figures of flights whose figures are known."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.experiments.bench.flights import (
    MeasuredFlight,
    errors_before_switches,
    summarise,
)


def flight(step_us: list[float], **given: object) -> MeasuredFlight:
    count = len(step_us)
    nothing: dict[str, object] = {
        "solve_us": np.array(step_us) / 2.0,
        "mpc_us": np.full(count, np.nan),
        "iterations": np.zeros(count, dtype=np.int64),
        "solved": np.ones(count, dtype=np.bool_),
        "commands": np.zeros((count, 4)),
        "p_WB": np.zeros((count, 3)),
        "p_reference": np.zeros((count, 3)),
    }
    return MeasuredFlight(step_us=np.array(step_us), **(nothing | given))  # type: ignore[arg-type]


def test_percentiles_are_measured_values_of_all_flights_but_their_first_steps() -> None:
    low, high = flight([5000.0, *range(1, 51)]), flight([7000.0, *range(51, 101)])

    figures = summarise([high, low])

    assert figures["step_us"] == {"p50": 50.0, "p99": 99.0, "max": 100.0}
    assert figures["solve_us"] == {"p50": 25.0, "p99": 49.5, "max": 50.0}
    assert figures["mpc_us"] == {"p50": None, "p99": None, "max": None}
    assert figures["first_step_us"] == 7000.0
    assert (figures["flights"], figures["steps"]) == (2, 102)


def test_iterations_are_of_every_step() -> None:
    first = flight([1.0] * 3, iterations=np.array([400, 25, 50]))

    assert summarise([first])["iterations"] == {"p50": 50.0, "p99": 400.0, "max": 400.0}


def test_failures_are_counted() -> None:
    failing = flight([1.0] * 4, solved=np.array([True, False, False, True]))

    assert summarise([failing, failing])["failed_steps"] == 4


def test_errors_before_switches_are_those_of_the_old_reference() -> None:
    reference = np.array([[0.0, 0, 0], [0.0, 0, 0], [2.0, 0, 0], [2.0, 0, 0], [2.0, 2, 0]])
    flown = np.array([[0.5, 0, 0], [0.1, 0, 0], [0.1, 0, 0], [2.0, 0.3, 0], [2.0, 0.3, 0]])
    switching = flight([1.0] * 5, p_reference=reference, p_WB=flown)

    assert errors_before_switches(switching) == pytest.approx([0.1, 0.3])
    assert summarise([switching])["error_before_switch_m"] == pytest.approx(0.3)


def test_flying_quality_is_of_the_worst_flight() -> None:
    good = flight([1.0, 1.0], p_WB=np.array([[3.0, 0, 0], [0, 4.0, 0]]))
    bad = flight([1.0, 1.0], p_WB=np.array([[5.0, 0, 0], [0, 5.0, 0]]))

    assert summarise([good])["position_rmse_m"] == pytest.approx(np.sqrt(12.5))
    assert summarise([good, bad, good])["position_rmse_m"] == pytest.approx(5.0)


def test_a_single_step_has_no_percentiles() -> None:
    figures = summarise([flight([9.0])])

    assert figures["step_us"] == {"p50": None, "p99": None, "max": None}
    assert figures["first_step_us"] == 9.0
    assert figures["error_before_switch_m"] is None
