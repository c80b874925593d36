# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The comparison of a control step with other controllers, and the page that it publishes."""

from __future__ import annotations

import performance
import pytest

SHORT = ["--duration", "0.2", "--repeats", "2"]


def test_published_page_shows_the_recorded_figures() -> None:
    published = performance.PAGE.read_text(encoding="utf-8")
    assert published == performance.page_of_record(), "run python bench/performance.py --page"


def test_every_installed_peer_flies(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("cvxpy", reason="the extra 'bench' is not installed")
    pytest.importorskip("acados", reason="the extra 'bench' is not installed")
    assert performance.main([*SHORT, "--steps"]) == 0
    printed = capsys.readouterr()
    assert "skipped" not in printed.err
    rows = [line for line in printed.out.splitlines() if line.startswith("| ")]
    for kind in performance.PEERS.values():
        (row,) = (row for row in rows if row.startswith(f"| {kind.title} |"))
        failed = row.split(" | ")[6]
        assert failed == "0"
