# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The judgement of fault flights, on records that are right and records that are wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fixtures.faults.cases import FAULTS
from fixtures.faults.verdict import Record, Sighting, command_fault, complaints

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample

CONFIG = MpcConfig()


def silent_flight(**changes: object) -> Record:
    """Return the correct record of a lost odometry."""
    times = [0.02 * k + 0.01 for k in range(150)]

    def source(time: float) -> str:
        if time > 1.7 or time <= 0.4:
            return "mpc"
        return "blind" if time <= 1.42 else "silent"

    right = Record(
        sightings=[Sighting(time=time, source=source(time)) for time in times],
        commands=[time for time in times if source(time) != "silent"],
        end=1.7,
        home=1.8,
    )
    return dataclasses.replace(right, **changes)  # type: ignore[arg-type]


def with_source(start: float, end: float, source: str) -> Record:
    """Return the record with another source in command for a while."""
    record = silent_flight()
    return dataclasses.replace(
        record,
        sightings=[
            dataclasses.replace(seen, source=source) if start < seen.time < end else seen
            for seen in record.sightings
        ],
    )


def judged(record: Record, fault: str = "odometry_stops") -> list[str]:
    return complaints(FAULTS[fault], record, CONFIG)


def test_accepts_the_expected_levels() -> None:
    assert judged(silent_flight()) == []


@pytest.mark.parametrize(
    ("start", "end", "source"),
    [
        (0.0, 0.08, "plan"),
        (0.36, 0.38, "blind"),  # too early
        (0.40, 0.44, "mpc"),  # too late, if only by a tick
        (0.5, 0.52, "hover"),  # another level for a tick
        (1.42, 1.7, "blind"),  # never silent
        (2.5, 2.53, "plan"),  # after the recovery
    ],
)
def test_reports_a_wrong_level(start: float, end: float, source: str) -> None:
    assert judged(with_source(start, end, source))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"sightings": [seen for seen in silent_flight().sightings if seen.source != "blind"]},
            "blind never seen",
        ),
        ({"commands": [0.5, 1.5]}, "1 commands while silent"),
        ({"home": None}, "not back at the reference within 4 s"),
        ({"home": 9.0}, "not back at the reference within 4 s"),
    ],
)
def test_reports_a_wrong_record(changes: dict[str, object], message: str) -> None:
    assert any(message in complaint for complaint in judged(silent_flight(**changes)))


def test_reports_a_fault_that_is_not_counted() -> None:
    uncounted = "not counted in rejected_inputs"
    assert uncounted in judged(silent_flight(counted=0), "odometry_nan")
    assert uncounted not in judged(silent_flight(counted=3), "odometry_nan")


@pytest.mark.parametrize(
    ("throttle", "rates", "message"),
    [
        (1.0, CONFIG.omega_max, None),
        (float("nan"), (0.0, 0.0, 0.0), "not finite"),
        (0.5, (0.0, float("inf"), 0.0), "not finite"),
        (1.01, (0.0, 0.0, 0.0), "throttle"),
        (-0.01, (0.0, 0.0, 0.0), "throttle"),
        (0.5, (0.0, 0.0, -10.0), "body rates"),
    ],
)
def test_reports_a_command_that_must_never_be_sent(
    throttle: float, rates: tuple[float, ...], message: str | None
) -> None:
    command = CommandSample(stamp_ns=1, throttle=throttle, w_WB_B=np.array(rates))
    fault = command_fault(command, CONFIG)
    assert (fault is None) if message is None else (fault is not None and message in fault)
