# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Plain rates in every frame and unit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fixtures.bridges import AXES, FRD, HOVER, T0, command, message_of, ready_to_fly, vector
from numpy.testing import assert_allclose

from quad_mpc_ros.ros.bridges.rates import RatesBridge


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(("angle_unit", "scale"), [("rad", 1.0), ("deg", 180.0 / math.pi)])
@pytest.mark.parametrize("body_frame", ["flu", "frd"])
def test_rates_in_every_frame_and_unit(
    axis: tuple[float, ...], angle_unit: str, scale: float, body_frame: str
) -> None:
    bridge = ready_to_fly(RatesBridge, T0, angle_unit=angle_unit, body_frame=body_frame)
    sent = bridge.receive_command(command(T0, HOVER, axis), now_ns=T0)
    twist = message_of(sent, "rates_setpoint").twist
    expected = axis if body_frame == "flu" else FRD[axis]
    assert_allclose(vector(twist.angular), scale * np.array(expected))
    assert twist.linear.z == (HOVER if body_frame == "flu" else -HOVER)
