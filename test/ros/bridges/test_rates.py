"""Plain rates in every frame and unit."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import AXES, FRD, T0, command, ready_to_fly, vector
from numpy.testing import assert_allclose

from quad_mpc_ros.ros.bridges import rates
from quad_mpc_ros.ros.bridges.rates import RatesBridge

New = Callable[[str], Any]

NOW_NS = 5_250_000_000


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(("angle_unit", "scale"), [("rad", 1.0), ("deg", 180.0 / math.pi)])
@pytest.mark.parametrize("body_frame", ["flu", "frd"])
def test_rates_in_every_frame_and_unit(
    new: New, axis: tuple[float, ...], angle_unit: str, scale: float, body_frame: str
) -> None:
    message = new("geometry_msgs/msg/TwistStamped")
    rates.fill_rates(
        message,
        command(w=axis),
        thrust=4.0,
        body_frame=body_frame,
        angle_unit=angle_unit,
        frame_id="base_link",
        now_ns=NOW_NS,
    )
    expected = axis if body_frame == "flu" else FRD[axis]
    assert_allclose(vector(message.twist.angular), scale * np.array(expected))
    assert message.twist.linear.z == (4.0 if body_frame == "flu" else -4.0)


def test_a_stack_is_released_at_once(new: New) -> None:
    bridge = ready_to_fly(RatesBridge, T0)
    bridge.engage(False, now_ns=T0)
    assert bridge.receive_command(command(T0), now_ns=T0) == []
