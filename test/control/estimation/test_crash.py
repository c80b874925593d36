# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Crashes are detected, and no flight is a crash."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from fixtures.presets import agile

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

PERIOD_NS, SECOND = 20_000_000, 1_000_000_000
ABOVE = ReferenceWindow.hover([0.0, 0.0, 3.0], duration=60.0)
UPSIDE_DOWN = math.radians(166.0)


def lying(
    seconds: float, *, tilt: float, height: Callable[[float], float] = lambda _: 0.0
) -> OdometrySample:
    """Return the odometry at a time of a vehicle that moves only along the vertical."""
    step = 1e-4
    climb = (height(seconds + step) - height(seconds - step)) / (2.0 * step)
    R_WB = so3.exp([tilt, 0.0, 0.0])
    return OdometrySample(
        stamp_ns=round(seconds * SECOND),
        p_WB=np.array([0.0, 0.0, height(seconds)]),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
        v_WB_B=R_WB.T @ np.array([0.0, 0.0, climb]),
        w_WB_B=np.zeros(3),
    )


def states_of(
    ground: GroundDetector, odometries: list[OdometrySample], *, thrust: float
) -> list[GroundState]:
    return [ground.update(each, thrust=thrust, window=ABOVE) for each in odometries]


def times(begin: float, end: float) -> Array:
    return np.arange(begin, end, 0.02)


@pytest.mark.parametrize("thrust", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("tilt", [100.0, 166.0, 180.0])
def test_detects_a_vehicle_upside_down_on_the_ground(tilt: float, thrust: float) -> None:
    ground = GroundDetector()
    found = states_of(
        ground, [lying(t, tilt=math.radians(tilt)) for t in times(0.0, 3.0)], thrust=thrust
    )
    since = found.index(GroundState.CRASHED) * 0.02
    assert 0.3 < since < 0.6
    assert set(found[found.index(GroundState.CRASHED) :]) == {GroundState.CRASHED}
    assert ground.state is GroundState.CRASHED


@pytest.mark.parametrize("noise", [0.005, 0.02])
def test_detects_a_crash_despite_noise(noise: float) -> None:
    random = np.random.default_rng(3)
    heights = {round(t, 2): random.normal(scale=noise) for t in times(0.0, 3.0)}
    ground = GroundDetector()
    for t in times(0.0, 3.0):
        given = lying(t, tilt=UPSIDE_DOWN)
        given.p_WB[2] = heights[round(t, 2)]
        ground.update(given, thrust=1.0, window=ABOVE)
    assert ground.state is GroundState.CRASHED


@pytest.mark.parametrize("gust", [0.0, 2.0])
@pytest.mark.parametrize("climb", [0.0, 1.0, 3.0, 6.0])
def test_inverted_ballistic_flight_is_not_a_crash(climb: float, gust: float) -> None:
    """Falling from rest, and over the top of a throw, with air that pushes it up."""
    fall = 9.81 - gust
    odometries = [
        lying(t, tilt=math.pi, height=lambda s: climb * s - 0.5 * fall * s * s)
        for t in times(0.0, 3.0)
    ]
    assert GroundState.CRASHED not in states_of(GroundDetector(), odometries, thrust=0.0)


def test_the_crash_ends_when_the_vehicle_falls() -> None:
    ground = GroundDetector()
    states_of(ground, [lying(t, tilt=math.pi) for t in times(0.0, 1.0)], thrust=1.0)
    assert ground.state is GroundState.CRASHED
    falls = [
        lying(t, tilt=math.pi, height=lambda s: -0.5 * 9.81 * max(s - 1.0, 0.0) ** 2)
        for t in times(1.0, 2.0)
    ]
    found = states_of(ground, falls, thrust=0.0)
    assert found.index(GroundState.FLYING) * 0.02 < 0.5
    assert found[-1] is GroundState.FLYING


def test_crash_state_ends_by_disengaging_not_by_uprighting() -> None:
    ground = GroundDetector()
    states_of(ground, [lying(t, tilt=math.pi) for t in times(0.0, 1.0)], thrust=1.0)
    states_of(ground, [lying(t, tilt=0.0) for t in times(1.0, 2.0)], thrust=0.0)
    assert ground.state is GroundState.CRASHED
    ground.engage(False)
    ground.engage(True)
    states_of(ground, [lying(t, tilt=0.0) for t in times(2.0, 2.1)], thrust=0.0)
    assert ground.state is not GroundState.CRASHED


def collided(
    ground: GroundDetector, *, thrust: float, rises: float = 0.0, until: float = 4.0
) -> list[GroundState]:
    """Fall at 6 m/s for half a second, stop at once, and rise from there."""

    def height(seconds: float) -> float:
        return -6.0 * min(seconds - 0.51, 0.0) + 0.5 * rises * max(seconds - 0.51, 0.0) ** 2

    return states_of(
        ground, [lying(t, tilt=0.0, height=height) for t in times(0.0, until)], thrust=thrust
    )


def test_no_rise_with_thrust_after_a_collision_is_a_crash() -> None:
    found = collided(GroundDetector(), thrust=4.0)
    assert found[-1] is GroundState.CRASHED
    assert 1.0 < found.index(GroundState.CRASHED) * 0.02 - 0.51 < 1.5


@pytest.mark.parametrize(("rests", "crashed"), [(3.0, True), (6.0, False)])
def test_a_collision_counts_for_five_seconds(rests: float, crashed: bool) -> None:
    """A crash is detected within that time, under thrust."""
    ground, again = GroundDetector(), 0.5 + rests
    collided(ground, thrust=1.0, until=again)
    found = states_of(ground, [lying(t, tilt=0.0) for t in times(again, again + 4.0)], thrust=4.0)
    assert (GroundState.CRASHED in found) is crashed


@pytest.mark.parametrize("thrust", [1.0, 2.0])
def test_thrust_near_the_weight_is_not_evidence_of_a_crash(thrust: float) -> None:
    assert GroundState.CRASHED not in collided(GroundDetector(), thrust=thrust)


def test_a_rise_after_a_collision_is_no_crash() -> None:
    assert GroundState.CRASHED not in collided(GroundDetector(), thrust=4.0, rises=2.0)


def test_rest_under_thrust_without_a_collision_is_not_a_crash() -> None:
    """Motors may not be armed yet."""
    found = states_of(GroundDetector(), [lying(t, tilt=0.0) for t in times(0.0, 6.0)], thrust=4.0)
    assert GroundState.CRASHED not in found


def ticks_of(odometries: list[OdometrySample]) -> list[Tick]:
    controller, ticks = Controller(MpcConfig()), []
    for odometry in odometries:
        tick = controller.step(odometry, ABOVE)
        assert tick is not None
        ticks.append(tick)
    return ticks


def test_idles_counts_and_reports_a_crash() -> None:
    ticks = ticks_of([lying(t, tilt=UPSIDE_DOWN) for t in times(1.0, 3.0)])
    last = ticks[-1]
    assert last.command is not None
    assert last.command.throttle == MpcConfig().throttle_min
    assert np.all(last.command.w_WB_B == 0.0)
    assert last.stats.source == "idle" and last.stats.ground == "crashed"
    assert last.stats.reason.startswith("crashed: the vehicle is upside down")
    assert last.stats.fallbacks > 60


@pytest.mark.parametrize("seed", range(6))
def test_recovers_from_any_attitude_in_free_fall(seed: int) -> None:
    random = np.random.default_rng(seed)
    q_xyzw = random.normal(size=4)
    if seed < 4:  # upside down, at rest and thrown
        q_xyzw = np.array([1.0, 0.05 * seed, 0.0, 0.02])
    simulator = SimulatorConfig(
        duration=4.0,
        initial_position=(0.0, 0.0, 30.0),
        initial_attitude=tuple((q_xyzw / np.linalg.norm(q_xyzw)).tolist()),
        initial_velocity=(0.0, 0.0, float(seed % 4) * 2.0),
    )
    reference = ReferenceConfig(trajectory="hover", height=30.0)
    mpc = agile() if seed % 2 else MpcConfig()
    for step in fly(mpc=mpc, simulator=simulator, reference=reference):
        assert step.tick is not None
        assert step.tick.stats.ground != "crashed"
        assert step.tick.stats.source in ("mpc", "hover")
    assert step.truth.up > 0.9
    assert step.truth.p_WB[2] > 25.0
