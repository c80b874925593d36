# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What tools, benches and examples import of the package is there: few of them run in tests."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(
    path for room in ("tools", "bench", "examples") for path in (ROOT / room).rglob("*.py")
)


def imported(tree: ast.Module) -> list[tuple[str, str]]:
    """Return the names that a script imports of the package, with their modules."""
    return [
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("quad_mpc_ros")
        for alias in node.names
        if node.module is not None
    ]


def lacking(tree: ast.Module) -> list[str]:
    """Return what a script imports of the package that is not there."""
    return [
        f"{module}.{name}"
        for module, name in imported(tree)
        if not (hasattr(importlib.import_module(module), name) or is_module(f"{module}.{name}"))
    ]


def is_module(name: str) -> bool:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        return False
    return True


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_of_scripts_exist(script: Path) -> None:
    try:
        assert lacking(ast.parse(script.read_text())) == []
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("quad_mpc_ros"):
            raise
        pytest.skip(f"{error.name} is not installed")


def test_detects_an_import_of_a_missing_name() -> None:
    stale = ast.parse("from quad_mpc_ros.extras.guidance import avoiding, guidance")
    assert lacking(stale) == ["quad_mpc_ros.extras.guidance.avoiding"]
