"""The comparison of a control step with other controllers, and the page that it publishes."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import performance
import pytest
from peers.controller import ControllerPeer

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.config import SimulatorConfig

SHORT = ["--duration", "0.2", "--repeats", "2"]


def flight(step_us: list[float], **given: object) -> performance.MeasuredFlight:
    count = len(step_us)
    nothing: dict[str, object] = {
        "solve_us": np.array(step_us) / 2.0,
        "mpc_us": np.full(count, np.nan),
        "iterations": np.zeros(count, dtype=np.int64),
        "solved": np.ones(count, dtype=np.bool_),
        "errors": np.zeros(count),
    }
    return performance.MeasuredFlight(step_us=np.array(step_us), **(nothing | given))


def test_published_page_shows_the_recorded_figures() -> None:
    published = performance.PAGE.read_text(encoding="utf-8")
    assert published == performance.page_of_record(), "run python bench/performance.py --page"


def test_percentiles_leave_out_the_first_step_of_each_flight() -> None:
    low, high = flight([5000.0, *range(1, 51)]), flight([7000.0, *range(51, 101)])
    figures = performance.summarise([high, low])
    assert figures["step_us"] == {"p50": 50.0, "p99": 99.0, "max": 100.0}
    assert figures["solve_us"] == {"p50": 25.0, "p99": 49.5, "max": 50.0}
    assert figures["mpc_us"] == {"p50": None, "p99": None, "max": None}
    assert figures["first_step_us"] == 7000.0
    assert (figures["flights"], figures["steps"]) == (2, 102)


def test_failures_and_iterations_are_of_every_step_and_the_error_of_the_worst_flight() -> None:
    good = flight([1.0] * 3, iterations=np.array([400, 25, 50]))
    bad = flight([1.0] * 2, solved=np.array([True, False]), errors=np.array([3.0, 4.0]))
    figures = performance.summarise([good, bad, good])
    assert figures["failed_steps"] == 1
    assert figures["iterations"]["max"] == 400.0
    assert figures["position_rmse_m"] == pytest.approx(np.sqrt(12.5))


def test_a_step_takes_longer_than_its_solver(
    mpc: MpcConfig, simulator: SimulatorConfig, reference: ReferenceConfig
) -> None:
    short = dataclasses.replace(simulator, duration=0.3)
    flown = performance.fly(ControllerPeer(mpc), performance.FlightConfig(mpc, short, reference))
    assert flown.solved.all()
    assert np.all(flown.solve_us > 0.0)
    assert np.all(flown.mpc_us > flown.solve_us)
    assert np.all(flown.step_us > flown.mpc_us)


def test_peers_that_are_not_installed_are_skipped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("cvxpy", "acados"):
        monkeypatch.setitem(sys.modules, name, None)  # type: ignore[arg-type]
    assert performance.main([*SHORT, "--steps", "5"]) == 0
    printed = capsys.readouterr()
    assert printed.err.count("pip install 'quad_mpc_ros[bench]'") == 2
    assert "| this controller, the paper's formulation |" in printed.out
    assert "| 5 | this controller |" in printed.out


def test_every_installed_peer_flies(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("cvxpy", reason="the extra 'bench' is not installed")
    pytest.importorskip("acados", reason="the extra 'bench' is not installed")
    assert performance.main([*SHORT, "--steps"]) == 0
    printed = capsys.readouterr()
    assert "skipped" not in printed.err
    rows = [line for line in printed.out.splitlines() if line.startswith("| ")]
    for kind in performance.PEERS.values():
        (row,) = (row for row in rows if row.startswith(f"| {kind.title} |"))
        failed = row.split(" | ")[6]
        assert failed == "0"


def test_wrong_parameter_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        performance.main(["--set", "mpc.horizn_steps=3"])
    assert ended.value.code == 2
    assert "horizon_steps" in capsys.readouterr().err
