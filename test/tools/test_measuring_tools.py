"""The tools that measure whether a change alters commands or step times."""

from __future__ import annotations

import subprocess
import sys

import pytest
from fixtures.scripts import ROOT, script_module

from quad_mpc_ros.recordings.evaluation.simulated import load_config

FINGERPRINTS = ROOT / "tools/flight_fingerprints.py"
fingerprints = script_module("tools/flight_fingerprints.py")


def test_a_flight_has_the_same_fingerprint_twice_and_another_has_another() -> None:
    fly = [fingerprints.flown("simulate", ["--duration", "0.5"], given) for given in ([], [])]
    other = fingerprints.flown("simulate", ["--duration", "0.5"], ["mpc.horizon_steps=9"])
    assert fly[0] == fly[1] != other
    assert fly[0][0] == other[0] == 25


def test_fingerprint_of_a_fault_names_who_commanded() -> None:
    name, count, digest, sources = fingerprints.fingerprint("fault_ground_reference_stops").split()
    assert name == "fault_ground_reference_stops"
    assert int(count) > 0 and len(digest) == 32 and sources == "IDLE,MPC"


def test_refused_flight_has_no_fingerprint() -> None:
    with pytest.raises(SystemExit, match=r"mpc\.mass"):
        fingerprints.flown("simulate", [], ["mpc.mass=-1"])


def test_unknown_flights_are_refused() -> None:
    ended = subprocess.run(
        [sys.executable, "-P", FINGERPRINTS, "out.txt", "--only", "nowhere"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2 and "given nowhere" in ended.stderr


def test_table_of_step_times_has_pairs_ratios_and_medians() -> None:
    compare = script_module("tools/compare_steps.py")
    times = compare.StepTimes
    pairs = [
        (times(p50=400.0, p99=1000.0), times(p50=500.0, p99=1100.0)),
        (times(p50=400.0, p99=1000.0), times(p50=400.0, p99=900.0)),
        (times(p50=200.0, p99=2000.0), times(p50=100.0, p99=1900.0)),
    ]
    lines = [line.split() for line in compare.table(pairs).splitlines()]
    assert lines[2] == ["1", "400", "500", "1.250", "1000", "1100", "1.100"]
    assert lines[-1] == ["median", "400", "400", "1.000", "1000", "1100", "0.950"]


def test_the_times_of_a_flight_have_parts() -> None:
    bench = script_module("bench/closed_loop.py")
    for assignments in bench.FLIGHTS.values():
        config = load_config(assignments=[*assignments, "simulator.duration=0.1"])
        times, steps = bench.timed(config)
        assert steps == round(0.1 * config.simulator.odom_rate)
        assert 0.0 < times.mpc < times.controller
    cells = bench.cells(
        bench.Times(fly=0.2, controller=0.15, mpc=0.1, whole=0.25), 500, duration=10.0
    )
    assert cells == ["50 x", "40 x", "400", "200", "100", "100", "100"]
