# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The time of a flight, which stands still while nothing of it is published."""

from __future__ import annotations

from quad_mpc_ros.references.timeline import FlightTime


def test_flight_time_equals_stamps_without_pause() -> None:
    time = FlightTime()
    time.resume(5)  # of what never stood still
    assert time.at(7) == 7


def test_flight_time_continues_after_pause() -> None:
    time = FlightTime()
    time.pause(100)
    time.resume(150)
    assert time.at(150) == 100
    assert time.at(160) == 110
    time.pause(160)
    time.resume(1000)
    assert time.at(1000) == 110


def test_clock_set_back_during_pause_does_not_jump() -> None:
    time = FlightTime()
    time.pause(100)
    time.resume(40)
    assert time.at(40) == 40
