"""The update modes: the table in the module's docstring, row by row, for all that can happen."""

from __future__ import annotations

import itertools

import pytest

from quad_mpc_ros.control.estimation import update_mode as module
from quad_mpc_ros.control.estimation.update_mode import (
    LONGEST_GAP_NS,
    Conditions,
    UpdateMode,
    update_mode,
)

TABLE = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in (module.__doc__ or "").splitlines()
    if line.startswith("| ") and "mode" not in line
]


def row_for(facts: tuple[bool, ...]) -> str:
    """Return the mode of the first row that holds."""
    for *cells, mode in TABLE:
        if all(
            not cell or (cell == "yes") == fact for cell, fact in zip(cells, facts, strict=True)
        ):
            return mode
    raise AssertionError(f"no row holds for {facts}")


@pytest.mark.parametrize("facts", itertools.product((False, True), repeat=5))
def test_table_holds(facts: tuple[bool, ...]) -> None:
    acts, flies, pauses, long, passed = facts
    expected = row_for(facts)
    paused_for = 1e-9 * LONGEST_GAP_NS * (1.5 if long else 0.5)
    for may_touch, saturated in ((True, False), (False, True), (True, True)):
        conditions = Conditions(acts, flies, may_touch and pauses)
        mode = update_mode(conditions, saturated and pauses, paused_for, passed)
        assert UpdateMode(mode).text == expected
