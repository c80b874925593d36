# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of plain text."""

from __future__ import annotations

from quad_mpc_ros.configuration.text_tables import text_table


def test_columns_stay_apart_and_aligned_where_cells_are_wider_than_their_column() -> None:
    rows = [
        ["vehicle", "error [m]", "why"],
        ["uav1", "0.5", "-"],
        [],
        ["a_vehicle_with_a_long_name", "12345678.25", "crashed"],
    ]
    assert text_table(rows, align="lrl", widths=[9, 9, 3]) == [
        "vehicle                       error [m]  why",
        "uav1                                0.5  -",
        "",
        "a_vehicle_with_a_long_name  12345678.25  crashed",
    ]
    assert text_table([["a", "1"]], align="lr", widths=[3, 4]) == ["a       1"]
