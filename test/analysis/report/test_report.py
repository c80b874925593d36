"""The report without a browser: what is in the page, the tables, the spans without the MPC."""

from __future__ import annotations

import csv
import dataclasses
import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fixtures.html_page import Elements

from quad_mpc_ros.analysis.figures.panels import (
    attitude_panels,
    input_panels,
    position_panels,
    solver_panels,
)
from quad_mpc_ros.analysis.report import TABLE_NAMES, ReportedRun, csv_tables, page
from quad_mpc_ros.analysis.report.run import fallback_spans
from quad_mpc_ros.analysis.report.time_figure import label
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.recordings.flight import Flight

FlightMaker = Callable[..., Flight]


def run_of(flight: Flight, *, name: str = "square") -> ReportedRun:
    return ReportedRun(name=name, bag=Path("runs") / name / "bag", flight=flight)


@pytest.fixture
def failing(make_flight: FlightMaker, build: SimpleNamespace) -> ReportedRun:
    """Return 2 s in which the last plan, then hover, commands from 0.6 s to 1.0 s."""
    sources = ["mpc"] * 30 + ["plan"] * 10 + ["hover"] * 10 + ["mpc"] * 50
    stamps = build.start_ns + build.period_ns * np.arange(100)
    ticks = [
        build.tick(int(stamp), source=source, reason="" if source == "mpc" else "solver <failed>")
        for stamp, source in zip(stamps, sources, strict=True)
    ]
    return run_of(make_flight(100, stats=build.stats(ticks)))


def test_spans_without_the_mpc(failing: ReportedRun) -> None:
    plan, hover = fallback_spans(failing.flight)
    assert (plan.source, plan.reason) == ("plan", "solver <failed>")
    assert (plan.start, plan.end) == pytest.approx((0.6, 0.8))
    assert hover.source == "hover"
    assert (hover.start, hover.end) == pytest.approx((0.8, 1.0))


def test_a_span_lasts_until_the_end_of_the_flight(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    flight = make_flight(100)
    silent = build.tick(int(flight.stamp_ns[60]), source="silent", reason="no odometry")
    (span,) = fallback_spans(dataclasses.replace(flight, stats=build.stats([silent])))
    assert (span.start, span.end) == pytest.approx((1.2, 1.98))


def test_waiting_is_not_a_fallback(make_flight: FlightMaker, build: SimpleNamespace) -> None:
    waiting = build.tick(build.start_ns, source="waiting", reason="no reference yet")
    assert fallback_spans(make_flight(5, stats=build.stats([waiting]))) == []


def test_verdict_states_who_commanded_and_why(
    failing: ReportedRun, make_flight: FlightMaker
) -> None:
    assert run_of(make_flight(7)).verdict.commanded == "The MPC gave every one of the 7 commands."
    message = failing.verdict.commanded
    assert "at 20 of 100 ticks: 10 plan, 10 hover." in message
    assert "First at 0.60 s: solver <failed>" in message


def test_tables_hold_every_digit(make_flight: FlightMaker, build: SimpleNamespace) -> None:
    random = np.random.default_rng(3)
    flight = make_flight(
        50,
        p_WB=random.normal(size=(50, 3)),
        commands=build.commands(
            build.start_ns + build.period_ns * np.arange(50), w_WB_B=random.normal(size=(50, 3))
        ),
    )
    texts = csv_tables(run_of(flight))
    assert tuple(texts) == TABLE_NAMES
    tables = {name: list(csv.DictReader(io.StringIO(text))) for name, text in texts.items()}

    def column(table: str, name: str) -> list[float]:
        return [float(row[name]) for row in tables[table]]

    assert [int(row["stamp_ns"]) for row in tables["odometry"]] == flight.stamp_ns.tolist()
    for axis, name in enumerate("xyz"):
        assert column("odometry", f"p_WB_{name}_m") == flight.p_WB[:, axis].tolist()
        rates = column("commands", f"w_WB_B_{name}_rad_s")
        assert rates == flight.commands.w_WB_B[:, axis].tolist()
    # The reference is the origin.
    distance = [float(np.hypot(np.hypot(*p[:2]), p[2])) for p in flight.p_WB]
    assert column("odometry", "position_error_m") == pytest.approx(distance)
    assert {row["source"] for row in tables["ticks"]} == {"mpc"}
    assert column("ticks", "iterations") == [25.0] * 50


def test_a_run_without_reference_commands_or_ticks(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    none = np.zeros(0, dtype=np.int64)
    bare = run_of(
        make_flight(3, reference=None, commands=build.commands(none), stats=build.stats([]))
    )
    tables = csv_tables(bare)
    assert len(tables["odometry"].splitlines()) == 4
    assert "reference" not in tables["odometry"]
    assert len(tables["commands"].splitlines()) == 1
    assert "No command was given." in page([bare])


def test_panels_are_those_of_the_paper_with_bounds(failing: ReportedRun) -> None:
    flight = failing.flight
    assert [label(panel) for panel in position_panels(flight)] == ["x [m]", "y [m]", "z [m]"]
    symbols = [f"q<sub>{axis}</sub>" for axis in "wxyz"]
    assert [label(panel) for panel in attitude_panels(flight)] == symbols
    throttle, *rates = input_panels(flight)
    assert tuple(throttle.bounds) == (0.0, 1.0)
    assert [label(panel) for panel in rates] == [f"ω<sub>{axis}</sub> [rad/s]" for axis in "xyz"]
    assert rates[2].bounds == pytest.approx((-3 * np.pi, 3 * np.pi))
    assert solver_panels(flight)[0].bounds == [20_000.0]


def test_the_page_loads_nothing_and_escapes_what_was_recorded(failing: ReportedRun) -> None:
    evil = dataclasses.replace(failing, name="<i>evil</i></script>")
    elements = Elements(page([evil, failing]))
    assert all(address.startswith(("#", "data:")) for address in elements.addresses)
    tags = [tag for tag, _ in elements.elements]
    assert "i" not in tags
    assert not {"iframe", "object"} & set(tags)
    plots = [a for tag, a in elements.elements if "plotly-graph-div" in str(a.get("class"))]
    assert len(plots) == 7
    assert tags.count("img") == 2
    assert any("solver <failed>" in words for words in elements.words)


def test_the_page_of_a_long_flight_stays_small(make_flight: FlightMaker) -> None:
    """What is drawn is thinned."""
    text = page([run_of(make_flight(40_000))])
    assert len(text) < len(page([run_of(make_flight(100))])) + 6_000_000


def test_lists_parameters_that_differ(make_flight: FlightMaker) -> None:
    left, right = (
        run_of(make_flight(5, parameters={"mpc": {"mass": mass, "control_rate": 50.0}}), name=name)
        for name, mass in (("light", 0.4), ("heavy", 0.5))
    )
    text = page([left, right])
    differing = text[text.index("Parameters that differ") : text.index("<nav>")]
    assert "<th>mpc.mass</th><td>0.4</td><td>0.5</td>" in differing
    assert "control_rate" not in differing


def test_without_plotly_says_what_to_install(
    make_flight: FlightMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(UserError, match=r"pip install 'quad_mpc_ros\[report\]'"):
        page([run_of(make_flight(5))])


def test_reports_a_plotly_that_is_too_old(
    make_flight: FlightMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("plotly.__version__", "5.24.1")
    with pytest.raises(UserError, match=r"Plotly 5\.24\.1 is installed"):
        page([run_of(make_flight(5))])


def test_plotly_is_imported_only_for_a_page() -> None:
    program = """
import sys
import quad_mpc_ros.analysis.report
imported = {name.split(".")[0] for name in sys.modules}
assert not imported & {"plotly", "matplotlib", "rclpy", "nav_msgs"}
"""
    finished: Any = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stderr
