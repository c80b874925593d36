"""``quad_mpc watch``: wrong options, and Rich missing."""

from __future__ import annotations

import sys

import pytest

from quad_mpc_ros.cli import main


def test_a_wrong_interval_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--interval", "0"]) == 2
    assert capsys.readouterr().err.startswith("error: --interval: given 0")


def test_without_rich_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rich", None)
    assert main(["watch"]) == 2
    assert "pip install rich" in capsys.readouterr().err
