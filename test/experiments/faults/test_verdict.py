"""The judge of faults, shown flights that are right and flights that are wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.experiments.faults.cases import FAULTS
from quad_mpc_ros.experiments.faults.verdict import (
    Record,
    Sighting,
    command_fault,
    complaints,
    course_seen,
)

CONFIG = MpcConfig()
STOPS = FAULTS["odometry_stops"]


def silent_flight(**changes: object) -> Record:
    """Return what is seen of a lost odometry when all is as it must be."""
    times = [0.02 * k + 0.01 for k in range(150)]

    def source(time: float) -> str:
        if time > 1.7 or time <= 0.4:
            return "mpc"
        return "blind" if time <= 1.42 else "silent"

    right = Record(
        sightings=[Sighting(time=time, source=source(time)) for time in times],
        commands=[time for time in times if source(time) != "silent"],
        end=1.7,
        over=1.7,
        home=1.8,
    )
    return dataclasses.replace(right, **changes)  # type: ignore[arg-type]


def renamed(record: Record, start: float, end: float, source: str) -> Record:
    """Return a record in which another source commanded for a while."""
    return dataclasses.replace(
        record,
        sightings=[
            dataclasses.replace(seen, source=source) if start < seen.time < end else seen
            for seen in record.sightings
        ],
    )


def judged(record: Record, *, slack: float = 0.0) -> list[str]:
    return complaints(STOPS, record, CONFIG, slack=slack)


def test_correct_flight_has_no_complaint() -> None:
    assert judged(silent_flight()) == []
    assert course_seen(silent_flight()) == "blind 0.41, silent 1.43, mpc +0.01"


@pytest.mark.parametrize(
    ("start", "end", "source"),
    [
        (0.0, 0.08, "plan"),
        (0.36, 0.38, "blind"),  # too early
        (0.40, 0.44, "mpc"),  # too late, if only by a tick
        (0.40, 0.44, "plan"),
        (0.5, 0.52, "hover"),  # another rung for a tick
        (1.42, 1.7, "blind"),  # never silent
    ],
)
def test_reports_a_wrong_rung(start: float, end: float, source: str) -> None:
    assert judged(renamed(silent_flight(), start, end, source))


def test_slack_applies_to_times_only() -> None:
    late = renamed(silent_flight(), 0.40, 0.44, "mpc")
    assert judged(late, slack=0.02) == []
    assert judged(renamed(silent_flight(), 0.40, 0.49, "mpc"), slack=0.02)


def test_reports_missing_ticks() -> None:
    record = silent_flight()
    sparse = [seen for seen in record.sightings if not 0.5 < seen.time < 1.3]
    assert judged(dataclasses.replace(record, sightings=sparse)) == []
    none = [seen for seen in record.sightings if seen.source != "blind"]
    assert any("blind never seen" in message for message in judged(silent_flight(sightings=none)))


def test_reports_a_command_while_silent() -> None:
    (message,) = judged(silent_flight(commands=[0.5, 1.5]))
    assert message == "1 commands while silent"


def test_reports_a_missing_recovery() -> None:
    assert judged(renamed(silent_flight(), 2.5, 2.53, "plan"))
    assert judged(silent_flight(home=None)) == ["not back at the reference within 4 s"]
    assert judged(silent_flight(home=9.0)) == ["not back at the reference within 4 s"]
    before = [seen for seen in silent_flight().sightings if seen.time < 1.7]
    assert any("no tick after" in message for message in judged(silent_flight(sightings=before)))


def test_reports_a_fault_that_is_not_counted() -> None:
    nan = FAULTS["odometry_nan"]
    record = silent_flight(counted=0)
    assert "not counted in rejected_inputs" in complaints(nan, record, CONFIG, slack=0.0)
    counted = silent_flight(counted=3)
    assert "not counted in rejected_inputs" not in complaints(nan, counted, CONFIG, slack=0.0)


def test_reports_an_unsound_command() -> None:
    assert judged(silent_flight(unsound=["throttle 2 is out of bounds"]))


@pytest.mark.parametrize(
    ("throttle", "rates", "message"),
    [
        (0.5, (0.0, 0.0, 0.0), None),
        (1.0, CONFIG.omega_max, None),
        (float("nan"), (0.0, 0.0, 0.0), "not finite"),
        (0.5, (0.0, float("inf"), 0.0), "not finite"),
        (1.01, (0.0, 0.0, 0.0), "throttle"),
        (-0.01, (0.0, 0.0, 0.0), "throttle"),
        (0.5, (0.0, 0.0, -10.0), "body rates"),
    ],
)
def test_commands_that_must_never_be_sent(
    throttle: float, rates: tuple[float, ...], message: str | None
) -> None:
    command = CommandSample(stamp_ns=1, throttle=throttle, w_WB_B=np.array(rates))
    fault = command_fault(command, CONFIG)
    assert (fault is None) if message is None else (fault is not None and message in fault)


def test_accepts_the_plan_while_the_machine_delivers_no_odometry() -> None:
    """And only there: neither before the timeout nor once odometry is back, nor another rung."""
    flight = renamed(silent_flight(), 2.13, 2.18, "plan")  # ticks at 2.15 and 2.17
    starved = [(1.8, 1.82), (2.04, 2.16)]
    assert judged(flight)
    assert judged(dataclasses.replace(flight, starved=starved)) == []
    for wrong in ([(2.06, 2.16)], [(2.04, 2.14)], []):
        assert judged(dataclasses.replace(flight, starved=wrong))
    hover = renamed(silent_flight(), 2.13, 2.18, "hover")
    assert judged(dataclasses.replace(hover, starved=starved))
