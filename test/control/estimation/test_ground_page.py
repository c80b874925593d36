"""The page on the ground shows the transitions and the constants that the code has."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest

from quad_mpc_ros.control.estimation import (
    crash,
    ground_detector,
    ground_motion,
    ground_state,
    kept_height,
)
from quad_mpc_ros.references import touchdown

ROOT = Path(__file__).resolve().parents[3]
MODULES = (ground_state, kept_height, crash, ground_detector, ground_motion, touchdown)
PAGE = (ROOT / "docs" / "ground.md").read_text(encoding="utf-8")


def rows_below(heading: str) -> list[list[str]]:
    """Return the cells of the table that begins with a line."""
    after = PAGE.split(f"| {heading} |\n", 1)[1].splitlines()
    lines = [line for line in after[1:] if line.startswith("|") or not line]
    table = lines[: lines.index("")] if "" in lines else lines
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def test_the_page_shows_the_transitions() -> None:
    shown = rows_below("from | evidence | | to")
    assert shown == [
        [
            f"`{row.state.value}`",
            row.evidence.name.lower(),
            "there is" if row.present else "no more",
            f"`{row.then.value}`",
        ]
        for row in ground_state.TRANSITIONS
    ]


class Constant(NamedTuple):
    file: str
    name: str
    value: float


def constants(module: ModuleType) -> set[Constant]:
    """Return the numbers that a module gives names."""
    assert module.__file__ is not None
    tree, file = ast.parse(Path(module.__file__).read_text(encoding="utf-8")), module.__name__
    names = {
        each.id
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        for each in ast.walk(target)
        if isinstance(each, ast.Name)
    }
    values = {name: getattr(module, name) for name in names}
    return {
        Constant(file.rpartition(".")[2], name, value * (1e-9 if name.endswith("_NS") else 1.0))
        for name, value in values.items()
        if isinstance(value, int | float)
    }


def test_the_page_shows_the_constants() -> None:
    rows = rows_below("file | name | value | unit | from | noticed by")
    shown = {Constant(row[0], row[1].strip("`"), float(row[2])) for row in rows}
    there = {each for module in MODULES for each in constants(module)}
    assert {each[:2] for each in shown} == {each[:2] for each in there}
    values = {each[:2]: each.value for each in there}
    for each in shown:
        assert values[each[:2]] == pytest.approx(each.value), each
    for row in rows:
        assert all(row[k] for k in (4, 5)), row


def test_the_tests_that_the_page_names_exist() -> None:
    files = [*(ROOT / "test").rglob("test_*.py")]
    known = set(re.findall(r"def (test_\w+)", "".join(f.read_text("utf-8") for f in files)))
    assert set(re.findall(r"`(test_\w+)`", PAGE)) <= known
