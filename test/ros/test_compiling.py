# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A node that compiles says so."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from quad_mpc_ros.ros import compiling


class Logger:
    def __init__(self) -> None:
        self.infos: list[str] = []
        self.warnings: list[str] = []

    def info(self, line: str) -> None:
        self.infos.append(line)

    def warning(self, line: str) -> None:
        self.warnings.append(line)


def test_logs_progress_of_long_compilation() -> None:
    logger = Logger()
    node: Any = SimpleNamespace(get_logger=lambda: logger)
    with compiling.log_compilation(node, period=0.02):
        deadline = time.monotonic() + 10.0
        while len(logger.infos) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert len(logger.infos) >= 3
    assert logger.infos[0] == "compiling: 0 functions in 0 s so far"
    after = len(logger.infos)
    time.sleep(0.1)
    assert len(logger.infos) == after
    assert not logger.warnings  # all was kept


def test_warns_once_of_compiled_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = iter((7, 10, 10))
    monkeypatch.setattr(compiling, "functions_compiled", lambda: next(counts))
    logger = Logger()
    node: Any = SimpleNamespace(get_logger=lambda: logger)
    with compiling.log_compilation(node):
        pass
    (warning,) = logger.warnings
    assert warning.startswith("compiled 3 functions in 0 s")
    assert "'quad_mpc compile'" in warning
