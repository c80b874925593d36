"""What is compiled by Numba, kept on disk, and taken from there again."""

from __future__ import annotations

import ast
import os
import pwd
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import quad_mpc_ros
from quad_mpc_ros.configuration import compilation

PACKAGE = Path(quad_mpc_ros.__file__).parent
COMPILER = "configuration/compilation.py"


def test_nowhere_to_write_is_no_reason_to_fail(tmp_path: Path) -> None:
    """As in a container whose file system is read-only and whose user has no home."""
    package = _copied_compiler(tmp_path)
    shutil.copy(PACKAGE / "control/__init__.py", package / "control")
    shutil.copytree(
        PACKAGE / "control/lie",
        package / "control/lie",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    # A file where the folder would be made, for root may write everywhere.
    (package / "__pycache__").touch()
    (tmp_path / "home").touch()
    found = subprocess.run(
        [
            sys.executable,
            "-B",
            "-c",
            "from quad_mpc_ros.control.lie import kernels; print(kernels.exp((0.0, 0.0, 0.0))[0])",
        ],
        env={
            **{k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))},
            "PYTHONPATH": str(tmp_path),
            "HOME": str(tmp_path / "home"),
        },
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == ["1.0"]


def _copied_compiler(folder: Path) -> Path:
    """Copy of the package what compiles, without the rest."""
    package = folder / "quad_mpc_ros"
    (package / "control").mkdir(parents=True)
    (package / "configuration").mkdir()
    (package / "__init__.py").touch()
    (package / "configuration/__init__.py").touch()
    for name in (*compilation.SHARED, "configuration/trust.py"):
        if name.endswith(".py"):
            shutil.copy(PACKAGE / name, package / name)
    return package


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


def test_machine_code_is_made_of_files_that_its_digest_covers() -> None:
    """Whatever compiled code takes from elsewhere in the package is of its door or shared."""
    taken = {
        (path.parent, file_of(module))
        for path in PACKAGE.rglob("*.py")
        for module in taken_by_compiled_code(ast.parse(path.read_text()))
    }
    assert (PACKAGE / "control/model", PACKAGE / "control/lie/kernels.py") in taken
    for room, file in taken:
        assert file in set(compilation.sources(room)), (
            f"compiled code of {room} takes something from {file}: add it to "
            "quad_mpc_ros.configuration.compilation.SHARED"
        )


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


def test_how_code_is_compiled_is_part_of_its_digest(tmp_path: Path) -> None:
    """With other options of Numba the machine code is another, though no function has changed."""
    package = _copied_compiler(tmp_path)
    (tmp_path / "divided.py").write_text(_DIVIDED)
    source = (PACKAGE / COMPILER).read_text()
    assert source.count('error_model="numpy"') == 1
    outcomes = []
    for model in ("numpy", "python"):
        (package / COMPILER).write_text(source.replace('="numpy"', f'="{model}"'))
        outcomes.append(_run(tmp_path / "divided.py", package=package))
    assert outcomes == ["inf", "ZeroDivisionError"]


def test_a_process_counts_what_it_compiles(tmp_path: Path) -> None:
    """Once, and not again in the next process, which finds it."""
    (tmp_path / "called.py").write_text(_CALLED.format("3.0"))
    module = tmp_path / "caller.py"
    module.write_text(f"{_CALLER}\nfrom quad_mpc_ros.configuration import compilation\n{_COUNTED}")
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    counts = [_run(module, **environment).split()[-1] for _ in range(2)]
    assert counts == ["2", "0"]


@pytest.fixture
def kept_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[Path], Path | None]]:
    """Return where code of a room is kept when a cache is named, as a process asks for it."""
    made: set[Path] = set()

    def asked(cache: Path) -> Path | None:
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
        compilation.cache_folder.cache_clear()
        folder = compilation.cache_folder(tmp_path / "room")
        made.update([folder] if folder is not None else [])
        return folder

    yield asked
    compilation.cache_folder.cache_clear()
    for folder in made:
        shutil.rmtree(folder)


UNTRUSTED = {
    "a folder that all may write": ("place", 0o777, "is writable by others"),
    "a folder as /tmp": ("place", 0o1777, "is writable by others"),
    "another's folder": ("place", None, "belongs to nobody"),
    "code that all may write": ("code", 0o666, "is writable by others"),
    "another's code": ("code", None, "belongs to nobody"),
}


@pytest.mark.parametrize("kind", UNTRUSTED)
def test_code_that_others_could_have_put_there_is_not_used(
    kind: str,
    tmp_path: Path,
    kept_in: Callable[[Path], Path | None],
    caplog: pytest.LogCaptureFixture,
) -> None:
    which, mode, reason = UNTRUSTED[kind]
    if mode is None and os.geteuid() != 0:
        pytest.skip("only root gives files away")
    cache = tmp_path / "cache"
    folder = kept_in(cache)
    assert folder is not None
    assert folder.parent == cache
    folder.chmod(0o755)  # as of an installation for all
    code = folder / "motion.step-12.py311.nbi"
    code.touch(0o644)
    assert kept_in(cache) == folder
    target = cache if which == "place" else code
    if mode is None:
        os.chown(target, pwd.getpwnam("nobody").pw_uid, -1)
    else:
        target.chmod(mode)

    kept = kept_in(cache)

    assert kept == PACKAGE / "__pycache__" / folder.name
    assert caplog.messages == [
        f"machine code kept in {cache} is not used, for {target} {reason}; "
        f"instead that in {kept.parent}"
    ]


def test_what_nobody_else_can_enter_nobody_else_has_written(
    tmp_path: Path, kept_in: Callable[[Path], Path | None]
) -> None:
    """Whatever the umask makes of the files."""
    folder = kept_in(tmp_path / "cache")
    assert folder is not None
    assert folder.stat().st_mode & 0o777 == 0o700
    (folder / "motion.step-12.py311.nbi").touch()
    (folder / "motion.step-12.py311.nbi").chmod(0o666)
    assert kept_in(tmp_path / "cache") == folder


def test_code_of_an_untrusted_folder_is_compiled_anew(tmp_path: Path) -> None:
    (tmp_path / "called.py").write_text(_CALLED.format("3.0"))
    module = tmp_path / "caller.py"
    module.write_text(f"{_CALLER}\nfrom quad_mpc_ros.configuration import compilation\n{_COUNTED}")
    environment = {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "XDG_CACHE_HOME": str(tmp_path / "user"),
        "PYTHONPATH": f"{tmp_path / 'copy'}{os.pathsep}{tmp_path}",
    }
    package = _copied_compiler(tmp_path / "copy")
    (package / "__pycache__").touch()  # not there either
    assert _run(module, package=package, **environment).split()[-1] == "2"
    (tmp_path / "cache").chmod(0o777)
    assert _run(module, package=package, **environment).split()[-1] == "2"


_COUNTED = "print(compilation.compiled_here())"

_DIVIDED = """
from quad_mpc_ros.configuration.compilation import compiled
@compiled
def divided(x):
    return 1.0 / x
try:
    print(divided(0.0))
except ZeroDivisionError as error:
    print(type(error).__name__)
"""

_CALLED = """
from quad_mpc_ros.configuration.compilation import compiled
@compiled
def called(x):
    return {} * x
"""
_CALLER = """
from called import called
from quad_mpc_ros.configuration.compilation import compiled
@compiled
def caller(x):
    return called(x)
print(caller(1.0))
"""


_VERSION = """
from typing import NamedTuple
from quad_mpc_ros.configuration.compilation import compiled
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


def _run(module: Path, *, package: Path = PACKAGE, **environment: str) -> str:
    """Return what a module prints when it is imported in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", f"import {module.stem}"],
        env={
            **os.environ,
            "PYTHONPATH": f"{module.parent}:{package.parent}",
            **environment,
        },
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    ).stdout.strip()
