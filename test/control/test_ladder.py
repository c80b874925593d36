"""The rungs of the safety ladder in the order of time."""

from __future__ import annotations

import dataclasses

import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.ladder import Decision, SafetyLadder, Source

MS = 1_000_000
START = 5_000_000_000


@pytest.fixture
def config(paper_config: MpcConfig) -> MpcConfig:
    return dataclasses.replace(
        paper_config,
        odom_timeout=0.1,
        reference_timeout=0.5,
        plan_hold_time=0.2,
        blind_time=1.0,
    )


class Flight:
    """A ladder with inputs that arrive until they are stopped; times in ms."""

    def __init__(self, config: MpcConfig) -> None:
        self._ladder = SafetyLadder(config)

    def decide(
        self,
        at: float,
        *,
        odometry: float | None = None,
        reference: float | None = None,
        fault: str | None = None,
    ) -> Decision:
        """Decide with inputs that last came at the given times, by default just now."""

        def stamp(time: float | None) -> int:
            return START + round((at if time is None else time) * MS)

        return self._ladder.decide(
            now_ns=stamp(None),
            odometry_ns=stamp(odometry),
            reference_ns=stamp(reference),
            solver_fault=fault,
        )


@pytest.fixture
def flight(config: MpcConfig) -> Flight:
    return Flight(config)


def test_all_well_is_the_mpc(flight: Flight) -> None:
    assert flight.decide(0) == Decision(source=Source.MPC, reason="")


@pytest.mark.parametrize(
    ("odometry_ns", "reference_ns", "fault", "reason"),
    [
        (None, START, None, "no odometry yet"),
        (START, None, None, "no reference yet"),
        (START, START, "solver: maximum iterations reached", "maximum iterations"),
    ],
)
def test_before_the_first_plan_it_waits(
    config: MpcConfig,
    odometry_ns: int | None,
    reference_ns: int | None,
    fault: str | None,
    reason: str,
) -> None:
    ladder = SafetyLadder(config)
    for late in (0, 50 * MS, 10_000 * MS):
        decision = ladder.decide(
            now_ns=START + late,
            odometry_ns=None if odometry_ns is None else odometry_ns + late,
            reference_ns=None if reference_ns is None else reference_ns + late,
            solver_fault=fault,
        )
        assert decision.source is Source.WAITING
        assert reason in decision.reason


def test_a_failing_solver_means_the_plan_then_hover(flight: Flight) -> None:
    flight.decide(0)
    for at, source in ((20, Source.PLAN), (200, Source.PLAN), (201, Source.HOVER)):
        decision = flight.decide(at, fault="solver: failed")
        assert decision == Decision(source=source, reason="solver: failed")
    assert flight.decide(60_000, fault="solver: failed").source is Source.HOVER
    assert flight.decide(60_020).source is Source.MPC


def test_a_silent_reference_means_the_plan_then_hover(flight: Flight) -> None:
    flight.decide(500, reference=0)
    assert flight.decide(501, reference=0).source is Source.PLAN
    assert "reference is 0.60 s old" in flight.decide(600, reference=0).reason
    assert flight.decide(701, reference=0).source is Source.HOVER
    assert flight.decide(5000).source is Source.MPC


def test_lost_odometry_goes_down_every_rung_and_comes_back(flight: Flight) -> None:
    assert flight.decide(0).source is Source.MPC
    expected = (
        (100, Source.PLAN),
        (101, Source.PLAN),
        (200, Source.PLAN),
        (220, Source.BLIND),
        (1220, Source.BLIND),
        (1221, Source.SILENT),
        (60_000, Source.SILENT),
    )
    for at, source in expected:
        decision = flight.decide(at, odometry=0, fault="not run")
        assert decision.source is source, at
        assert decision.reason
    assert flight.decide(60_020).source is Source.MPC
    # The whole ladder is there again.
    assert flight.decide(60_150, odometry=60_020, fault="not run").source is Source.PLAN
    assert flight.decide(60_230, odometry=60_020, fault="not run").source is Source.BLIND
    assert flight.decide(61_230, odometry=60_020, fault="not run").source is Source.BLIND
    assert flight.decide(61_240, odometry=60_020, fault="not run").source is Source.SILENT


def test_odometry_that_returns_without_a_solver_is_enough_to_hover(flight: Flight) -> None:
    flight.decide(0)
    flight.decide(900, odometry=0, fault="not run")
    assert flight.decide(1000, fault="solver: failed").source is Source.HOVER
    # Blindness is counted afresh.
    assert flight.decide(1900, odometry=1000, fault="not run").source is Source.BLIND
    assert flight.decide(2900, odometry=1000, fault="not run").source is Source.BLIND
    assert flight.decide(2901, odometry=1000, fault="not run").source is Source.SILENT


def test_hover_goes_blind_when_odometry_stops_too(flight: Flight) -> None:
    flight.decide(0)
    assert flight.decide(400, fault="solver: failed").source is Source.HOVER
    assert flight.decide(500, odometry=400, fault="not run").source is Source.HOVER
    assert flight.decide(501, odometry=400, fault="not run").source is Source.BLIND


def test_the_first_reason_is_the_one_told(flight: Flight) -> None:
    flight.decide(0)
    assert "odometry is 0.15 s old" in flight.decide(150, odometry=0, fault="not run").reason


@pytest.mark.parametrize("name", ["plan_hold_time", "blind_time"])
def test_a_rung_of_no_time_is_skipped(config: MpcConfig, name: str) -> None:
    flight = Flight(dataclasses.replace(config, **{name: 0.0}))
    flight.decide(0)
    if name == "plan_hold_time":
        assert flight.decide(1, fault="solver: failed").source is Source.HOVER
    else:
        flight.decide(300, odometry=0, fault="not run")
        assert flight.decide(301, odometry=0, fault="not run").source is Source.SILENT


def test_rungs_are_ordered_by_their_distance_from_normal() -> None:
    assert Source.MPC < Source.PLAN < Source.HOVER < Source.BLIND < Source.SILENT
