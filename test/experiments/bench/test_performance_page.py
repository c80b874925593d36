"""The published figures are those that were recorded."""

from __future__ import annotations

from fixtures.scripts import script_module


def test_published_page_holds_the_recorded_figures() -> None:
    tool = script_module("tools/update_performance.py")
    assert tool.PAGE.read_text(encoding="utf-8") == tool.page_of_record(), (
        "run tools/update_performance.py --page-only"
    )
