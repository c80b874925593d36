"""Tables of plain text: columns are aligned."""

from __future__ import annotations

from quad_mpc_ros.configuration.text_tables import text_table


def test_a_column_is_as_wide_as_its_widest_cell() -> None:
    rows = [("", "p50", "max"), ("a step", "300", "1200"), (), ("b", "-", "7")]
    assert text_table(rows, align="lrr") == [
        "        p50   max",
        "a step  300  1200",
        "",
        "b         -     7",
    ]


def test_columns_have_a_least_width() -> None:
    rows = [("drag", "0.3", "1/s"), ("a very long label", "1", "")]
    assert text_table(rows, align="lrl", widths=(6, 5, 0), gap=" ") == [
        "drag                0.3 1/s",
        "a very long label     1",
    ]
