# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A log gives back what was put into it, bit for bit."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages.codec import MessageDecoder
from quad_mpc_ros.messages.diagnostics import written_stats
from quad_mpc_ros.recordings.logs import Log, Received, tick_stats

RANDOM = np.random.default_rng(5)


def odometry(stamp_ns: int) -> OdometrySample:
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=RANDOM.normal(size=3),
        q_WB_xyzw=RANDOM.normal(size=4),
        v_WB_B=np.array([np.nan, np.inf, -0.0]),
        w_WB_B=RANDOM.normal(size=3),
        frame_id=f"map{stamp_ns % 2}",
        child_frame_id="drone",
    )


def command(stamp_ns: int) -> CommandSample:
    return CommandSample(
        stamp_ns=stamp_ns,
        throttle=RANDOM.uniform(),
        w_WB_B=RANDOM.normal(size=3),
        frame_id="drone",
    )


def same(a: object, b: object) -> bool:
    for field in dataclasses.fields(a):  # type: ignore[arg-type]
        one, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, np.ndarray):
            if one.shape != other.shape or one.tobytes() != other.tobytes():
                return False
        elif one != other:
            return False
    return True


@pytest.mark.parametrize(("kind", "make"), [(OdometrySample, odometry), (CommandSample, command)])
def test_log_returns_its_values(kind: type, make: object) -> None:
    given = [
        Received(value=make(10 - n), log_time_ns=n, publish_time_ns=2 * n)  # type: ignore[operator]
        for n in range(10)
    ]
    kept: Log = Log(kind, given)
    assert len(kept) == 10
    for before, after in zip(given, kept, strict=True):
        assert same(before.value, after.value)
        assert (after.log_time_ns, after.publish_time_ns) == (
            before.log_time_ns,
            before.publish_time_ns,
        )
    assert same(kept[-1].value, given[-1].value)
    assert [each.value.stamp_ns for each in kept[2:8:3]] == [8, 5]
    assert kept.stamp_ns.tolist() == list(range(10, 0, -1))
    with pytest.raises(IndexError):
        kept[10]
    assert not Log(kind)


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
