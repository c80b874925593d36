# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Columns of recorded values, and the figures of a tick."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages.codec import MessageDecoder
from quad_mpc_ros.messages.diagnostics import written_stats
from quad_mpc_ros.recordings.logs import Log, Received, tick_stats

RANDOM = np.random.default_rng(5)


def test_log_has_a_column_for_each_field() -> None:
    p_WB = RANDOM.normal(size=(10, 3))
    odometries = [OdometrySample.at_rest(each, stamp_ns=n) for n, each in enumerate(p_WB)]
    log = Log(OdometrySample)
    assert log.column("q_WB_xyzw").shape == (0, 4) and log.stamp_ns.dtype == np.int64
    for n, each in enumerate(odometries):
        log.append(Received(value=each, log_time_ns=2 * n, publish_time_ns=3 * n))
    assert log.column("p_WB").tobytes() == p_WB.tobytes()
    assert log.stamp_ns.tolist() == list(range(10))
    assert log.log_time_ns.tolist() == list(range(0, 20, 2))
    assert log.publish_time_ns.tolist() == list(range(0, 30, 3))
    assert set(log.column("frame_id").tolist()) == {odometries[0].frame_id}


def test_stats_survive_the_message(build: SimpleNamespace) -> None:
    ticks = [build.tick(n, reason="r" * n, iterations=n, step_time_us=0.1 * n) for n in range(4)]
    log = Log(TickStats, [Received(value=t, log_time_ns=0, publish_time_ns=0) for t in ticks])
    assert [each.value for each in log] == ticks
    assert log.columns()["reason"].dtype == np.dtype("<U3")
    assert log.columns()["iterations"].tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("changes", [{"odom_age_ms": np.nan}, {"iterations": 2**70}])
def test_refuses_unusable_stats(build: SimpleNamespace, changes: dict[str, object]) -> None:
    data = written_stats(build.tick(0, **changes))
    with pytest.raises(ValueError):
        tick_stats(MessageDecoder().decode("diagnostic_msgs/msg/DiagnosticArray", data))
