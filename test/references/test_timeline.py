"""The time of a flight, which stands still while nothing of it is published."""

from __future__ import annotations

from quad_mpc_ros.references.timeline import FlightTime


def test_it_is_that_of_the_stamps_without_a_pause() -> None:
    time = FlightTime()
    time.resume(5)  # of what never stood still
    assert time.at(7) == 7


def test_it_goes_on_where_it_stopped() -> None:
    time = FlightTime()
    time.pause(100)
    time.resume(150)
    assert time.at(150) == 100
    assert time.at(160) == 110
    time.pause(160)
    time.resume(1000)
    assert time.at(1000) == 110


def test_a_clock_that_was_set_back_meanwhile_does_not_jump_ahead() -> None:
    time = FlightTime()
    time.pause(100)
    time.resume(40)
    assert time.at(40) == 40
