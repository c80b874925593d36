"""Rate limits and bounds of commands."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.control.config import MpcConfig, SlewParameters
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.safety.command_limits import clamped, rate_limited

BEFORE = Input(throttle=0.5, w_WB_B=np.array([1.0, 0.0, -1.0]))
FAR = Input(throttle=0.9, w_WB_B=np.array([-9.0, 0.1, -8.0]))


@pytest.mark.parametrize(
    ("limits", "throttle", "w_WB_B"),
    [
        (SlewParameters(), 0.9, [-9.0, 0.1, -8.0]),
        (SlewParameters(throttle=5.0), 0.6, [-9.0, 0.1, -8.0]),
        (SlewParameters(body_rates=100.0), 0.9, [-1.0, 0.1, -3.0]),
        (SlewParameters(throttle=5.0, body_rates=100.0), 0.6, [-1.0, 0.1, -3.0]),
        (SlewParameters(throttle=50.0, body_rates=1000.0), 0.9, [-9.0, 0.1, -8.0]),
    ],
)
def test_limits_change_of_command(
    limits: SlewParameters, throttle: float, w_WB_B: list[float]
) -> None:
    u = rate_limited(FAR, BEFORE, limits, duration=0.02)
    assert u.throttle == pytest.approx(throttle)
    assert_allclose(u.w_WB_B, w_WB_B)
    back = rate_limited(BEFORE, FAR, limits, duration=0.02)
    assert back.throttle - FAR.throttle == pytest.approx(BEFORE.throttle - throttle)
    assert_allclose(back.w_WB_B - FAR.w_WB_B, BEFORE.w_WB_B - w_WB_B)


def test_clamps_commands_beyond_their_bounds(paper_config: MpcConfig) -> None:
    inside = Input(throttle=0.4, w_WB_B=np.array([1.0, -2.0, 3.0]))
    kept = clamped(inside, paper_config)
    assert kept.throttle == 0.4
    assert_allclose(kept.w_WB_B, inside.w_WB_B, atol=0.0)
    clipped = clamped(Input(throttle=1.5, w_WB_B=np.array([99.0, -99.0, 99.0])), paper_config)
    assert clipped.throttle == 1.0
    assert_allclose(clipped.w_WB_B, np.array([6.0, -6.0, 3.0]) * math.pi, atol=1e-12)
