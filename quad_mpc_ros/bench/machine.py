"""On what the measurements were made, without saying whose machine it is."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
from pathlib import Path

_DISTRIBUTIONS = ("numpy", "scipy", "osqp", "cvxpy", "comma-deps-acados")


def describe() -> dict[str, str]:
    """Return processor, system and versions by what to call them; what is unknown is left out."""
    found = {
        "date": datetime.date.today().isoformat(),
        "processor": _processor(),
        "cores": str(os.cpu_count() or ""),
        "load before the run": f"{os.getloadavg()[0]:.2f}",
        "system": _system(),
        "kernel": platform.release().partition("-")[0],
        "Python": platform.python_version(),
    }
    for name in _DISTRIBUTIONS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {name: text for name, text in found.items() if text}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()


def _system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.system()
