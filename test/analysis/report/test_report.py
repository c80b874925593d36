# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Report: page, CSV tables, time spans without the MPC."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.html_page import Elements

from quad_mpc_ros.analysis.figures.over_time import spans_without_mpc
from quad_mpc_ros.analysis.report import ReportedRun, page
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
    assert spans_without_mpc(failing.flight) == pytest.approx(np.array([[0.6, 1.0]]))


def test_waiting_is_not_a_fallback(make_flight: FlightMaker, build: SimpleNamespace) -> None:
    waiting = build.tick(build.start_ns, source="waiting", reason="no reference yet")
    assert not len(spans_without_mpc(make_flight(5, stats=build.stats([waiting]))))


@pytest.mark.parametrize("source", ["idle", "silent"])
def test_a_span_lasts_until_the_end_of_the_flight(
    source: str, make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    flight = make_flight(100)
    last = build.tick(int(flight.stamp_ns[60]), source=source, reason="no odometry")
    flight = dataclasses.replace(flight, stats=build.stats([last]))
    assert spans_without_mpc(flight) == pytest.approx(np.array([[1.2, 1.98]]))
    assert "no odometry" in page([run_of(flight)])


def test_a_run_without_reference_commands_or_ticks(
    make_flight: FlightMaker, build: SimpleNamespace
) -> None:
    none = np.zeros(0, dtype=np.int64)
    bare = run_of(
        make_flight(3, reference=None, commands=build.commands(none), stats=build.stats([]))
    )
    assert "No command was sent." in page([bare])


def test_page_is_self_contained_and_escapes_recorded_text(failing: ReportedRun) -> None:
    evil = dataclasses.replace(failing, name="<i>evil</i></script>")
    elements = Elements(page([evil, failing]))
    assert all(address.startswith(("#", "data:")) for address in elements.addresses)
    tags = [tag for tag, _ in elements.elements]
    assert not {"i", "script", "iframe", "object"} & set(tags)
    assert tags.count("img") == 2 + 7  # two paths, and figures of both
    assert any("solver <failed>" in words for words in elements.words)


def test_lists_parameters_that_differ(make_flight: FlightMaker) -> None:
    left, right = (
        run_of(make_flight(5, parameters={"mpc": {"mass": mass, "control_rate": 50.0}}), name=name)
        for name, mass in (("light", 0.4), ("heavy", 0.5))
    )
    text = page([left, right])
    differing = text[text.index("Parameters that differ") : text.index('id="path"')]
    assert "<th>mpc.mass</th><td>0.4</td><td>0.5</td>" in differing
    assert "control_rate" not in differing
