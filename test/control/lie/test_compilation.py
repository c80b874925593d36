# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The compile cache: where it is, and when code is compiled again."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import quad_mpc_ros
from quad_mpc_ros.configuration import compilation

PACKAGE = Path(quad_mpc_ros.__file__).parent
ROTATE = """
from quad_mpc_ros.configuration import compilation
from quad_mpc_ros.control.lie import kernels
print(kernels.exp((0.0, 0.0, 0.0))[0], compilation.functions_compiled())
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package with rotations, and nothing compiled of it."""
    package = tmp_path / "quad_mpc_ros"
    for name in ("configuration", "control", "control/lie"):
        shutil.copytree(
            PACKAGE / name,
            package / name,
            ignore=lambda folder, names: [n for n in names if not n.endswith(".py")],
            dirs_exist_ok=True,
        )
    (package / "__init__.py").touch()
    return package


def rotating(package: Path, *, cache: Path) -> subprocess.Popen[str]:
    """Call a compiled function in a new process."""
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))}
    return subprocess.Popen(
        [sys.executable, "-c", ROTATE],
        env={**inherited, "PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(cache)},
        cwd=package.parent,
        stdout=subprocess.PIPE,
        text=True,
    )


def outcome(process: subprocess.Popen[str]) -> list[str]:
    """Return the result and how many functions were compiled for it."""
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return out.split()


def test_compiles_at_each_start_without_a_writable_cache(package: Path, tmp_path: Path) -> None:
    """As in a container with a read-only file system, and a user without a home folder."""
    (tmp_path / "cache").touch()  # a file where the folder would be: root may write everywhere
    for _ in range(2):
        result, compiled = outcome(rotating(package, cache=tmp_path / "cache"))
        assert result == "1.0"
        assert int(compiled) > 0


def test_two_processes_at_once_fill_one_cache(package: Path, tmp_path: Path) -> None:
    both = [rotating(package, cache=tmp_path / "cache") for _ in range(2)]
    assert [outcome(process)[0] for process in both] == ["1.0", "1.0"]
    assert outcome(rotating(package, cache=tmp_path / "cache")) == ["1.0", "0"]


@pytest.mark.parametrize(
    ("file", "before", "after"),
    [
        ("control/lie/formulas.py", "SMALL_ANGLE = 1e-3", "SMALL_ANGLE = 2e-3"),
        ("configuration/compilation.py", 'error_model="numpy"', 'error_model="python"'),
    ],
)
def test_compiles_again_when_another_file_changes(
    file: str, before: str, after: str, package: Path, tmp_path: Path
) -> None:
    """Also when its size and time stay the same, as after an installation."""
    outcome(rotating(package, cache=tmp_path / "cache"))
    source = package / file
    status, text = source.stat(), source.read_text()
    assert text.count(before) == 1
    source.write_text(text.replace(before, after))
    os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))
    _, compiled = outcome(rotating(package, cache=tmp_path / "cache"))
    assert int(compiled) > 0


def test_digest_covers_all_sources_of_compiled_code() -> None:
    covered = set(compilation.source_files())
    for path in PACKAGE.rglob("*.py"):
        module = ast.parse(path.read_text())
        if any(is_compiled(node) for node in ast.walk(module)):
            files = {path, *(file_of(name) for name in taken_by_compiled_code(module))}
            assert files <= covered, f"{path}: add {files - covered} to compilation.SOURCES"


def file_of(module: str) -> Path:
    """Return the file of a module of the package."""
    path = PACKAGE.joinpath(*module.split(".")[1:])
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def taken_by_compiled_code(module: ast.Module) -> Iterator[str]:
    """Yield the modules of the package from which a file's compiled functions take a name."""
    used = {
        node.id
        for function in ast.walk(module)
        if is_compiled(function)
        for node in ast.walk(function)
        if isinstance(node, ast.Name)
    }
    for node in ast.walk(module):
        if not isinstance(node, ast.ImportFrom) or node.module == compilation.__name__:
            continue
        if not (node.module or "").startswith("quad_mpc_ros."):
            continue
        for alias in node.names:
            if (alias.asname or alias.name) in used:
                within = f"{node.module}.{alias.name}"
                yield within if file_of(within).exists() else str(node.module)


def is_compiled(node: ast.AST) -> bool:
    """Whether it is ``@compiled def …`` or ``compiled(…)``."""
    if isinstance(node, ast.FunctionDef):
        return any(ast.unparse(decorator) == "compiled" for decorator in node.decorator_list)
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "compiled"
