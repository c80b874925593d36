# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fallbacks use the estimate from before a failure, and the estimate persists."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from fixtures.presets import ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.simulation.config import make_plant

PERIOD_NS = 20_000_000
HOVER = np.array([0.0, 0.0, 2.0])
ROBUST = {"horizon_steps": 20, "R": (0.0, 0.1, 0.1, 0.1)}


class Hover:
    """Hovers at the control rate, and lets things fail."""

    def __init__(self, **simulator: Any) -> None:
        self.controller = Controller(MpcConfig(**ROBUST))
        start = {"initial_position": tuple(HOVER), "initial_throttle": 0.35}
        self.plant = make_plant(ideal(**{**start, **simulator}))
        self.now_ns = 1_000_000_000
        self.began_ns = self.now_ns
        self.sources: set[str] = set()

    def fly(self, seconds: float, *, reference: bool = True, odometry: bool = True) -> Array:
        """Fly on and return the heights."""
        heights = []
        for _ in range(round(seconds * 1e9 / PERIOD_NS)):
            heights.append(self.tick(reference=reference, odometry=odometry))
        return np.array(heights)

    def tick(self, *, reference: bool, odometry: bool) -> float:
        self.plant.advance_to(self.now_ns - self.began_ns)
        truth = self.plant.odometry(self.now_ns)
        if reference:
            window = ReferenceWindow.hover(HOVER, stamp_ns=self.now_ns)
            self.controller.receive_reference(window, now_ns=self.now_ns)
        if odometry:
            tick = self.controller.receive_odometry(truth, now_ns=self.now_ns)
        else:
            tick = self.controller.watch(now_ns=self.now_ns)
        if tick is not None:
            self.sources.add(tick.stats.source)
            self.last = tick
            if tick.command is not None:
                self.plant.apply(tick.command)
        self.now_ns += PERIOD_NS
        return float(truth.p_WB[2])


@pytest.mark.parametrize("scale", [0.7, 1.3])
def test_hover_without_reference_uses_estimated_thrust(
    scale: float,
) -> None:
    flight = Hover(thrust_scale=scale)
    learned = flight.fly(10.0)
    held = flight.fly(8.0, reference=False)
    assert "hover" in flight.sources
    assert np.abs(held - learned[-1]).max() < 0.15
    assert abs(held[-1] - learned[-1]) < 0.05


def test_blind_descent_uses_estimated_thrust() -> None:
    flight = Hover(thrust_scale=0.7)
    learned = flight.fly(10.0)
    blind_time = flight.controller.config.blind_time
    blind = flight.fly(blind_time, odometry=False)
    assert "blind" in flight.sources
    assert learned[-1] - blind.min() < 0.3
    assert blind.max() - learned[-1] < 0.05


def fail_at(ticks: list[int], owner: type, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the calls of a method with these numbers raise."""
    count, method = itertools.count(), getattr(owner, name)

    def failing(*arguments: Any, **named: Any) -> Any:
        if next(count) in ticks:
            raise ArithmeticError("of nothing")
        return method(*arguments, **named)

    monkeypatch.setattr(owner, name, failing)


@pytest.mark.parametrize(("ticks", "scale"), [([500], 0.7), ([500, 501], 1.0)])
def test_two_errors_in_a_row_replace_the_estimator(
    ticks: list[int], scale: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_at(ticks, DelayCompensation, "predict", monkeypatch)
    flight = Hover(thrust_scale=0.7)
    flight.fly(10.02 + 0.02 * len(ticks))
    assert flight.last.stats.thrust_scale == pytest.approx(scale, abs=0.2)
    assert flight.last.stats.stage_errors == len(ticks)
    assert flight.last.stats.solver_failures == 0
    assert flight.fly(4.0)[-1] == pytest.approx(HOVER[2], abs=0.1)


def test_a_replaced_estimator_keeps_the_engagement(monkeypatch: pytest.MonkeyPatch) -> None:
    fail_at([100, 101], DelayCompensation, "predict", monkeypatch)
    flight = Hover(thrust_scale=0.7)
    flight.controller.engage(False)
    flight.fly(6.0)
    # Commands that do not act teach nothing: the plant flies with them here, unknown to it.
    assert flight.last.stats.thrust_scale == 1.0
