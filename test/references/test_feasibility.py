# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Feasibility of references, compared with hand calculations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory, judged_trajectory
from quad_mpc_ros.references.feasibility import Feasibility, Need


def verdict(**changes: object) -> Feasibility:
    return judged_trajectory(ReferenceConfig.build(changes))[1]


def need(found: Feasibility, name: str) -> Need:
    return next(need for need in found.needs if need.name == name)


def test_hover_requires_only_the_hover_throttle() -> None:
    found = verdict(trajectory="hover")
    assert found.feasible
    assert found.reason() == ""
    for name in ("highest throttle", "lowest throttle"):
        assert need(found, name).worst == pytest.approx(0.2923008, abs=1e-7)
    assert need(found, "highest throttle").margin == pytest.approx(1.0 - 0.2923008, abs=1e-7)
    for axis in ("roll", "pitch", "yaw"):
        assert need(found, f"{axis} rate").worst == 0.0
    assert need(found, "lowest height").worst == 2.0


@pytest.mark.parametrize(("radius", "speed"), [(2.0, 3.0), (5.0, 8.0), (1.0, 4.0)])
def test_a_circle_needs_its_centripetal_force_and_its_drag(radius: float, speed: float) -> None:
    found = verdict(trajectory="circle", circle_radius=radius, circle_speed=speed)
    force = 0.396893 * math.hypot(9.81, speed**2 / radius, 0.2 * speed)
    vehicle = Vehicle()
    assert vehicle.thrust(need(found, "highest throttle").worst) == pytest.approx(force)
    assert found.over_time.speed.max() == pytest.approx(speed)
    assert found.over_time.acceleration.max() == pytest.approx(speed**2 / radius)
    # The thrust axis goes round a cone: its tilt times the frequency is the fastest turn.
    tilt = math.atan2(math.hypot(speed**2 / radius, 0.2 * speed), 9.81)
    turned = np.linalg.norm(found.over_time.w_WB_B[:, :2], axis=1)
    assert turned.max() == pytest.approx(math.sin(tilt) * speed / radius, rel=1e-6)


def test_reports_excess_with_time_and_amount() -> None:
    limits = {
        "throttle_max": 0.5,
        "omega_max": [6.0, 30.0 / 7.0, 6.0],
    }
    found = verdict(trajectory="vertical_loop", **limits)
    assert not found.feasible
    assert [need.name for need in found.exceeded] == ["highest throttle", "pitch rate"]
    worst = need(found, "pitch rate")
    assert worst.time == pytest.approx(1.32, abs=0.02)  # the top
    assert worst.margin == pytest.approx(5.0 - worst.worst)
    with pytest.raises(ConfigurationError) as error:
        configured_trajectory(ReferenceConfig.build({"trajectory": "vertical_loop", **limits}))
    for word in ("highest throttle 0.62", "0.12", "pitch rate 7.1", "at 1.3", "rad/s beyond"):
        assert word in str(error.value)


def test_margin_reserves_its_share_of_the_range_to_every_limit() -> None:
    loop = {"trajectory": "vertical_loop"}
    assert verdict(**loop, limit_margin=0.3).feasible
    short = verdict(**loop, limit_margin=0.6)
    assert [need.name for need in short.exceeded] == ["highest throttle"]
    assert need(short, "pitch rate").limit == pytest.approx(0.4 * 7.0 * math.pi)
    hover = 0.2923008
    assert need(short, "highest throttle").limit == pytest.approx(hover + 0.4 * (1.0 - hover))
    assert need(short, "lowest throttle").limit == pytest.approx(0.6 * hover)
    assert verdict(trajectory="hover", limit_margin=0.99).feasible


def test_reports_downward_thrust_as_negative_throttle() -> None:
    """Also where the curve is level at no throttle."""
    curve = [6.445, 0.0, 0.0]
    found = verdict(trajectory="flip", drag=[0.86, 0.86, 0.0], thrust_curve=curve, mass=0.752)
    lowest = need(found, "lowest throttle")
    assert [need.name for need in found.exceeded] == ["lowest throttle"]
    # Falling at 4.5 m/s the path has 0.86 1/s of drag along z, which the vehicle has not.
    downwards = 4.0 * curve[0] * lowest.worst**2
    assert 0.0 < downwards < 0.752 * 0.86 * 4.5
    assert -0.2 < lowest.worst < 0.0


def test_rejects_a_path_below_the_ground() -> None:
    found = verdict(trajectory="minimum_snap", waypoints=[0, 0, 1.0, 2, 0, -0.3, 4, 0, 1.0])
    assert [need.name for need in found.exceeded] == ["lowest height"]
    assert need(found, "lowest height").worst <= -0.2999


def test_reports_jumps_and_accepts_them() -> None:
    found = verdict(trajectory="square")
    assert not found.feasible
    assert found.jumps == (2.0, 4.0, 6.0)
    assert "3 jumps, the first at 2.000 s" in found.reason()
    assert not configured_trajectory(ReferenceConfig()).smooth


@pytest.mark.parametrize(
    "changes",
    [
        {"trajectory": "lemniscate", "angular_frequency": 5.0},
        {"trajectory": "circle", "circle_speed": 14.0},
        {"trajectory": "minimum_snap", "max_speed": 99.0, "max_acceleration": 70.0},
    ],
)
def test_slows_down_no_more_than_necessary(changes: dict[str, object]) -> None:
    quick, found = judged_trajectory(ReferenceConfig.build(changes))
    assert not found.feasible
    slow, found = judged_trajectory(
        ReferenceConfig.build({**changes, "time_scaling": "auto", "limit_margin": 0.05})
    )
    assert found.feasible
    factor = slow.period_ns / quick.period_ns
    assert factor > 1.02
    # At the limit, and the same places at other times.
    left = min((n.margin / abs(n.limit)) for n in found.needs if n.name != "lowest throttle")
    assert left < 0.05
    times = np.linspace(0, quick.period_ns, 50)
    before = quick.at(times.astype(int).tolist()).p_WB
    after = slow.at((factor * times).astype(int).tolist()).p_WB
    assert np.abs(before - after).max() < 1e-6


def test_does_not_slow_a_feasible_reference() -> None:
    for name in ("lemniscate", "minimum_snap", "vertical_loop"):
        plain, _ = judged_trajectory(ReferenceConfig(trajectory=name))
        auto, _ = judged_trajectory(ReferenceConfig(trajectory=name, time_scaling="auto"))
        assert plain.period_ns == auto.period_ns


def test_slowing_does_not_help_loop_or_underground() -> None:
    with pytest.raises(ConfigurationError, match="change the parameters of vertical_loop"):
        configured_trajectory(
            ReferenceConfig(trajectory="vertical_loop", throttle_max=0.5, time_scaling="auto")
        )
    with pytest.raises(ConfigurationError, match="slowing down does not help"):
        configured_trajectory(
            ReferenceConfig(
                trajectory="minimum_snap",
                waypoints=(0, 0, 1.0, 2, 0, -0.3, 4, 0, 1.0),
                time_scaling="auto",
            )
        )


def test_free_fall_is_refused_with_its_time() -> None:
    # Without drag this crosses its origin level, where nothing but the weight is left to carry.
    falling = ReferenceConfig(
        trajectory="lemniscate", gravity=1e-6, drag=0.0, mass=1e5, amplitude_y=0.0
    )
    with pytest.raises(ConfigurationError, match=r"at 0\.000 s .*free fall"):
        configured_trajectory(falling)


@pytest.mark.parametrize(("name", "value"), [("min", 0.3), ("max", 0.2)])
def test_limits_that_forbid_hovering_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigurationError, match=rf"reference\.throttle_{name}: given {value}"):
        ReferenceConfig.build({f"throttle_{name}": value})


@pytest.mark.parametrize(
    "changes",
    [
        # Over in milliseconds, and judged all the same.
        {"trajectory": "minimum_snap", "max_speed": 1e3, "max_acceleration": 1e3},
        {"trajectory": "vertical_loop", "loop_speed": 1e3},
        {"trajectory": "vertical_loop", "loop_radius": 1e-6},
        {"trajectory": "circle", "circle_speed": 1e3, "circle_radius": 1e-9},
        {"trajectory": "flip", "flip_rate": 1e3},
        {"trajectory": "flip", "drag": 50.0},
        {"trajectory": "lemniscate", "amplitude_x": 1e300, "time_scaling": "auto"},
        {"trajectory": "lemniscate", "angular_frequency": 1e200},
        {"trajectory": "lemniscate", "mass": 1.8},
    ],
)
def test_refuses_absurd_values_in_one_line(changes: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError, match=r"^reference\.trajectory: given ") as error:
        configured_trajectory(ReferenceConfig.build(changes))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "changes",
    [
        {"trajectory": "flip", "flip_rate": 1.0},
        {"trajectory": "flip", "coasting_thrust": 1.0},
        {"trajectory": "flip", "drag": 0.0},
        {"trajectory": "circle", "circle_speed": 1e-6},
        {"trajectory": "minimum_snap", "waypoints": [0, 0, 1, 1e4, 0, 1, 1e4, 1, 1]},
        {"trajectory": "waypoints", "waypoints": [x for k in range(80) for x in (k % 3, k, 2)]},
    ],
)
def test_accepts_unusual_values(changes: dict[str, object]) -> None:
    assert verdict(**changes).feasible
