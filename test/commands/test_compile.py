# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc compile``: what it does with the compile cache, and what it returns."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands import compile as command


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache with one function, and a compiler that leaves it as it is."""
    folder = tmp_path / "compiled-0"
    folder.mkdir()
    (folder / "f.nbc").touch()
    monkeypatch.setattr(command, "cache_folder", lambda: folder)
    monkeypatch.setattr(command, "_compile", lambda begun: None)
    return folder


def test_compiles_once(
    cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compile"]) == 0
    assert (cache / "f.nbc").exists()
    assert capsys.readouterr().out.startswith("all compiled: ")
    monkeypatch.setattr(command, "_compile", lambda begun: pytest.fail("compiles again"))
    assert main(["compile"]) == 0
    assert capsys.readouterr().out == "all is compiled\n"


def test_again_empties_the_cache(cache: Path) -> None:
    assert main(["compile", "--again"]) == 0
    assert not (cache / "f.nbc").exists()


def test_suggests_again_when_compiling_fails(
    cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(begun: float) -> None:
        raise RuntimeError("no space left")

    monkeypatch.setattr(command, "_compile", fail)
    assert main(["compile"]) == 1
    message = capsys.readouterr().err
    assert "compiling failed: no space left" in message
    assert "run quad_mpc compile --again" in message
    assert not (cache / "complete").exists()


def test_reports_an_unwritable_cache(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "cache_folder", lambda: None)
    assert main(["compile"]) == 1
    assert "set NUMBA_CACHE_DIR" in capsys.readouterr().err
