# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The lines of Python of each part stay within the budgets of pyproject.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HEADER = ("# Copyright ", "# SPDX-License-Identifier: ")
"""Begin of the lines on the licence, which are not counted."""
BUDGETS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["quad_mpc_ros"]["lines"]


def lines_below(*places: str) -> int:
    """Return the lines of all Python files in folders and files, relative to the checkout."""
    files: set[Path] = set()
    for place in places:
        path = ROOT / place
        assert path.exists(), f"{place}: no such file or folder, named in pyproject.toml"
        files.update([path] if path.is_file() else path.rglob("*.py"))
    lines = (line for file in files for line in file.read_text().splitlines())
    return sum(not line.startswith(HEADER) for line in lines)


@pytest.mark.parametrize("part", BUDGETS["parts"])
def test_a_part_stays_within_its_budget(part: str) -> None:
    budget = BUDGETS["parts"][part]
    lines = lines_below(*budget["places"]) - lines_below(*budget.get("without", ()))
    assert lines <= budget["most"], f"{part} has {lines} lines; remove code, or a whole concept"


def test_the_package_and_its_tests_stay_within_their_budgets() -> None:
    package = lines_below("quad_mpc_ros")
    assert package <= BUDGETS["package"]
    assert lines_below("test") <= BUDGETS["tests_per_line"] * package
