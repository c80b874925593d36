"""Tables, page and picture of a result that is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from quad_mpc_ros.experiments.bench.page import (
    as_markdown,
    as_text,
    comparison_lines,
    horizon_rows,
    page,
    peer_rows,
    swept,
)
from quad_mpc_ros.experiments.bench.picture import write_picture


def times(p50: float | None, p99: float | None, longest: float | None) -> dict[str, float | None]:
    return {"p50": p50, "p99": p99, "max": longest}


def entry(peer: str, steps: int, **given: Any) -> dict[str, Any]:
    known = {
        "peer": peer,
        "horizon_steps": steps,
        "flights": 2,
        "steps": 1000,
        "failed_steps": 0,
        "step_us": times(300.0, 600.0, 900.0),
        "solve_us": times(100.0, 200.0, 300.0),
        "mpc_us": times(None, None, None),
        "first_step_us": 1234.5,
        "iterations": times(25.0, 50.0, 75.0),
        "position_rmse_m": 0.71234,
        "error_before_switch_m": 0.01123,
    }
    return known | given


def peer(title: str, solver: str, *, swept: bool = False) -> dict[str, Any]:
    return {"title": title, "solver": solver, "description": "as known", "swept": swept}


@pytest.fixture
def result() -> dict[str, Any]:
    return {
        "command": "quad_mpc bench --duration 10",
        "machine": {"processor": "Abacus 2000", "cores": "2"},
        "settings": {
            "duration_s": 10.0,
            "repeats": 2,
            "trajectory": "square",
            "dynamics": "rigid_body",
            "odom_rate_hz": 50.0,
            "horizon_steps": 10,
            "horizon_step_s": 0.05,
            "Q": [10.0] * 9,
            "R": [0.0, 0.001, 0.001, 0.001],
            "terminal_weight": 1.0,
            "solver_tolerance": 1e-4,
        },
        "peers": {
            "controller": peer("this controller", "OSQP", swept=True),
            "acados": peer("acados SQP_RTI + HPIPM", "its C code", swept=True),
            "cvxpy": peer("cvxpy, rebuilt each step", "OSQP"),
        },
        "skipped": {"cvxpy": "it is not installed"},
        "entries": [
            entry("controller", 10, mpc_us=times(250.0, 500.0, 800.0)),
            entry("acados", 10, step_us=times(200.0, 400.0, 500.0)),
            entry("acados", 5),
            entry("controller", 5, error_before_switch_m=None),
        ],
    }


def test_only_what_flew_with_the_same_horizon_is_compared(result: dict[str, Any]) -> None:
    header, *rows = peer_rows(result)

    assert [row[0] for row in rows] == [
        "this controller",
        "of that, the MPC alone",
        "of that, OSQP's own time",
        "acados SQP_RTI + HPIPM",
        "of that, its C code's own time",
    ]
    assert rows[0][1:] == ["300", "600", "900", "1234", "25 / 50 / 75", "0", "0.7123", "0.0112"]
    assert rows[1][1:4] == ["250", "500", "800"]
    assert rows[2][1:4] == ["100", "200", "300"]
    assert {len(row) for row in rows} == {len(header)}


def test_horizons_are_in_order_peer_by_peer(result: dict[str, Any]) -> None:
    flown = [(each["peer"], each["horizon_steps"]) for each in swept(result)]

    assert flown == [("controller", 5), ("controller", 10), ("acados", 5), ("acados", 10)]
    assert [row[0] for row in horizon_rows(result)[1:]] == ["5", "10", "5", "10"]


def test_one_horizon_is_no_table(result: dict[str, Any]) -> None:
    result["entries"] = result["entries"][:2]

    assert swept(result) == []
    assert "length of the horizon" not in page(result, picture="p.png")


def test_ratios_are_over_the_peer(result: dict[str, Any]) -> None:
    own, beside_acados = comparison_lines(result)

    assert "3.00 at p50; the MPC alone: 2.50" in own
    assert "1.50 at p50, 1.50 at p99" in beside_acados


def test_missing_measurements_are_dashes(result: dict[str, Any]) -> None:
    result["entries"] = [entry("controller", 10, step_us=times(None, None, None))]

    assert peer_rows(result)[1][1:4] == ["-", "-", "-"]
    assert comparison_lines(result) == [
        "Whole step over OSQP's own time: - at p50; the MPC alone: -."
    ]
    result["entries"] = [entry("acados", 10)]
    assert comparison_lines(result) == []


def test_text_is_aligned_and_markdown_has_every_cell(result: dict[str, Any]) -> None:
    rows = peer_rows(result)
    lines = as_text(rows).splitlines()

    assert lines[0].index("p50 [us]") + 8 == lines[1].index("300") + 3 == lines[3].index("100") + 3
    assert all(line.count("|") == len(rows[0]) + 1 for line in as_markdown(rows).splitlines())


def test_page_says_how_on_what_and_what_is_missing(result: dict[str, Any]) -> None:
    text = page(result, picture="images/performance.png")

    for words in ("quad_mpc bench --duration 10", "Abacus 2000", "(images/performance.png)"):
        assert words in text
    assert "cvxpy, rebuilt each step: it is not installed" in text


@pytest.mark.parametrize("horizons", [True, False])
def test_picture_is_drawn(result: dict[str, Any], horizons: bool, tmp_path: Path) -> None:
    if not horizons:
        result["entries"] = [entry("controller", 10, step_us=times(None, None, None))]
    path = write_picture(result, tmp_path / "new" / "performance.png")

    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
