# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry that contradicts itself or the commands, and odometry that does not."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import wrong_odometry
from fixtures.presets import agile
from wrong_odometry import CONVENTIONS, FAULTS, VEHICLES, flight, is_found, outcome

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.consistency import motion_contradiction

CLIMBS = "throttle reversed"  # as long as it receives commands
# Yaw has little authority; a heading of 180 degrees drives this plant's motors to their limits.
SLOW_TO_FIND = {"yaw command reversed", "rates ignored", "held by hand"}
WORDS = {
    "NED and FRD": "NED",
    "position in NED": "NED",
    "twist in FRD": "FRD",
    "z down": "z",
    "x reversed": "x",
    "x and y swapped": "swapped",
    "heading off by 90 degrees": "heading",
    "attitude conjugated": "conjugated",
    "rates in deg/s": "deg/s",
    "roll rate reversed": "roll rate",
    "velocity reversed": "velocity",
    "velocity in cm/s": "cm/s",
    "position in cm": "cm",
    "roll command reversed": "roll",
    "no thrust": "motor",
    "a rotor blocked": "rotor",
    "held by hand": "held",
}


@pytest.mark.parametrize(
    "case", [*CONVENTIONS, *[name for name in FAULTS if name != CLIMBS], *VEHICLES]
)
def test_a_contradiction_in_the_air_ends_in_a_descent_near_the_start(case: str) -> None:
    found = outcome(list(flight(case)))
    fallen_at_once = case == "world NED, body FLU"  # upside down to the MPC, which turns it over
    assert found.farthest[0] < 4.0  # one that is off by its heading drifts furthest
    assert found.farthest[1] < 2.5
    assert fallen_at_once or found.found_after is not None
    if not fallen_at_once and case not in SLOW_TO_FIND:
        assert found.found_after < 2.0
        assert found.found_at[0] < 0.8
    assert WORDS.get(case, "") in found.reason


@pytest.mark.parametrize(
    "case", ["NED and FRD", "z down", "twist in FRD", "roll command reversed", "rates in deg/s"]
)
def test_a_take_off_with_wrong_axes_is_stopped_at_a_third_of_a_metre(case: str) -> None:
    found = outcome(list(flight(case, start="ground")))
    assert found.found_after is not None
    assert found.found_at[1] < 0.31
    assert found.farthest[0] < 0.5
    assert found.farthest[1] < 0.8


@pytest.mark.parametrize(
    "case",
    [
        "x reversed",
        "x and y swapped",
        "x of the position reversed",
        "heading off by 90 degrees",
        "heading off by 180 degrees",
        "heading off by 90 degrees, velocity right",
        "roll rate reversed",
    ],
)
def test_take_off_circle_detects_wrong_axes_before_the_climb(case: str) -> None:
    found = outcome(list(flight(case, start="ground")))
    assert found.found_after is not None
    assert found.found_after - wrong_odometry.TAKE_OFF_AT < 3.0
    assert found.farthest[0] < 1.6
    assert found.farthest[1] < 0.6


@pytest.mark.parametrize("start", wrong_odometry.STARTS)
def test_commands_end_soon_after_a_vehicle_climbs_by_less_throttle(start: str) -> None:
    """No command lowers it; in silence the failsafe of the autopilot acts."""
    moments = list(flight(CLIMBS, start=start, duration=2.0))
    found = outcome(moments)
    assert found.found_after is not None
    assert found.found_after < 0.5
    assert found.found_at[1] < 1.2
    assert "reversed" in found.reason
    assert moments[-1].source == "silent"


@pytest.mark.parametrize("start", wrong_odometry.STARTS)
@pytest.mark.parametrize("plant", ["rotors", "internal"])
def test_finds_no_contradiction_in_correct_odometry(start: str, plant: str) -> None:
    moments = list(flight("right", start=start, plant=plant, wind=(3.0, 2.0, 0.0)))
    assert {moment.source for moment in moments} == {"mpc"}
    assert not any(is_found(moment.reason) for moment in moments)


@pytest.mark.parametrize("action", ["warn", "hover", "descend", "stop"])
def test_a_contradiction_ends_in_the_configured_action(action: str) -> None:
    config = MpcConfig().updated({"consistency.action": action})
    moments = list(flight("z down", mpc=config, duration=0.6))
    found = [moment.source for moment in moments if is_found(moment.reason)]
    expected = {"warn": "mpc", "hover": "hover", "descend": "blind", "stop": "silent"}
    assert found[0] == expected[action]


def test_never_resumes_automatically_after_a_contradiction() -> None:
    moments = list(flight("z down", duration=4.0, initial_position=(0.0, 0.0, 60.0)))
    sources = [moment.source for moment in moments]
    first = sources.index("blind")
    assert set(sources[first:]) == {"blind", "silent"}


def _moving(*, count: int = 100, **changed: Any) -> list[OdometrySample]:
    """Return odometries on a circle of 1 m in 4 s, turning with it; with some values changed."""
    samples = []
    for k in range(count):
        angle = 2.0 * math.pi * k * 0.02 / 4.0
        rate = 2.0 * math.pi / 4.0
        R_WB = so3.exp(np.array([0.0, 0.0, angle]))
        sample = OdometrySample(
            stamp_ns=1_000_000_000 + k * 20_000_000,
            p_WB=np.array([math.sin(angle), -math.cos(angle), 1.0]),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
            v_WB_B=np.array([rate, 0.0, 0.0]),
            w_WB_B=np.array([0.0, 0.0, rate]),
            frame_id="odom",
            child_frame_id="base_link",
        )
        values = {name: change(getattr(sample, name)) for name, change in changed.items()}
        samples.append(dataclasses.replace(sample, **values))
    return samples


def test_a_moving_odometry_is_checked_without_any_command() -> None:
    config = agile()
    assert motion_contradiction(_moving(), config) is None
    for changed in (
        {"w_WB_B": np.negative},
        {"w_WB_B": np.degrees},
        {"v_WB_B": np.negative},
        {"p_WB": lambda p: 100.0 * p},
        {"v_WB_B": lambda v: v[[1, 0, 2]]},
    ):
        assert motion_contradiction(_moving(**changed), config) is not None


def test_one_jump_of_the_position_or_of_the_heading_is_no_contradiction() -> None:
    samples = _moving()
    turn = so3.exp(np.array([0.0, 0.0, 0.5]))
    jumped = [
        dataclasses.replace(
            each,
            p_WB=turn @ each.p_WB + np.array([0.7, 0.0, 0.0]),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(
                turn @ so3.rotation_from_quaternion_xyzw(each.q_WB_xyzw)
            ),
        )
        for each in samples[50:]
    ]
    assert motion_contradiction([*samples[:50], *jumped], agile()) is None
