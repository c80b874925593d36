# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fence, envelope and deadline in the closed loop of controller and plant."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.config import (
    EnvelopeParameters,
    FenceParameters,
    MpcConfig,
)
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.mpc import Mpc
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.config import make_plant

PERIOD = 20_000_000
START = 1_000_000_000
AIR = (0.0, 0.0, 2.0)


class Loop:
    """Controller, plant and a hover reference, which can be moved or taken away."""

    def __init__(self, mpc: MpcConfig, *, start: tuple[float, ...] = AIR) -> None:
        self.controller = Controller(mpc)
        self._plant = make_plant(ideal(initial_position=start))
        self._servers: dict[tuple[float, ...], ReferenceServer] = {}
        self.now = START

    def fly(
        self, seconds: float, *, to: tuple[float, ...] | None = AIR
    ) -> Iterator[tuple[OdometrySample, Tick]]:
        for _ in range(round(seconds * 50)):
            self._plant.advance_to(self.now - START)
            odometry = self._plant.odometry(self.now)
            if to is not None:
                window = self._window(to)
                self.controller.receive_reference(window, now_ns=self.now)
            tick = self.controller.receive_odometry(odometry, now_ns=self.now)
            assert tick is not None
            if tick.command is not None:
                self._plant.apply(tick.command)
            self.now += PERIOD
            yield odometry, tick

    def last(self, seconds: float, *, to: tuple[float, ...] | None = AIR) -> tuple[str, float]:
        """Fly and return the last source and the last x."""
        *_, (odometry, tick) = self.fly(seconds, to=to)
        return tick.stats.source, float(odometry.p_WB[0])

    def _window(self, to: tuple[float, ...]) -> ReferenceWindow:
        if to not in self._servers:
            self._servers[to] = ReferenceServer(ReferenceConfig(trajectory="hover"))
            self._servers[to].start(START)
        window = self._servers[to].window(self.now)
        return dataclasses.replace(window, p_WB=np.tile(to, (len(window.p_WB), 1)))


def fence(action: str) -> MpcConfig:
    return agile(
        fence=FenceParameters(minimum=(-2.0, -2.0, -1.0), maximum=(2.0, 2.0, 5.0), action=action)
    )


@pytest.mark.parametrize("distance", [3.0, 6.0, 20.0])
def test_stays_inside_fence_when_reference_leaves_it(distance: float) -> None:
    loop = Loop(fence("hover"))
    beyond = (distance, 0.0, 2.0)
    flown = list(loop.fly(8.0, to=beyond))
    assert max(abs(odometry.p_WB[0]) for odometry, _ in flown) < 2.0
    assert max(odometry.speed for odometry, _ in flown) > 2.0
    source, x = loop.last(0.02, to=beyond)
    assert source == "hover"
    assert abs(x) < 1.6
    assert loop.last(0.9)[0] == "hover"
    source, x = loop.last(4.0)
    assert source == "mpc"
    assert x == pytest.approx(0.0, abs=0.02)


def test_stop_action_ends_publishing() -> None:
    loop = Loop(fence("stop"))
    ticks = [tick for _, tick in loop.fly(4.0, to=(6.0, 0.0, 2.0))]
    sources = [tick.stats.source for tick in ticks]
    silent = sources.index("silent")
    assert set(sources[:silent]) == {"mpc"}
    assert set(sources[silent:]) == {"silent"}
    assert all(tick.command is None for tick in ticks[silent:])
    assert "outside the fence: x is 2." in ticks[-1].stats.reason


def test_hovers_beyond_the_envelope_until_a_second_inside() -> None:
    config = agile(envelope=EnvelopeParameters(speed_max=3.0, action="hover"))
    loop = Loop(config)
    flown = list(loop.fly(6.0, to=(6.0, 0.0, 2.0)))
    sources = [tick.stats.source for _, tick in flown]
    first = sources.index("hover")
    speeds = [odometry.speed for odometry, _ in flown]
    assert speeds[first] > 3.0
    assert max(speeds[:first]) <= 3.0
    again = sources.index("mpc", first)
    assert set(sources[first:again]) == {"hover"}
    calm = next(k for k in range(first, len(speeds)) if speeds[k] < 2.7)
    assert again - calm == pytest.approx(50, abs=1)


def test_solver_stops_at_its_time_limit() -> None:
    """Without time no plan is ever ready, so the MPC waits."""
    loop = Loop(MpcConfig())
    loop.controller = Controller(MpcConfig(), deadline=1e-9)
    ticks = [tick for _, tick in loop.fly(0.2)]
    assert {tick.stats.source for tick in ticks} == {"waiting"}
    assert "run time limit reached" in {tick.stats.solver_status for tick in ticks}
    assert all("time limit" in t.stats.reason or "late" in t.stats.reason for t in ticks)
    assert all(tick.command is None for tick in ticks)


def test_bounds_changed_in_flight_apply_to_the_held_plan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = MpcConfig()
    loop = Loop(config)
    list(loop.fly(0.5))
    *_, (_, tick) = loop.fly(0.1, to=(4.0, 0.0, 4.0))
    assert tick.command is not None
    assert max(abs(tick.command.w_WB_B)) > 1.0 or tick.command.throttle > 0.4
    tight = dataclasses.replace(config, omega_max=(0.5, 0.5, 0.5), throttle_max=0.35)
    loop.controller.reconfigure(tight)
    with monkeypatch.context() as patch:
        patch.setattr(Mpc, "solve", lambda *_, **__: 1 / 0)
        for _, tick in loop.fly(0.2, to=(4.0, 0.0, 4.0)):
            assert tick.stats.source == "plan"
            assert tick.command is not None
            assert tick.command.throttle <= 0.35
            assert max(abs(tick.command.w_WB_B)) <= 0.5
    assert math.isfinite(loop.last(0.1)[1])
