# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Acceptance of odometry: stamps compared with arrivals, and frozen estimates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.odometry_gate import OdometryGate

MakeOdometry = Callable[..., OdometrySample]

MS = 1_000_000
START = 1_700_000_000_000 * MS
MOVING = {"v_WB_B": np.array([1.0, 0.0, 0.0])}


class Source:
    """An odometry source on a clock that is an hour off; times in ms from the start."""

    OFFSET = -3_600_000

    def __init__(self, config: MpcConfig, make_odometry: MakeOdometry) -> None:
        self._gate = OdometryGate(config)
        self._make_odometry = make_odometry
        self._count = 0

    def send(self, at: float, *, stamped: float | None = None, **changes: Any) -> str | None:
        """Send an odometry, by default stamped on arrival and unlike the previous one."""
        self._count += 1
        changes.setdefault("p_WB", np.array([0.01 * self._count, 0.0, 2.0]))
        stamp = self.OFFSET + (at if stamped is None else stamped)
        odometry = self._make_odometry(START + round(stamp * MS), **changes)
        return self._gate.refusal(odometry, now_ns=START + round(at * MS))

    def send_all(
        self, times: Sequence[float], *, later: float = 0.0, **changes: Any
    ) -> list[bool]:
        """Send odometries, stamped ``later`` than they arrive; return which are accepted."""
        return [self.send(at, stamped=at + later, **changes) is None for at in times]


@pytest.fixture
def source(make_odometry: MakeOdometry) -> Source:
    return Source(MpcConfig(odom_timeout=0.1), make_odometry)


def regularly(begin: int, end: int) -> range:
    return range(begin, end, 20)


def test_accepts_steady_source_with_any_clock_offset(source: Source) -> None:
    assert all(source.send_all(regularly(0, 10_000)))


@pytest.mark.parametrize("drift", [-0.01, -0.5e-3, 0.5e-3, 0.01])
def test_accepts_clock_drift(source: Source, drift: float) -> None:
    """A drift of 1 %, far more than that of quartz clocks."""
    assert all(source.send(at, stamped=at * (1.0 + drift)) is None for at in range(0, 10**6, 500))


def test_rejects_odometry_later_than_timeout(source: Source) -> None:
    source.send_all(regularly(0, 1000))
    assert source.send(1090, stamped=1000) is None
    reason = source.send(1200, stamped=1020)
    assert reason is not None
    assert reason.startswith("odometry stamp is 0.18 s behind")
    assert source.send(1201, stamped=1200) is None


@pytest.mark.parametrize("waited", [90, 270, 2000, 60_000])
def test_accepts_punctual_odometry_after_late_first_one(source: Source, waited: int) -> None:
    assert source.send(0, stamped=-waited) is None
    assert all(source.send_all(regularly(20, 1000)))
    # The latency is known now, and late odometry is refused.
    assert "behind its arrival" in str(source.send(1120, stamped=990))


def test_rejects_single_stamp_from_the_future(source: Source) -> None:
    source.send_all(regularly(0, 1000))
    assert "60.00 s ahead of" in str(source.send(1000, stamped=61_000))
    assert all(source.send_all(regularly(1020, 2000)))


def test_rejects_single_stamp_from_the_past(source: Source) -> None:
    source.send_all(regularly(0, 1000))
    for stamped in (990, 979, 0, -60_000):
        assert source.send(1000, stamped=stamped) in (None, "odometry stamps go backwards")
        assert stamped == 990 or source.send(1000, stamped=stamped) is not None
    assert all(source.send_all(regularly(1020, 2000)))


def test_rejects_odometry_queued_while_process_was_stopped(source: Source) -> None:
    source.send_all(regularly(0, 1000))
    queued = [source.send(2000 + 0.001 * k, stamped=1000 + 20 * k) is None for k in range(50)]
    # The last four are younger than the timeout.
    assert queued == [False] * 46 + [True] * 4
    assert all(source.send_all(regularly(2020, 3000)))


@pytest.mark.parametrize("jump", [-3_600_000, -150, 150, 3_600_000])
def test_accepts_changed_clock_offset_after_timeout(source: Source, jump: int) -> None:
    source.send_all(regularly(0, 1000))
    taken = source.send_all(regularly(1000, 2000), later=jump)
    assert taken == [False] * 6 + [True] * 44
    # The same holds for the way back.
    assert source.send_all(regularly(2000, 3000)) == [False] * 6 + [True] * 44


def test_rejects_unordered_stamps(source: Source) -> None:
    source.send_all(regularly(0, 1000))
    rng = np.random.default_rng(1)
    for at in regularly(1000, 3000):
        assert source.send(at, stamped=at + float(rng.uniform(-1e6, -1e3))) is not None


def test_rejects_a_repeated_stamp(source: Source) -> None:
    source.send_all(regularly(0, 1000))
    for at in regularly(1000, 3000):
        assert source.send(at, stamped=980) == "odometry stamps do not advance"
    assert source.send(3000) is None


@pytest.mark.parametrize("moving", [MOVING, {"w_WB_B": np.array([0.0, 0.01, 0.0])}])
def test_rejects_frozen_estimate_in_motion_after_timeout(
    source: Source, moving: dict[str, Any]
) -> None:
    source.send_all(regularly(0, 1000))
    frozen = source.send_all(regularly(1000, 2000), p_WB=np.ones(3), **moving)
    assert frozen == [True] * 6 + [False] * 44
    assert source.send(2000, **moving) is None


def test_republished_estimate_is_not_frozen(source: Source) -> None:
    for at in range(0, 2000, 5):
        assert source.send(at, p_WB=np.array([at // 50, 0.0, 2.0]), **MOVING) is None


def test_constant_estimate_at_rest_is_not_frozen(source: Source) -> None:
    assert all(source.send_all(regularly(0, 2000), p_WB=np.ones(3)))


def test_lockstep_accepts_repeated_and_restarted_stamps(
    make_odometry: MakeOdometry,
) -> None:
    gate = OdometryGate(MpcConfig(odom_timeout=0.1, lockstep=True))

    def taken(ms: int) -> bool:
        return gate.refusal(make_odometry(START + ms * MS), now_ns=START + ms * MS) is None

    assert taken(1000)
    assert taken(1000)
    assert not taken(980)
    assert taken(1020)
    assert taken(0)
    assert taken(5000)
