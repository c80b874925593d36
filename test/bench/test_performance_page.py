"""The published figures are those that were recorded."""

from __future__ import annotations

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_published_page_holds_the_recorded_figures() -> None:
    spec = importlib.util.spec_from_file_location(
        "update_performance", ROOT / "tools" / "update_performance.py"
    )
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)

    assert tool.PAGE.read_text(encoding="utf-8") == tool.page_of_record(), (
        "run tools/update_performance.py --page-only"
    )
