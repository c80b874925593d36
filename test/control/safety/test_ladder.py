# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios of the failsafe: inputs over time and the expected source of commands."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.safety import ladder

MS = 1_000_000
START = 5_000_000_000
MPC, PLAN, HOVER, IDLE, BLIND, SILENT, WAITING = (
    "MPC",
    "PLAN",
    "HOVER",
    "IDLE",
    "BLIND",
    "SILENT",
    "WAITING",
)
FAILED = "solver: failed"


class Flight:
    """A ladder with a timeout of 100 ms for odometry, and so on.

    Without odometry the state is predicted for 400 ms.
    """

    def __init__(self, *, plan_hold: int = 200, blind: int = 1000) -> None:
        self._state = ladder.LadderState()
        self._timeouts = ladder.Timeouts(
            odometry=100 * MS,
            gap=400 * MS,
            plan_hold=plan_hold * MS,
            blind=blind * MS,
        )

    def decide(
        self,
        at: float,
        *,
        odometry: float | None = None,
        fault: str = "",
        breach: tuple[str, str] | None = None,
        on_ground: bool = False,
        predicted: bool = False,
        never: bool = False,
    ) -> tuple[str, str]:
        """Decide at a time [ms] with inputs that last came at the given times, or just now.

        With ``never`` no odometry has come. Returns the source and the reason.
        """

        def stamp(time: float | None) -> int:
            return START + round((at if time is None else time) * MS)

        broken = None
        if breach is not None:
            broken = ladder.Breach(ladder.Action[breach[0]], breach[1])
        decision, self._state = ladder.decide(
            ladder.LadderInputs(
                now_ns=stamp(None),
                odometry_ns=None if never else stamp(odometry),
                plan_fault=fault,
                breach=broken,
                on_ground=on_ground,
                is_predicted=predicted,
            ),
            self._state,
            self._timeouts,
        )
        return decision.source.name, decision.reason

    def follow(self, expected: Iterable[tuple[float, str]], **known: Any) -> None:
        """Decide at each time and compare the source."""
        for at, source in expected:
            assert (at, self.decide(at, **known)[0]) == (at, source)


def test_waits_before_the_first_plan() -> None:
    for known, reason in (
        ({"never": True}, "no odometry yet"),
        ({"fault": FAILED}, FAILED),
        ({"odometry": 0, "fault": FAILED}, FAILED),
        ({"never": True, "fault": FAILED}, "no odometry yet"),
        ({"fault": FAILED, "breach": ("STOP", "out")}, FAILED),
        ({"fault": FAILED, "breach": ("HOVER", "out"), "on_ground": True}, FAILED),
    ):
        flight = Flight()
        for at in (0, 50, 90):
            assert flight.decide(at, **known) == (WAITING, reason)  # type: ignore[arg-type]
        # A breach before the first plan does not stop the vehicle for good.
        assert flight.decide(100) == (MPC, "")


def test_a_failing_solver_leads_to_the_plan_then_hover() -> None:
    flight = Flight()
    flight.decide(0)
    for at, source in ((20, PLAN), (200, PLAN), (200.000001, HOVER), (60_000, HOVER)):
        assert flight.decide(at, fault=FAILED) == (source, FAILED)
    assert flight.decide(60_020) == (MPC, "")
    flight.follow([(60_220, PLAN), (60_221, HOVER)], fault=FAILED)


def test_lost_odometry_passes_every_level_and_recovers() -> None:
    flight = Flight()
    for begin in (0, 60_000):
        assert flight.decide(begin) == (MPC, "")
        expected = (
            (100, PLAN, FAILED),  # still young enough, so it is not what fails
            (100.000001, PLAN, "odometry is 0.10 s old"),
            (200, PLAN, "odometry is 0.20 s old"),
            (220, BLIND, "odometry is 0.22 s old"),
            (1220, BLIND, "odometry is 1.22 s old"),
            (1220.000001, SILENT, "odometry is 1.22 s old"),
            (50_000, SILENT, "odometry is 50.00 s old"),
        )
        for at, source, reason in expected:
            decision = flight.decide(begin + at, odometry=begin, fault=FAILED)
            assert (at, *decision) == (at, source, reason)


def test_predicted_state_does_not_extend_plan_timeout() -> None:
    flight = Flight()
    flight.decide(0)
    assert flight.decide(120, odometry=0, predicted=True) == (
        MPC,
        "odometry is late: predicted",
    )
    flight.follow([(200, MPC), (400, MPC)], odometry=0, predicted=True)
    assert flight.decide(401, odometry=0, predicted=True) == (BLIND, "odometry is 0.40 s old")
    flight.follow([(1401, BLIND), (1402, SILENT)], odometry=0, fault=FAILED)
    assert flight.decide(1500) == (MPC, "")


def test_failed_prediction_falls_back_to_held_plan() -> None:
    flight = Flight()
    flight.decide(0)
    flight.follow([(120, MPC)], odometry=0, predicted=True)
    flight.follow([(140, PLAN), (200, PLAN), (220, BLIND)], odometry=0, fault=FAILED)
    flight = Flight(plan_hold=450)
    flight.decide(0)
    flight.follow([(400, MPC), (440, PLAN), (460, BLIND)], odometry=0, predicted=True)
    flight = Flight()
    flight.decide(0)
    assert flight.decide(110, odometry=0, fault=FAILED, predicted=True) == (PLAN, FAILED)


def test_hovers_when_odometry_returns_without_a_plan() -> None:
    flight = Flight()
    flight.decide(0)
    flight.decide(900, odometry=0, fault=FAILED)
    assert flight.decide(1000, fault=FAILED) == (HOVER, FAILED)
    # The blind time starts again.
    flight.follow([(1900, BLIND), (2900, BLIND), (2901, SILENT)], odometry=1000, fault=FAILED)


def test_skips_a_level_with_zero_timeout() -> None:
    flight = Flight(plan_hold=0)
    flight.follow([(0, MPC)])
    flight.follow([(1, HOVER)], fault=FAILED)
    flight = Flight(blind=0)
    flight.follow([(0, MPC)])
    flight.follow([(300, BLIND), (300.000001, SILENT)], odometry=0)


def test_a_clock_set_back_extends_no_timeout() -> None:
    flight = Flight()
    flight.decide(10_000)
    assert flight.decide(9_950, odometry=10_000) == (MPC, "")  # jitter
    flight.decide(10_000)
    assert flight.decide(5_000, odometry=10_000) == (BLIND, "odometry is -5.00 s old")
    assert flight.decide(5_020, fault=FAILED) == (HOVER, FAILED)
    assert flight.decide(5_040) == (MPC, "")


def test_idles_on_the_ground_instead_of_hovering() -> None:
    flight = Flight()
    assert flight.decide(0, on_ground=True) == (MPC, "")
    # At once, for the plan may take off later.
    flight.follow([(20, IDLE), (201, IDLE), (90_000, IDLE)], fault=FAILED, on_ground=True)
    assert flight.decide(90_020, fault=FAILED) == (HOVER, FAILED)
    assert flight.decide(90_040, breach=("HOVER", "out"), on_ground=True) == (IDLE, "out")


def test_idles_on_the_ground_without_odometry_then_stops() -> None:
    flight = Flight()
    flight.decide(0, on_ground=True)
    expected = [(101, IDLE), (201, IDLE), (1201, IDLE), (1202, SILENT)]
    flight.follow(expected, odometry=0, on_ground=True)


def test_hovers_outside_a_limit_until_inside() -> None:
    flight = Flight()
    out = ("HOVER", "out")
    assert flight.decide(0, breach=out) == (HOVER, "out")
    assert flight.decide(20, breach=out, fault=FAILED) == (HOVER, "out")  # not the plan
    assert flight.decide(40) == (MPC, "")
    # A limit exceeded by the last odometry does not count once odometry is lost.
    assert flight.decide(141, breach=out, odometry=40)[0] == PLAN
    assert flight.decide(241, breach=out, odometry=40)[0] == BLIND


def test_a_stop_is_final() -> None:
    flight = Flight()
    flight.decide(0)
    assert flight.decide(20, breach=("STOP", "far out")) == (SILENT, "far out")
    assert flight.decide(40) == (SILENT, "far out")
    assert flight.decide(60, breach=("STOP", "farther")) == (SILENT, "far out")
    assert flight.decide(80, breach=("HOVER", "out"), fault=FAILED) == (SILENT, "far out")
    assert flight.decide(100_000, odometry=100, on_ground=True) == (SILENT, "far out")
    assert flight.decide(200_000) == (SILENT, "far out")


def test_descends_for_the_blind_time_then_falls_silent_until_the_contradiction_ends() -> None:
    flight = Flight()
    wrong = ("DESCEND", "odometry and commands disagree")
    flight.decide(0)
    assert flight.decide(20, breach=wrong) == (BLIND, wrong[1])
    assert flight.decide(40, breach=wrong, fault=FAILED) == (BLIND, wrong[1])  # not the plan
    assert flight.decide(60, breach=wrong, on_ground=True) == (IDLE, wrong[1])
    assert flight.decide(500, breach=wrong, odometry=40) == (BLIND, wrong[1])
    flight.follow([(1020, BLIND), (1021, SILENT), (90_000, SILENT)], breach=wrong)
    assert flight.decide(90_020) == (MPC, "")


def test_plan_hold_time_counts_from_the_last_valid_plan() -> None:
    """Also when a limit kept it from being flown."""
    flight = Flight()
    flight.decide(0)
    flight.decide(150, breach=("HOVER", "out"))
    flight.follow([(340, PLAN), (351, HOVER)], fault=FAILED)


def test_without_a_gap_odometry_is_lost_at_its_timeout() -> None:
    off = MpcConfig(odom_timeout=0.125, odom_gap=0.0)
    assert ladder.timeouts_of(off).gap == 125 * MS


_MOMENT = st.fixed_dictionaries(
    {
        "wait": st.integers(0, 400),
        "odometry_age": st.one_of(st.integers(0, 150), st.integers(350, 450)),
        "predicted": st.booleans(),
        "fault": st.sampled_from(["", FAILED]),
        "breach": st.sampled_from(
            [None, ("WARN", "high"), ("HOVER", "out"), ("DESCEND", "wrong"), ("STOP", "far")]
        ),
        "on_ground": st.booleans(),
    }
)


@settings(max_examples=300, deadline=None)
@given(moments=st.lists(_MOMENT, min_size=1, max_size=20))
def test_invariants_hold_in_random_scenarios(moments: list[dict[str, Any]]) -> None:
    """The invariants hold at every moment, whatever the history."""
    flight, at, stopped, flown = Flight(), 0, False, False
    for moment in moments:
        at += moment["wait"]
        predicted = moment["predicted"] and flown
        source, reason = flight.decide(
            at,
            odometry=at - moment["odometry_age"],
            fault=moment["fault"],
            breach=moment["breach"],
            on_ground=moment["on_ground"],
            predicted=predicted,
        )
        sighted = moment["odometry_age"] <= 100
        known = sighted or (predicted and moment["odometry_age"] <= 400)
        well = known and not moment["fault"]
        flown = flown or well
        action = moment["breach"][0] if moment["breach"] and flown else ""
        if not sighted and action != "DESCEND":
            action = ""
        stopped = stopped or action == "STOP"
        assert (source == WAITING) == (not flown)
        assert not (stopped and source != SILENT)
        descends = action == "DESCEND"
        assert (source == MPC) == (well and not stopped and not descends and action != "HOVER")
        assert source not in (HOVER, MPC) or sighted or (source == MPC and known)
        assert source != BLIND or not sighted or descends
        assert not descends or source in (BLIND, IDLE, SILENT)
        assert source != IDLE or moment["on_ground"]
        assert reason or (source == MPC and action != "WARN")
