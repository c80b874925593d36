# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Announced steps of the estimate in flight: the vehicle keeps its true position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import joined_trajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.simulation.closed_loop import fly

SECOND = 1_000_000_000
HEIGHT, STEP_W = 2.0, np.array([1.2, -1.6, 0.4])
REFERENCE = {"mode": "on_request", "takeoff_height": HEIGHT}
GROUND = {"duration": 17.0, "wind": (3.0, 1.0, 0.0), "drag": 0.3}


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """Positions, tilts and sources of commands from a second before the step on."""

    p_WB: Array
    tilt: Array
    sources: set[Source]


def flown(
    mpc: MpcConfig, *, turn: float, announced: bool, silent: bool = False, of_goal: bool = False
) -> Flight:
    """Take off in wind, hold, and let the estimate step after ten seconds.

    ``silent`` ends the reference before, so that the hover fallback holds. ``of_goal`` is held
    after a goal instead of the take-off.
    """
    controller, config = Controller(mpc), ReferenceConfig.build(REFERENCE)
    live = LiveReference(
        config, joined_trajectory(config), joined=lambda: joined_trajectory(config)
    )
    reset: EstimateReset | None = None
    begin_ns, goal = 0, [0.5, 0.5, HEIGHT]
    sources: set[Source] = set()

    def law(odometry: OdometrySample, _: ReferenceWindow) -> CommandSample | None:
        nonlocal reset, begin_ns, of_goal
        now_ns = odometry.stamp_ns
        if reset is None and begin_ns and now_ns >= begin_ns + 10 * SECOND:
            reset = EstimateReset(stamp_ns=now_ns, turn=turn, step_W=STEP_W)
            if announced:
                controller.reset_estimate(reset)
                live.reset_estimate(now_ns, reset)
        if reset is not None:
            odometry = reset.odometry(odometry)
        live.observe(odometry)
        if not begin_ns:
            begin_ns = now_ns
            assert live.take_off(now_ns).accepted
        if of_goal and now_ns >= begin_ns + 5 * SECOND:
            of_goal = False
            level = np.array([0.0, 0.0, 0.0, 1.0])
            assert live.go_to(
                now_ns, frame_id="odom", p_WB=np.array(goal), q_WB_xyzw=level
            ).accepted
        if not silent or now_ns < begin_ns + 6 * SECOND:
            window = live.window(now_ns)
            assert window is not None
            controller.receive_reference(window, now_ns=now_ns)
        tick = controller.receive_odometry(odometry, now_ns=now_ns)
        if tick is None:
            return None
        if now_ns >= begin_ns + 9 * SECOND:
            sources.add(tick.decision.source)
        return tick.command

    steps = list(fly(simulator=ideal(GROUND), controller=law, reference=config))
    late = [step for step in steps if step.truth.stamp_ns >= begin_ns + 9 * SECOND]
    up = np.clip([step.truth.up for step in late], -1.0, 1.0)
    return Flight(
        p_WB=np.array([step.truth.p_WB for step in late]),
        tilt=np.degrees(np.arccos(up)),
        sources=sources,
    )


def moved(flight: Flight) -> float:
    """The distance of the vehicle from its place before the step."""
    return float(np.linalg.norm(flight.p_WB - flight.p_WB[0], axis=1).max())


@pytest.mark.parametrize(("mpc", "turn"), [(MpcConfig(), 1.0), (agile(), 0.0)])
def test_holds_its_position_through_an_announced_reset(mpc: MpcConfig, turn: float) -> None:
    flight = flown(mpc, turn=turn, announced=True)
    assert flight.sources == {Source.MPC}
    assert moved(flight) < 0.01
    assert np.ptp(flight.tilt) < 1.0


def test_follows_an_unannounced_reset_of_the_estimate() -> None:
    flight = flown(MpcConfig(), turn=0.0, announced=False)
    assert moved(flight) == pytest.approx(np.linalg.norm(STEP_W), abs=0.1)


def test_holds_a_reached_goal() -> None:
    assert moved(flown(MpcConfig(), turn=0.5, announced=True, of_goal=True)) < 0.01


def test_the_hover_fallback_holds_its_position() -> None:
    flight = flown(MpcConfig(), turn=1.0, announced=True, silent=True)
    assert flight.sources == {Source.HOVER}
    assert moved(flight) < 0.03
