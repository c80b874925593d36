"""What is compiled by Numba, kept on disk, and taken from there again."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import quad_mpc_ros

PACKAGE = Path(quad_mpc_ros.__file__).parent


def test_nowhere_to_write_is_no_reason_to_fail(tmp_path: Path) -> None:
    """As in a container whose file system is read-only and whose user has no home."""
    package = tmp_path / "quad_mpc_ros"
    package.mkdir()
    for name in ("__init__.py", "compilation.py"):
        shutil.copy(PACKAGE / name, package)
    shutil.copytree(PACKAGE / "lie", package / "lie", ignore=shutil.ignore_patterns("__pycache__"))
    # A file where numba would make its folder, for root may write everywhere.
    (package / "lie" / "__pycache__").touch()
    (tmp_path / "home").touch()
    found = subprocess.run(
        [
            sys.executable,
            "-B",
            "-c",
            "from quad_mpc_ros.lie import kernels; print(kernels.exp((0.0, 0.0, 0.0))[0])",
        ],
        env={
            **{k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))},
            "PYTHONPATH": str(tmp_path),
            "HOME": str(tmp_path / "home"),
        },
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == ["1.0"]


def test_machine_code_of_an_earlier_version_is_no_reason_to_fail(tmp_path: Path) -> None:
    """Whose types had other names."""
    module = tmp_path / "versions.py"
    module.write_text(_VERSION.format(name="_Before", sign="+"))
    assert _run(module) == "3.0"
    module.write_text(_VERSION.format(name="Renamed", sign="-"))
    assert _run(module) == "-1.0"


def test_machine_code_follows_what_it_calls_in_another_file(tmp_path: Path) -> None:
    """Also when size and time of change stay the same, as after an installation."""
    module = tmp_path / "caller.py"
    module.write_text(_CALLER)
    for constant in ("3.0", "4.0"):
        (tmp_path / "called.py").write_text(_CALLED.format(constant))
        os.utime(tmp_path / "called.py", (1e9, 1e9))
        assert _run(module) == constant


_CALLED = """
from quad_mpc_ros.compilation import compiled
@compiled
def called(x):
    return {} * x
"""
_CALLER = """
from called import called
from quad_mpc_ros.compilation import compiled
@compiled
def caller(x):
    return called(x)
print(caller(1.0))
"""


_VERSION = """
from typing import NamedTuple
from quad_mpc_ros.compilation import compiled
class {name}(NamedTuple):
    a: float
    b: float
@compiled
def inner(x):
    return x.a {sign} x.b
@compiled
def outer(a, b):
    return inner({name}(a, b))
if __name__ != "__main__":
    print(outer(1.0, 2.0))
"""


def _run(module: Path) -> str:
    """Return what a module prints when it is imported in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", f"import {module.stem}"],
        env={**os.environ, "PYTHONPATH": f"{module.parent}:{PACKAGE.parent}"},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    ).stdout.strip()
