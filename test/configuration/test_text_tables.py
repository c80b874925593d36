"""Tables for people: columns that are aligned, text beside a label, Markdown."""

from __future__ import annotations

from quad_mpc_ros.configuration.text_tables import labelled, markdown_table, text_table


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
    assert text_table(rows, align="lrl", widths=(6, 5, 0), gap="") == [
        "drag               0.31/s",
        "a very long label    1",
    ]


def test_text_is_wrapped_beside_its_label() -> None:
    assert labelled("who", "one two three", indent=5, width=12) == ["who  one two", "     three"]
    assert labelled("nobody ", "", indent=5, width=12) == ["nobody"]


def test_markdown_has_a_rule_and_keeps_bars_in_their_cells() -> None:
    assert markdown_table(("name", "range"), [("a", "x | y")], align="lr").splitlines() == [
        "| name | range |",
        "|---|---:|",
        "| a | x \\| y |",
    ]
    assert markdown_table(("name",), []).splitlines()[1] == "|---|"
