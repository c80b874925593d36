"""Standing on the ground is told from flying by rest and lift over some time."""

from __future__ import annotations

import pytest

from quad_mpc_ros.estimation.contact import GroundContact, airborne

MS = 1_000_000


def judged(ground: GroundContact, times: range, *, speed: float, lift: float) -> list[bool]:
    return [ground.update(speed=speed, lift=lift, now_ns=at * MS) for at in times]


def test_at_rest_without_lift_it_stands_after_a_while() -> None:
    ground = GroundContact()
    judgements = judged(ground, range(0, 600, 20), speed=0.0, lift=0.1)
    assert judgements == [False] * 16 + [True] * 14


@pytest.mark.parametrize(("speed", "lift"), [(0.0, 1.0), (2.0, 0.1), (0.2, 0.0), (0.0, 0.7)])
def test_hovering_falling_and_touching_down_are_not_standing(speed: float, lift: float) -> None:
    assert not any(judged(GroundContact(), range(0, 5000, 20), speed=speed, lift=lift))


def test_the_top_of_a_throw_is_not_standing() -> None:
    """Without thrust a vehicle is as slow as at rest for 20 ms, not for 300."""
    ground = GroundContact()
    for at in range(-1000, 1000, 20):
        speed = abs(9.81e-3 * at)
        assert not ground.update(speed=speed, lift=0.0, now_ns=at * MS)


def test_it_stands_until_it_moves_or_has_been_lifted_for_a_while() -> None:
    ground = GroundContact()
    judged(ground, range(0, 600, 20), speed=0.0, lift=0.1)
    assert ground.update(speed=0.0, lift=0.9, now_ns=600 * MS)  # spinning up
    assert judged(ground, range(620, 920, 20), speed=0.0, lift=1.0) == [True] * 15
    assert judged(ground, range(920, 1220, 20), speed=0.0, lift=1.0)[-1] is False
    assert not ground.update(speed=0.0, lift=0.1, now_ns=1240 * MS)

    judged(ground, range(1260, 1900, 20), speed=0.0, lift=0.1)
    assert not ground.update(speed=0.2, lift=0.5, now_ns=1900 * MS)
    assert not ground.update(speed=0.0, lift=0.1, now_ns=1920 * MS)


def judged_airborne(before: float, count: int, *, speed: float, lift: float) -> list[float]:
    """Return what is said every 20 ms."""
    said = []
    for _ in range(count):
        before = airborne(before, speed**2, 9.81 * lift, 9.81, 0.02)
        said.append(before)
    return said


def test_what_has_not_been_seen_to_fly_stands() -> None:
    assert judged_airborne(0.0, 50, speed=0.0, lift=0.9) == [0.0] * 50
    assert judged_airborne(0.0, 1, speed=0.0, lift=0.96) == [1.0]
    assert judged_airborne(0.0, 1, speed=0.11, lift=0.0) == [1.0]


def test_what_flew_has_landed_after_a_while_at_rest_with_too_little_lift() -> None:
    said = judged_airborne(1.0, 15, speed=0.05, lift=0.5)
    assert all(0.0 < share < 1.0 for share in said[:12])
    assert said[12:] == [0.0] * 3
    # Unless it is lifted or moves in between.
    assert judged_airborne(said[5], 1, speed=0.0, lift=0.7) == [1.0]
    assert judged_airborne(said[5], 1, speed=0.2, lift=0.0) == [1.0]
