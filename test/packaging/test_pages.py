"""What the pages for developers name is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "CONTRIBUTING.md",
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if "build" not in path.parts),
]

# The bridge that CONTRIBUTING.md adds as an example.
IMAGINED = "kite"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_of_the_package_that_a_page_names_are_there(page: Path) -> None:
    named = re.findall(r"`((?:[a-z_0-9]+/)+[a-z_0-9]+\.(?:py|yaml))`", page.read_text())
    missing = {
        name
        for name in named
        if IMAGINED not in name
        and not any((folder / name).exists() for folder in (ROOT, ROOT / "quad_mpc_ros"))
    }
    assert not missing
