"""Hovering: one point, for ever."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def test_it_holds_its_point_at_rest() -> None:
    server = ReferenceServer(
        ReferenceConfig(trajectory="hover", origin=(1.0, -2.0), height=0.7, window_step=0.3)
    )
    for begun in (False, True):
        if begun:
            server.start(START)
        for stamp in (START - SECOND, START, START + 1000 * SECOND):
            ahead = sample(server.window(stamp), stamp + np.arange(0, 3 * SECOND, SECOND // 7))
            count = len(ahead.p_WB)
            assert_array_equal(ahead.p_WB, np.tile([1.0, -2.0, 0.7], (count, 1)))
            assert_array_equal(ahead.R_WB, np.tile(np.eye(3), (count, 1, 1)))
            for still in (ahead.v_WB_W, ahead.a_WB_W, ahead.w_WB_B):
                assert_array_equal(still, np.zeros((count, 3)))


def test_it_is_drawn_as_a_point() -> None:
    whole = ReferenceServer(ReferenceConfig(trajectory="hover")).whole()
    assert_array_equal(whole.p_WB, [[0.0, 0.0, 2.0]])
