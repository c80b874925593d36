# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Windows as they are published, and what a controller reads out of them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.references.config import TRAJECTORIES, ReferenceConfig
from quad_mpc_ros.references.director import Director
from quad_mpc_ros.references.server import ReferenceServer, WindowsAhead

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
CORNERS = np.array([[0.0, 0.0, 2.0], [2.0, 0.0, 2.0], [2.0, 2.0, 2.0], [0.0, 2.0, 2.0]])


def corner_at(seconds: float) -> Array:
    """Return the paper's waypoint, written down a second time."""
    return np.asarray(CORNERS[int(max(seconds, 0.0) // 2) % 4])


def started(**changes: object) -> ReferenceServer:
    server = ReferenceServer(ReferenceConfig.build(changes))
    server.start(START)
    return server


def assert_well_formed(window: ReferenceWindow, stamp: int) -> None:
    count = len(window.offset_ns)
    assert window.stamp_ns == stamp
    assert window.offset_ns.dtype == np.int64
    assert window.offset_ns[0] == 0
    assert (np.diff(window.offset_ns) >= 0).all()
    assert window.q_WB_xyzw.shape == (count, 4)
    for name in ("p_WB", "v_WB_W", "a_WB_W", "w_WB_W"):
        assert getattr(window, name).shape == (count, 3)


@pytest.mark.parametrize("preview", [False, True])
@settings(deadline=None, max_examples=40)
@given(time_ns=st.integers(-5 * SECOND, 20 * SECOND))
def test_a_window_starts_at_the_current_reference(preview: bool, time_ns: int) -> None:
    window = started(preview=preview).window(START + time_ns)
    assert_well_formed(window, START + time_ns)
    found = sample(window, START + time_ns)
    assert_array_equal(found.p_WB, corner_at(time_ns / SECOND))
    assert_array_equal(found.R_WB, np.eye(3))
    assert_array_equal(found.v_WB_W, np.zeros(3))


@pytest.mark.parametrize("stamp", [START + 100, START + 1_999_999_999, START + 2 * SECOND])
def test_without_preview_the_present_waypoint_is_held_over_the_whole_window(stamp: int) -> None:
    window = started(preview=False, **{"advanced.window_duration": 3.0}).window(stamp)
    assert window.offset_ns[-1] == 3 * SECOND
    ahead = sample(window, stamp + np.arange(0, 3 * SECOND, 70_000_000))
    expected = corner_at((stamp - START) / SECOND)
    assert_array_equal(ahead.p_WB, np.broadcast_to(expected, ahead.p_WB.shape))


@settings(deadline=None, max_examples=60)
@given(
    time_ns=st.one_of(
        st.integers(0, 10 * SECOND), st.sampled_from([0, SECOND, 2 * SECOND, 2 * SECOND - 1])
    ),
    step=st.sampled_from([0.05, 0.07, 0.3, 1.0]),
)
def test_preview_window_contains_the_next_corners(time_ns: int, step: float) -> None:
    server = started(
        preview=True, **{"advanced.window_step": step, "advanced.window_duration": 3.0}
    )
    stamp = START + time_ns
    window = server.window(stamp)
    assert_well_formed(window, stamp)
    assert window.offset_ns[-1] > 3 * SECOND - round(step * 1e9)
    for ahead in range(0, int(window.offset_ns[-1]) + 1, 33_333_333):
        found = sample(window, stamp + ahead)
        assert_array_equal(found.p_WB, corner_at((time_ns + ahead) / SECOND))


@pytest.mark.parametrize("time_ns", [SECOND, SECOND + 1, SECOND + 33_000_001])
def test_jumps_appear_as_two_samples_of_one_time(time_ns: int) -> None:
    window = started(preview=True, **{"advanced.window_duration": 2.0}).window(START + time_ns)
    jump = 2 * SECOND - time_ns
    at_jump = window.p_WB[window.offset_ns == jump]
    assert len(at_jump) >= 2
    assert_array_equal(at_jump[0], CORNERS[0])
    for after in at_jump[1:]:
        assert_array_equal(after, CORNERS[1])
    # Exact to the nanosecond on either side.
    assert_array_equal(sample(window, START + 2 * SECOND - 1).p_WB, CORNERS[0])
    assert_array_equal(sample(window, START + 2 * SECOND).p_WB, CORNERS[1])
    # The position changes nowhere but there.
    changes = [
        offset
        for offset, (left, right) in zip(
            window.offset_ns[1:].tolist(), itertools.pairwise(window.p_WB), strict=True
        )
        if np.any(left != right)
    ]
    assert changes == [jump]


@pytest.mark.parametrize("preview", [False, True])
def test_before_the_start_the_beginning_is_held(preview: bool) -> None:
    server = ReferenceServer(ReferenceConfig(preview=preview, frame_id="map"))
    assert not server.started
    for stamp in (0, START, START + 100 * SECOND):
        window = server.window(stamp)
        assert_well_formed(window, stamp)
        assert_array_equal(window.p_WB, np.broadcast_to(CORNERS[0], window.p_WB.shape))
        assert window.frame_id == "map"
    server.start(START)
    assert server.started
    assert_array_equal(server.window(START + 3 * SECOND).p_WB[0], CORNERS[1])


def test_the_whole_trajectory_visits_every_corner_and_closes() -> None:
    whole = started().whole()
    assert {tuple(p) for p in whole.p_WB.tolist()} == {tuple(c) for c in CORNERS.tolist()}
    assert_array_equal(whole.p_WB[0], CORNERS[0])
    assert_array_equal(whole.p_WB[-1], CORNERS[0])
    moves = [
        (tuple(left), tuple(right))
        for left, right in itertools.pairwise(whole.p_WB.tolist())
        if left != right
    ]
    corners = [tuple(c) for c in CORNERS.tolist()]
    # Once round, each side once: it is drawn as a line.
    assert moves == list(itertools.pairwise([*corners, corners[0]]))


CASES = {
    **{name: {"trajectory": name} for name in TRAJECTORIES if name != "csv"},
    "gates": {"trajectory": "gates", "gates": "seven_gates"},
    "square, shown ahead": {"preview": True},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("is_started", [False, True])
def test_block_of_windows_equals_single_windows(case: str, is_started: bool) -> None:
    """To the bit, or a flight in one process would not be the one over DDS."""
    server = ReferenceServer(ReferenceConfig.build(CASES[case]))
    if is_started:
        server.start(START)
    jitter = np.random.default_rng(0).integers(-2_000_000, 2_000_000, 40)
    regular = range(START - SECOND // 20, START + 2 * SECOND, SECOND // 50)
    for stamps in ([*regular], [START + 20_000_000 * n + int(jitter[n]) for n in range(40)]):
        for stamp, window in zip(stamps, server.windows(stamps), strict=True):
            alone = server.window(stamp)
            for name, values in vars(alone).items():
                found = getattr(window, name)
                if isinstance(values, np.ndarray):
                    assert (found.dtype, found.shape) == (values.dtype, values.shape), name
                    assert found.tobytes() == values.tobytes(), name
                else:
                    assert found == values, name


def test_windows_ahead_allow_skipped_stamps() -> None:
    server = started(trajectory="lemniscate")
    stamps = [START + 20_000_000 * n for n in range(300)]
    ahead = WindowsAhead(server, stamps)
    for stamp in stamps[::3]:
        window = ahead.window(stamp)
        assert window.stamp_ns == stamp
        assert window.p_WB.tobytes() == server.window(stamp).p_WB.tobytes()
    with pytest.raises(ValueError, match=str(START)):
        ahead.window(START)


def test_windows_ahead_of_changing_trajectory_are_current() -> None:
    config = ReferenceConfig()
    director = Director.on_ground(config, p_WB=np.zeros(3), yaw=0.0)
    server = ReferenceServer(config, director.timeline)
    server.start(START)
    stamps = [START + 20_000_000 * n for n in range(300)]
    ahead = WindowsAhead(server, stamps)
    before = ahead.window(stamps[0]).p_WB[-1, 2]
    assert director.take_off(0).accepted
    assert ahead.window(stamps[250]).p_WB[-1, 2] > before + 1.0
