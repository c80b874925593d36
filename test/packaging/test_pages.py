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

# The columns of the picture of the rooms that hold their names.
NAMES = 31
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


def test_the_picture_of_the_rooms_is_that_of_the_contract() -> None:
    """Every room of the layers in pyproject.toml, in its order, and none besides."""
    contract = (ROOT / "pyproject.toml").read_text().split("layers = [")[1].split("]")[0]
    layers = [sorted(re.findall(r"\w+", line)) for line in re.findall(r'"(.+)"', contract)]
    picture = (ROOT / "docs/architecture.md").read_text().split("```")[1]
    picture = picture.removeprefix("text\n")
    drawn = [sorted(line[:NAMES].split()) for line in picture.splitlines() if line.strip()]
    assert drawn == layers
