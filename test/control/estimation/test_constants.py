"""Every constant of the estimation stands in docs/estimation.md, with the value of the code."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
ROOM = ROOT / "quad_mpc_ros" / "control" / "estimation"
LINES = (ROOT / "docs" / "estimation.md").read_text().split("## Constants")[-1].splitlines()
ROWS = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in LINES if "| `" in line]
FILES = sorted({row[0] for row in ROWS})
OF_THE_GROUND = {
    "crash",
    "ground_detector",
    "ground_motion",
    "ground_state",
    "kept_height",
}
# What names a unit or a place in the state is no choice.
NO_CHOICE = {"_SECOND", "MOTION", "TURNING", "ROLL_PITCH", "YAW"}
NO_CHOICE |= {"LEARNED_OF_MOTION"}


def module(file: str) -> Any:
    return importlib.import_module(f"quad_mpc_ros.control.estimation.{file}")


@pytest.mark.parametrize(("file", "name", "value"), [row[:3] for row in ROWS])
def test_value_is_that_of_the_code(file: str, name: str, value: str) -> None:
    assert getattr(module(file), name) == ast.literal_eval(value)


def test_every_file_is_in_the_table() -> None:
    with_numbers = {path.stem for path in ROOM.glob("*.py") if constants(path)}
    assert with_numbers - OF_THE_GROUND == set(FILES)


@pytest.mark.parametrize("file", FILES)
def test_every_constant_is_in_the_table(file: str) -> None:
    assert constants(ROOM / f"{file}.py") == {row[1] for row in ROWS if row[0] == file}


def constants(path: Path) -> set[str]:
    """Return the names that a file gives at its top to expressions with numbers."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and any(
            isinstance(each, ast.Constant) and isinstance(each.value, int | float)
            for each in ast.walk(node.value)
        ):
            for target in node.targets:
                found |= {each.id for each in ast.walk(target) if isinstance(each, ast.Name)}
    return found - NO_CHOICE
