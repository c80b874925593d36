# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fence and envelope: breaches, their actions, and their end."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.config import EnvelopeParameters, FenceParameters, MpcConfig
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.flight_limits import FlightLimits
from quad_mpc_ros.control.safety.ladder import Action

MakeOdometry = Callable[..., OdometrySample]
MS = 1_000_000

CONFIG = MpcConfig(
    fence=FenceParameters(minimum=(-5.0, -3.0, -1.0), maximum=(5.0, 3.0, 8.0), action="hover"),
    envelope=EnvelopeParameters(tilt_max=1.0, rate_max=6.0, speed_max=10.0, action="warn"),
)


class Watch:
    def __init__(self, config: MpcConfig, make_odometry: MakeOdometry) -> None:
        self.limits, self._make_odometry = FlightLimits(config), make_odometry

    def check(self, at: int, *, reference: float | None = 0.0, **changes: Any) -> tuple[str, str]:
        """Return the active action and reason at a time [ms], with the reference's x."""
        breach = self.limits.check(
            self._make_odometry(at * MS, **changes),
            p_reference=None if reference is None else np.array([reference, 0.0, 2.0]),
            now_ns=at * MS,
        )
        return (breach.action.name, breach.reason) if breach is not None else ("", "")


@pytest.fixture
def watch(make_odometry: MakeOdometry) -> Watch:
    return Watch(CONFIG, make_odometry)


def at(x: float = 0.0, y: float = 0.0, z: float = 2.0) -> dict[str, Any]:
    return {"p_WB": np.array([x, y, z])}


def tilted(angle: float) -> dict[str, Any]:
    return {"q_WB_xyzw": Rotation.from_rotvec([0.6 * angle, 0.8 * angle, 0.0]).as_quat()}


def turning(x: float, y: float, z: float) -> dict[str, Any]:
    return {"w_WB_B": np.array([x, y, z])}


def flying(x: float, y: float, z: float) -> dict[str, Any]:
    return {"v_WB_B": np.array([x, y, z])}


@pytest.mark.parametrize(
    ("inside", "outside", "reason"),
    [
        (at(x=5.0), at(x=5.01), "x is 5.01 m, limits -5 to 5"),
        (at(x=-5.0), at(x=-5.01), "x is -5.01 m"),
        (at(y=3.0), at(y=3.5), "y is 3.50 m, limits -3 to 3"),
        (at(y=-3.0), at(y=-3.5), "y is -3.50 m"),
        (at(z=8.0), at(z=9.0), "z is 9.00 m, limits -1 to 8"),
        (at(z=-1.0), at(z=-2.0), "z is -2.00 m"),
    ],
)
def test_detects_breach_of_each_fence_wall(
    watch: Watch, inside: dict[str, Any], outside: dict[str, Any], reason: str
) -> None:
    assert watch.check(0, **inside) == ("", "")
    action, reported = watch.check(20, **outside)
    assert action == "HOVER"
    assert reason in reported


@pytest.mark.parametrize(
    ("inside", "outside", "reason"),
    [
        (tilted(0.99), tilted(1.01), "tilt is 1.01 rad, limit 1"),
        (tilted(-0.99), tilted(3.1), "tilt is 3.10 rad"),
        (turning(3.0, 4.0, 3.3), turning(3.0, 4.0, 3.4), "body rate is 6.0 rad/s, limit 6"),
        (flying(6.0, 7.9, 0.0), flying(0.0, 6.0, -8.1), "speed is 10.1 m/s, limit 10"),
    ],
)
def test_detects_breach_of_each_envelope_limit(
    make_odometry: MakeOdometry, inside: dict[str, Any], outside: dict[str, Any], reason: str
) -> None:
    watch = Watch(dataclasses.replace(CONFIG, fence=FenceParameters()), make_odometry)
    assert watch.check(0, **inside) == ("", "")
    action, reported = watch.check(20, **outside)
    assert action == "WARN"
    assert reason in reported


def test_default_limits_allow_any_position_and_attitude(make_odometry: MakeOdometry) -> None:
    watch = Watch(MpcConfig(), make_odometry)
    changes = {**at(1e5, -1e5, 1e5), **tilted(math.pi), **turning(20, 20, 20), **flying(30, 0, 0)}
    assert watch.check(0, **changes) == ("", "")


@pytest.mark.parametrize(
    ("velocity", "broken"),
    [
        (flying(3.0, 0.0, 0.0), False),  # 0.9 m of turning and 0.56 m of braking
        (flying(6.0, 0.0, 0.0), True),  # 1.8 m and 2.25 m
        (flying(-6.0, 0.0, 0.0), False),
        (flying(0.0, 0.0, -5.0), True),
        (flying(0.0, 0.0, 5.0), False),
    ],
)
def test_hover_action_considers_the_stopping_distance(
    make_odometry: MakeOdometry, velocity: dict[str, Any], *, broken: bool
) -> None:
    for action in ("warn", "stop"):
        fence = dataclasses.replace(CONFIG.fence, action=action)
        watch = Watch(dataclasses.replace(CONFIG, fence=fence), make_odometry)
        assert watch.check(0, **at(x=2.0), **velocity) == ("", "")
    watch = Watch(CONFIG, make_odometry)
    action, reported = watch.check(0, **at(x=2.0), **velocity)
    assert (action == "HOVER") == broken
    assert ("stopping point" in reported) == broken


def test_reports_most_severe_breach(watch: Watch) -> None:
    assert watch.check(0, **tilted(1.2))[0] == "WARN"
    assert watch.check(20, **tilted(1.2), **at(x=6.0))[0] == "HOVER"
    # The graver breach stays active.
    assert watch.check(40, **tilted(1.2)) == ("HOVER", watch.check(60, **tilted(1.2))[1])


def test_breach_ends_after_a_second_well_inside(watch: Watch) -> None:
    assert watch.check(0, **at(x=5.5))[0] == "HOVER"
    assert watch.check(100, **at(x=4.95))[0] == "HOVER"  # inside, but at the wall
    assert watch.check(5000, **at(x=4.95))[0] == "HOVER"
    assert watch.check(5100, **at(x=4.8))[0] == "HOVER"
    assert watch.check(5900, **at(x=4.8))[0] == "HOVER"
    assert watch.check(6000, **tilted(0.95))[0] == "HOVER"  # not calm: the count restarts
    assert watch.check(6100)[0] == "HOVER"
    assert watch.check(7099)[0] == "HOVER"
    assert watch.check(7100) == ("", "")


def test_breach_lasts_while_reference_is_outside(watch: Watch) -> None:
    assert watch.check(0, **at(x=5.5))[0] == "HOVER"
    for time in range(100, 5000, 100):
        assert watch.check(time, reference=5.2)[0] == "HOVER"
    assert watch.check(5000, reference=None)[0] == "HOVER"
    assert watch.check(5100)[0] == "HOVER"
    assert watch.check(6100) == ("", "")


def test_hover_position_is_well_inside(watch: Watch) -> None:
    inside = watch.limits.inside
    assert_allclose(inside(np.array([1.0, -2.0, 3.0])), [1.0, -2.0, 3.0])
    assert_allclose(inside(np.array([9.0, -9.0, -9.0])), [4.5, -2.5, -0.5])
    narrow = FenceParameters(minimum=(0.0, 0.0, 0.0), maximum=(0.4, 10.0, 10.0))
    limits = FlightLimits(dataclasses.replace(CONFIG, fence=narrow))
    assert_allclose(limits.inside(np.array([9.0, 5.0, 5.0])), [0.2, 5.0, 5.0])


def test_limits_change_in_flight(watch: Watch) -> None:
    fence = dataclasses.replace(CONFIG.fence, maximum=(1.0, 3.0, 8.0), action="stop")
    assert watch.check(0, **at(x=2.0)) == ("", "")
    watch.limits.reconfigure(dataclasses.replace(CONFIG, fence=fence))
    assert watch.check(20, **at(x=2.0))[0] == Action.STOP.name


def test_rejects_a_fence_without_interior() -> None:
    with pytest.raises(ConfigurationError, match=r"fence\.minimum.*below fence\.maximum"):
        FenceParameters(minimum=(0.0, 5.0, 0.0), maximum=(1.0, 5.0, 1.0))
