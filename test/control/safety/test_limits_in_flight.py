# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fence, envelope and deadline in the closed loop of controller and plant."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.config import (
    FenceParameters,
    MpcConfig,
)
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.simulation.config import make_plant

PERIOD = 20_000_000
START = 1_000_000_000
AIR = (0.0, 0.0, 2.0)


class Loop:
    """Controller, plant and a hover reference, which can be moved."""

    def __init__(self, mpc: MpcConfig) -> None:
        self.controller = Controller(mpc)
        self._plant = make_plant(ideal(initial_position=AIR))
        self.now = START

    def fly(
        self, seconds: float, *, to: tuple[float, ...] = AIR
    ) -> Iterator[tuple[OdometrySample, Tick]]:
        for _ in range(round(seconds * 50)):
            self._plant.advance_to(self.now - START)
            odometry = self._plant.odometry(self.now)
            window = ReferenceWindow.hover(to, stamp_ns=self.now)
            self.controller.receive_reference(window, now_ns=self.now)
            tick = self.controller.receive_odometry(odometry, now_ns=self.now)
            assert tick is not None
            if tick.command is not None:
                self._plant.apply(tick.command)
            self.now += PERIOD
            yield odometry, tick

    def last(self, seconds: float, *, to: tuple[float, ...] = AIR) -> tuple[str, float]:
        """Fly and return the last source and the last x."""
        *_, (odometry, tick) = self.fly(seconds, to=to)
        return tick.stats.source, float(odometry.p_WB[0])


@pytest.mark.parametrize("distance", [3.0, 6.0, 20.0])
def test_stays_inside_fence_when_reference_leaves_it(distance: float) -> None:
    fence = FenceParameters(minimum=(-2.0, -2.0, -1.0), maximum=(2.0, 2.0, 5.0), action="hover")
    loop = Loop(agile(fence=fence))
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


def test_solver_stops_at_its_time_limit() -> None:
    """Without time no plan is ever ready, so the MPC waits."""
    loop = Loop(MpcConfig())
    loop.controller = Controller(MpcConfig(), deadline=1e-9)
    ticks = [tick for _, tick in loop.fly(0.2)]
    assert {tick.stats.source for tick in ticks} == {"waiting"}
    assert "run time limit reached" in {tick.stats.solver_status for tick in ticks}
    assert all("time limit" in t.stats.reason or "late" in t.stats.reason for t in ticks)
    assert all(tick.command is None for tick in ticks)
