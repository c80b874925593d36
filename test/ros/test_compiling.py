# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A node that compiles says so."""

from __future__ import annotations

import time
from unittest.mock import Mock

import pytest

from quad_mpc_ros.ros import compiling


def test_logs_progress_of_long_compilation() -> None:
    node = Mock()
    logger = node.get_logger()
    with compiling.log_compilation(node, period=0.02):
        deadline = time.monotonic() + 10.0
        while logger.info.call_count < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert logger.info.call_count >= 3
    assert logger.info.call_args_list[0].args[0] == "compiling: 0 functions in 0 s so far"
    after = logger.info.call_count
    time.sleep(0.1)
    assert logger.info.call_count == after
    assert not logger.warning.called  # all was kept


def test_warns_once_of_compiled_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = iter((7, 10, 10))
    monkeypatch.setattr(compiling, "functions_compiled", lambda: next(counts))
    node = Mock()
    logger = node.get_logger()
    with compiling.log_compilation(node):
        pass
    ((warning,),) = (call.args for call in logger.warning.call_args_list)
    assert warning.startswith("compiled 3 functions in 0 s")
    assert "'quad_mpc compile'" in warning
