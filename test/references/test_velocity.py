# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A path that follows velocity commands: limits and continuity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import End
from quad_mpc_ros.references.transition import FlatState
from quad_mpc_ros.references.velocity import (
    STEP_NS,
    VelocityCommand,
    VelocityLimits,
    VelocityPath,
    first_points,
    followed,
)

STEP = 1e-9 * STEP_NS
LIMITS = VelocityLimits(
    speed=3.0,
    acceleration=2.0,
    yaw_rate=2.0,
    yaw_acceleration=4.0,
    lowest=(-4.0, -2.0, 0.3),
    highest=(4.0, 2.0, 3.0),
)
HERE = FlatState.at_rest(np.array([0.5, -0.2, 1.5]), yaw=3.0)


def command(
    *velocity: float, yaw_rate: float = 0.0, heading_aligned: bool = False
) -> VelocityCommand:
    return VelocityCommand(
        velocity=np.array(velocity), yaw_rate=yaw_rate, heading_aligned=heading_aligned
    )


def flown(commands: list[VelocityCommand], *, start: FlatState = HERE) -> list[VelocityPath]:
    """Return the paths of commands that come one after the other at irregular times."""
    times = np.random.default_rng(len(commands)).uniform(0.01, 0.4, len(commands))
    known, since, paths = first_points(start), 0.0, []
    for each, until in zip(commands, times.tolist(), strict=True):
        paths.append(followed(known, each, LIMITS, held=since + 0.5))
        steps = min(int((since + until) / STEP), round(paths[-1].duration / STEP) - 1)
        known, since = paths[-1].fixed(steps), since + until - steps * STEP
    return paths


def any_commands(count: int, *, seed: int) -> list[VelocityCommand]:
    """Return adverse commands: any direction, too fast, back and forth."""
    rng = np.random.default_rng(seed)
    return [
        command(
            *rng.normal(0.0, 4.0, 3),
            yaw_rate=rng.normal(0.0, 3.0),
            heading_aligned=bool(rng.integers(2)),
        )
        for _ in range(count)
    ]


def samples(path: VelocityPath) -> dict[str, Array]:
    return vars(path.at(np.linspace(0.0, path.duration, 400)))


@pytest.mark.parametrize("seed", range(5))
def test_commands_never_exceed_limits_or_box(seed: int) -> None:
    for path in flown(any_commands(60, seed=seed)):
        seen = samples(path)
        slack = 1e-6
        assert np.linalg.norm(seen["v_WB_W"], axis=1).max() <= LIMITS.speed + slack
        assert np.linalg.norm(seen["a_WB_W"], axis=1).max() <= LIMITS.acceleration + slack
        assert np.abs(seen["yaw_rate"]).max() <= LIMITS.yaw_rate + slack
        assert np.linalg.norm(seen["j_WB_W"], axis=1).max() <= 2 * LIMITS.acceleration / STEP
        assert (seen["p_WB"] >= np.array(LIMITS.lowest) - slack).all()
        assert (seen["p_WB"] <= np.array(LIMITS.highest) + slack).all()


def test_every_path_brakes_and_ends_at_rest() -> None:
    for path in flown(any_commands(40, seed=7)):
        end = path.at(np.array([path.duration]))
        for name in ("v_WB_W", "a_WB_W", "j_WB_W", "yaw_rate"):
            assert_allclose(getattr(end, name), 0.0, atol=1e-6)


def test_new_command_does_not_change_the_current_step() -> None:
    one = followed(first_points(HERE), command(1.0, 0.0, 0.0), LIMITS, held=0.5)
    other = followed(one.fixed(4), command(-2.0, 1.0, 0.5, yaw_rate=1.0), LIMITS, held=0.5)
    inside = np.linspace(0.0, STEP, 50)
    for name, before in vars(one.at(4 * STEP + inside)).items():
        assert_allclose(getattr(other.at(inside), name), before, atol=1e-9, err_msg=name)


def test_starts_in_the_current_motion() -> None:
    end = End(
        p_WB=np.array([1.0, 0.5, 2.0]),
        v_WB_W=np.array([1.0, -0.5, 0.2]),
        a_WB_W=np.array([0.5, 0.3, -0.4]),
        j_WB_W=np.array([1.0, 2.0, -1.0]),
    )
    state = FlatState(end=end, yaw=-3.1, yaw_rate=-0.4)
    begun = followed(first_points(state), command(0.0, 1.0, 0.0), LIMITS, held=0.5)
    first = begun.at(np.zeros(1))
    for name in ("p_WB", "v_WB_W", "a_WB_W", "j_WB_W"):
        assert_allclose(getattr(first, name)[0], getattr(end, name), atol=1e-9)
    assert_allclose([first.yaw, first.yaw_rate], [[-3.1], [-0.4]], atol=1e-9)


@pytest.mark.parametrize(
    ("wanted", "heading_aligned", "direction"),
    [
        ((0.5, 0.0, 0.0), False, (0.5, 0.0, 0.0)),
        ((0.5, 0.0, 0.0), True, (0.0, 0.5, 0.0)),  # the nose points north
        ((0.0, 0.5, 0.0), True, (-0.5, 0.0, 0.0)),
        ((0.0, 0.0, 0.5), True, (0.0, 0.0, 0.5)),
    ],
)
def test_forward_is_where_the_nose_points(
    wanted: tuple[float, ...], heading_aligned: bool, direction: tuple[float, ...]
) -> None:
    north = FlatState.at_rest(np.array([0.0, 0.0, 1.5]), yaw=math.pi / 2)
    asked = command(*wanted, heading_aligned=heading_aligned)
    path = followed(first_points(north), asked, LIMITS, held=1.5)
    reached = path.at(np.array([1.0])).v_WB_W[0]
    assert_allclose(reached, direction, atol=1e-6)


def test_forward_direction_turns_with_the_heading() -> None:
    path = followed(
        first_points(HERE), command(0.5, 0.0, 0.0, yaw_rate=1.0, heading_aligned=True), LIMITS,
        held=6.0,
    )  # fmt: skip
    late = path.at(np.linspace(2.0, 5.5, 50))
    course = np.arctan2(late.v_WB_W[:, 1], late.v_WB_W[:, 0])
    # Past pi and on: the nose by the path, the course by arctan2.
    off = np.angle(np.exp(1j * (course - np.asarray(late.yaw))))
    assert np.abs(off).max() < 0.1
    assert np.asarray(late.yaw).max() > math.pi
    assert np.abs(np.diff(np.asarray(late.yaw))).max() < 0.1  # no jump there


def test_slides_along_a_wall() -> None:
    path = followed(first_points(HERE), command(0.5, 2.5, 0.0), LIMITS, held=5.0)
    late = path.at(np.array([4.5]))
    assert late.p_WB[0, 1] > LIMITS.highest[1] - 0.2
    assert_allclose(late.v_WB_W[0, 0], 0.5, atol=0.05)


def test_outside_the_box_only_inward_motion_is_permitted() -> None:
    outside = FlatState.at_rest(np.array([6.0, 0.0, 1.5]), yaw=0.0)
    out = followed(first_points(outside), command(1.0, 0.0, 0.0), LIMITS, held=3.0)
    assert samples(out)["p_WB"][:, 0].max() <= 6.0 + 1e-9
    back = followed(first_points(outside), command(-1.0, 0.0, 0.0), LIMITS, held=4.0)
    assert samples(back)["p_WB"][-1, 0] < 4.0


def test_brakes_within_the_stopping_distance_after_the_timeout() -> None:
    path = followed(first_points(HERE), command(1.0, 0.0, 0.0), LIMITS, held=1.5)
    late = path.at(np.array([1.5 - 3 * STEP]))  # a spline rounds what is to come off before
    assert_allclose(late.v_WB_W[0], [1.0, 0.0, 0.0], atol=1e-6)
    travelled = samples(path)["p_WB"][-1, 0] - late.p_WB[0, 0]
    braking = 1.0**2 / (2.0 * LIMITS.acceleration)
    assert braking < travelled < braking + 1.0 * 3.5 * STEP


def test_numbers_that_are_not_finite_are_refused() -> None:
    with pytest.raises(ValueError, match="expected finite numbers"):
        command(math.nan, 0.0, 0.0)
    with pytest.raises(ValueError, match="expected finite numbers"):
        command(0.0, 0.0, 0.0, yaw_rate=math.inf)
    with pytest.raises(ValueError, match="expected finite numbers"):
        command(1.7e308, 1.7e308, 0.0)


def test_a_stop_from_any_speed_ends_within_half_a_minute() -> None:
    end = End(
        p_WB=np.zeros(3), v_WB_W=np.array([1e5, 0.0, 0.0]), a_WB_W=np.zeros(3), j_WB_W=np.zeros(3)
    )
    start = FlatState(end=end, yaw=0.0)
    path = followed(first_points(start), command(1.0, 0.0, 0.0), LIMITS, held=0.5)
    assert path.duration < 32.0
