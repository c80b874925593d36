"""What an odometry may change, by what happened since the odometry before."""

from __future__ import annotations

import pytest

from quad_mpc_ros.control.estimation.update_mode import (
    LONGEST_GAP_NS,
    Conditions,
    UpdateMode,
    update_mode,
)

FREE_FLIGHT = Conditions(acts=True, is_flying=True, may_touch=False)
NEAR_GROUND = FREE_FLIGHT._replace(may_touch=True)


def mode(conditions: Conditions, *, saturated: bool = False, gaps: float = 0.5) -> UpdateMode:
    """Return the mode after a pause of so many times the longest gap."""
    return UpdateMode(update_mode(conditions, saturated, gaps * 1e-9 * LONGEST_GAP_NS))


def test_learns_in_free_flight() -> None:
    assert mode(FREE_FLIGHT) is UpdateMode.LEARN
    assert mode(FREE_FLIGHT, gaps=1.5) is UpdateMode.LEARN


@pytest.mark.parametrize("lacking", ["acts", "is_flying"])
def test_holds_without_acting_commands_or_flight(lacking: str) -> None:
    assert mode(FREE_FLIGHT._replace(**{lacking: False})) is UpdateMode.HOLD


@pytest.mark.parametrize(
    ("conditions", "saturated"),
    [(NEAR_GROUND, False), (FREE_FLIGHT, True), (NEAR_GROUND, True)],
)
def test_learns_nothing_near_the_ground_or_saturated_and_holds_after_long(
    conditions: Conditions, saturated: bool
) -> None:
    assert mode(conditions, saturated=saturated) is UpdateMode.VELOCITY_ONLY
    assert mode(conditions, saturated=saturated, gaps=1.5) is UpdateMode.HOLD
