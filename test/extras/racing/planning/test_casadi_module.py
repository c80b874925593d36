# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which CasADi can plan."""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from quad_mpc_ros.cli import main
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi


@pytest.fixture(autouse=True)
def looked_up_again() -> Iterator[None]:
    casadi.cache_clear()
    yield
    casadi.cache_clear()


@pytest.mark.parametrize(
    ("installed", "has_ipopt", "given"),
    [
        ("3.6.7", False, "given CasADi 3.6.7 (installed: 3.6.7), "),
        ("3.8.2", True, "given CasADi 3.6.7 (installed: 3.8.2), "),  # ends in a crash
    ],
)
def test_rejects_a_casadi_without_ipopt_from_acados(
    installed: str,
    has_ipopt: bool,
    given: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    module = SimpleNamespace(__version__="3.6.7", has_nlpsol=lambda _: has_ipopt)
    monkeypatch.setitem(sys.modules, "casadi", module)
    monkeypatch.setattr(importlib.metadata, "version", lambda _: installed)
    assert main(["plan", "split_s", "--out", str(tmp_path / "race.csv")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: plan: {given}")
    assert line.endswith("pip install --force-reinstall --no-deps casadi==3.6.7")


def test_accepts_a_complete_casadi(monkeypatch: pytest.MonkeyPatch) -> None:
    module = SimpleNamespace(__version__="3.6.7", has_nlpsol=lambda name: name == "ipopt")
    monkeypatch.setitem(sys.modules, "casadi", module)
    monkeypatch.setattr(importlib.metadata, "version", lambda _: "3.6.7")
    assert casadi() is module
