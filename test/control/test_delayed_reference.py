# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The delayed reference: which samples of its windows are kept, and until when."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from quad_mpc_ros.control import delayed_reference
from quad_mpc_ros.control.delayed_reference import DelayedReference
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.server import ReferenceServer

PERIOD_NS = 20_000_000
SERVER = ReferenceServer(
    ReferenceConfig(trajectory="lemniscate"),
    configured_trajectory(ReferenceConfig(trajectory="lemniscate")),
)
SERVER.start(0)


def slow_plan(speed: float, *, stamp_ns: int, steps: int = 10) -> Plan:
    """Return a plan in which the reference's time passes at a speed."""
    return Plan(
        stamp_ns=stamp_ns,
        step=0.05,
        input_step=0.0125,
        inputs=np.zeros((4 * steps, 4)),
        p_WB=np.zeros((steps + 1, 3)),
        R_WB=np.zeros((steps + 1, 3, 3)),
        speeds=np.full(steps, speed),
    )


def fly(delayed: DelayedReference, ticks: int, *, speed: float, every: int = 1) -> ReferenceWindow:
    """Answer odometries by plans at a speed; return the last window. One comes ``every`` ticks."""
    newest = SERVER.window(0)
    for k in range(ticks):
        stamp_ns = k * PERIOD_NS
        newest = SERVER.window(stamp_ns) if k % every == 0 else newest
        window = delayed.at(newest, stamp_ns)
        delayed.take(slow_plan(speed, stamp_ns=stamp_ns), stamp_ns=stamp_ns)
    return window


def places(window: ReferenceWindow, stamp_ns: int, *, after: Array) -> Array:
    return sample(window, stamp_ns + np.rint(1e9 * after).astype(np.int64)).p_WB


def test_windows_are_unchanged_at_full_speed() -> None:
    delayed = DelayedReference()
    for k in range(5):
        window = SERVER.window(k * PERIOD_NS)
        assert delayed.at(window, k * PERIOD_NS) is window
        delayed.take(slow_plan(1.0, stamp_ns=0), stamp_ns=k * PERIOD_NS)


@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize("speed", [0.5, 0.9, 1.05])
def test_follows_the_path_with_delay(speed: float, every: int) -> None:
    delayed, ticks = DelayedReference(), 151
    window = fly(delayed, ticks, speed=speed, every=every)
    assert delayed.behind == pytest.approx((ticks - 1) * 0.02 * (1.0 - speed))
    stamp_ns, after = (ticks - 1) * PERIOD_NS, np.linspace(0.0, 1.5, 31)
    true = SERVER.window(stamp_ns - round(1e9 * delayed.behind))
    expected = places(true, true.stamp_ns, after=after)
    np.testing.assert_allclose(places(window, stamp_ns, after=after), expected, atol=1e-4)


def test_discards_samples_that_were_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delayed_reference, "_MAX_BEHIND", 0.5)
    delayed = DelayedReference()
    window = fly(delayed, 400, speed=0.5)
    assert delayed.behind == pytest.approx(0.5)
    assert len(window.offset_ns) < 0.5 / 0.02 + 45


def test_plan_speeds_apply_until_the_next_plan() -> None:
    delayed = DelayedReference()
    fly(delayed, 1, speed=0.5)
    for k in (1, 3, 7):
        delayed.at(SERVER.window(k * PERIOD_NS), k * PERIOD_NS)
    assert delayed.behind == pytest.approx(0.5 * 7 * 0.02)


def test_new_reference_follows_the_remaining_delayed_path() -> None:
    """A hold asked for now is flown after what was ahead of it."""
    delayed = DelayedReference()
    fly(delayed, 100, speed=0.8)
    now_ns = 100 * PERIOD_NS
    held = ReferenceWindow.hover(SERVER.window(now_ns).p_WB[0], stamp_ns=now_ns)
    window = delayed.at(held, now_ns)
    begins = delayed.behind
    before = places(window, now_ns, after=np.array([0.5 * begins]))
    reference = SERVER.window(now_ns - round(0.5e9 * begins))
    np.testing.assert_allclose(before[0], reference.p_WB[0], atol=1e-3)
    after = places(window, now_ns, after=np.array([begins, begins + 0.5]))
    np.testing.assert_allclose(after, np.tile(held.p_WB[0], (2, 1)), atol=1e-9)


def test_a_jump_ends_the_delay() -> None:
    delayed = DelayedReference()
    fly(delayed, 100, speed=0.8)
    elsewhere = ReferenceWindow.hover([30.0, 0.0, 2.0], stamp_ns=100 * PERIOD_NS)
    assert delayed.at(elsewhere, elsewhere.stamp_ns) is elsewhere
    assert delayed.behind == 0.0


def test_has_no_delay_at_rest() -> None:
    delayed = DelayedReference()
    for k in range(100):
        stamp_ns = k * PERIOD_NS
        delayed.at(ReferenceWindow.hover([1.0, 2.0, 3.0], stamp_ns=stamp_ns), stamp_ns)
        delayed.take(slow_plan(0.5, stamp_ns=stamp_ns), stamp_ns=stamp_ns)
        assert delayed.behind <= 0.011


def test_a_reset_of_the_estimate_transforms_the_path() -> None:
    delayed = DelayedReference()
    fly(delayed, 100, speed=0.8)
    stamp_ns = 100 * PERIOD_NS
    reset = EstimateReset(stamp_ns=stamp_ns, turn=0.3, step_W=np.array([3.0, -2.0, 0.5]))
    delayed.reset_estimate(reset)
    window = delayed.at(reset.window(SERVER.window(stamp_ns)), stamp_ns)
    assert delayed.behind > 0.3
    true = SERVER.window(stamp_ns - round(1e9 * delayed.behind))
    after = np.linspace(0.0, 1.0, 21)
    expected = reset.points(places(true, true.stamp_ns, after=after))
    np.testing.assert_allclose(places(window, stamp_ns, after=after), expected, atol=1e-4)


def test_restarts_in_another_frame() -> None:
    delayed = DelayedReference()
    fly(delayed, 100, speed=0.8)
    window = dataclasses.replace(SERVER.window(100 * PERIOD_NS), frame_id="map")
    assert delayed.at(window, window.stamp_ns) is window
