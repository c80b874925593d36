# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The lemniscate: its path, its dynamics, and its published windows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.references.trajectory import TrajectorySamples

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
FAST = 2.6


def config(**changes: object) -> ReferenceConfig:
    return ReferenceConfig.build({"trajectory": "lemniscate", **changes})


def rotations(samples: TrajectorySamples) -> np.ndarray:
    return so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)


def test_shape_height_and_origin() -> None:
    eight = configured_trajectory(config(origin=[1.0, -2.0], height=3.0))
    period = eight.period_ns
    assert period == round(2e9 * np.pi)
    eighths = eight.at([period * part // 8 for part in range(9)]).p_WB - [1.0, -2.0, 3.0]
    s = 3.0 * np.sqrt(0.5)
    expected = [
        [0, 0, 0],
        [s, 1.5, 0],
        [3, 0, 0],
        [s, -1.5, 0],
        [0, 0, 0],
        [-s, 1.5, 0],
        [-3, 0, 0],
        [-s, -1.5, 0],
        [0, 0, 0],
    ]
    assert_allclose(eighths, expected, atol=1e-7)


def test_repeats_continuously() -> None:
    eight = configured_trajectory(config(angular_frequency=FAST))
    period = eight.period_ns
    assert eight.jumps(0, 100 * period) == []
    again, first = eight.at([period + 12345]), eight.at([12345])
    for name in ("p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W"):
        assert_allclose(getattr(again, name), getattr(first, name), atol=1e-6)


def test_rests_level_at_its_first_position_before_the_start() -> None:
    eight = configured_trajectory(config(angular_frequency=FAST))
    samples = eight.at([-(10**19), -1, 0])
    assert_array_equal(samples.p_WB, np.tile([0.0, 0.0, 2.0], (3, 1)))
    assert_array_equal(samples.q_WB_xyzw[:2], np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    for name in ("v_WB_W", "a_WB_W", "w_WB_W"):
        assert_array_equal(getattr(samples, name)[:2], np.zeros((2, 3)))
    assert_allclose(samples.v_WB_W[2], [3.0 * FAST, 3.0 * FAST, 0.0])
    assert eight.jumps(-SECOND, SECOND) == [0]
    assert eight.jumps(-SECOND, -1) == eight.jumps(0, SECOND) == []
    assert_array_equal(eight.at([-1]).v_WB_W, np.zeros((1, 3)))


def server(**changes: object) -> ReferenceServer:
    return ReferenceServer(config(**changes))


@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize("frequency", [1.0, FAST])
def test_published_windows_reproduce_the_trajectory(preview: bool, frequency: float) -> None:
    changes = {"angular_frequency": frequency, "preview": preview}
    eight, started = configured_trajectory(config(**changes)), server(**changes)
    started.start(START)
    for begin in (0, 123_456_789):
        window = started.window(START + begin)
        assert len(window.offset_ns) == 41
        times = list(range(begin, begin + int(window.offset_ns[-1]), 1_000_003))
        read, true = sample(window, START + np.array(times)), eight.at(times)
        R_error = np.swapaxes(rotations(true), -1, -2) @ read.R_WB
        assert np.linalg.norm(read.p_WB - true.p_WB, axis=1).max() < 1e-4
        assert np.linalg.norm(read.v_WB_W - true.v_WB_W, axis=1).max() < 1e-3
        # Between samples these are straight lines, which closed loops do not notice.
        assert np.linalg.norm(so3.log(R_error), axis=1).max() < 0.1
        assert np.linalg.norm(read.a_WB_W - true.a_WB_W, axis=1).max() < 0.4
