# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders of runs that were not given one."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.commands.output import create_out, prepared_out


def test_runs_of_the_same_second_use_different_folders(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    outs = [prepared_out(create_out("square")) for _ in range(3)]
    for out in outs:
        (out / "bag").mkdir()
    assert len(set(outs)) == 3
    assert outs[0].name.endswith("_square")
