"""What faults do to a stream: each says what it does, and does it each time alike."""

from __future__ import annotations

import dataclasses

import numpy as np

from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.experiments.faults import distortions
from quad_mpc_ros.experiments.faults.distortions import Distortion

MS = 1_000_000
PERIOD = 20 * MS
START = 1_000_000 * MS


def odometry(stamp_ns: int) -> OdometrySample:
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=np.array([stamp_ns * 1e-9, 0.0, 2.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.array([1.0, 0.0, 0.0]),
        w_WB_B=np.zeros(3),
    )


BEFORE = odometry(START)


def arrivals(fault: Distortion[OdometrySample], count: int) -> list[tuple[int, OdometrySample]]:
    """Return what comes, and when after the beginning of the fault [ns], in that order."""
    came = [
        (k * PERIOD + delivery.delay_ns, delivery.message)
        for k in range(count)
        for delivery in fault(odometry(START + (k + 1) * PERIOD), BEFORE, k * PERIOD)
    ]
    return sorted(came, key=lambda arrival: arrival[0])


def stamps(fault: Distortion[OdometrySample], count: int) -> list[int]:
    return [(message.stamp_ns - START) // MS for _, message in arrivals(fault, count)]


def test_stamps() -> None:
    assert stamps(distortions.lost, 4) == []
    assert stamps(distortions.repeated, 3) == [0, 0, 0]
    assert stamps(distortions.frozen, 3) == [20, 40, 60]
    assert stamps(distortions.running_backwards, 3) == [-20, -40, -60]
    assert stamps(distortions.shifted_in_time(-5.0), 2) == [-4980, -4960]
    outliers = stamps(distortions.sometimes_from_the_future, 20)
    assert [k for k, stamp in enumerate(outliers) if stamp > 1000] == [0, 10]


def test_frozen_odometry_differs_in_nothing_but_the_stamp() -> None:
    for _, message in arrivals(distortions.frozen, 3):
        for field in dataclasses.fields(message):
            if field.name != "stamp_ns":
                assert np.array_equal(getattr(message, field.name), getattr(BEFORE, field.name))


def test_bursts_lose_nothing_and_come_at_once() -> None:
    came = arrivals(distortions.in_bursts(0.2), 20)
    assert [message.stamp_ns for _, message in came] == [
        START + (k + 1) * PERIOD for k in range(20)
    ]
    assert {when for when, _ in came} == {200 * MS, 400 * MS}


def test_dropouts_lose_their_share_and_the_same_ones_again() -> None:
    lost = 2000 - len(stamps(distortions.dropping(0.3), 2000))
    assert 540 < lost < 660  # three standard deviations
    assert stamps(distortions.dropping(0.3), 100) == stamps(distortions.dropping(0.3), 100)


def test_second_publisher_is_distinguished_from_the_first() -> None:
    moved = distortions.doubled(p_WB=lambda p_WB: p_WB + 1.0)
    first, second = moved(odometry(START + PERIOD), BEFORE, 0)
    assert (first.intruder, second.intruder) == (False, True)
    assert np.array_equal(second.message.p_WB, first.message.p_WB + 1.0)
