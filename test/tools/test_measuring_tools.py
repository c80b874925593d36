"""The tools that measure whether a change alters commands or step times."""

from __future__ import annotations

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
