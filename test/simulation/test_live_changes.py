"""Weights and bounds that change with every tick of a flight: the solver stays warm."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation import closed_loop
from quad_mpc_ros.simulation.closed_loop import LoopStep
from quad_mpc_ros.simulation.config import SimulatorConfig

Change = Callable[[int], MpcConfig]

CONFIG = MpcConfig()


def changed(tick: int) -> MpcConfig:
    """Return weights and bounds, each of three in turn."""
    factor = (0.8, 1.0, 1.25)[tick % 3]
    return dataclasses.replace(
        CONFIG,
        Q=tuple(factor * weight for weight in CONFIG.Q),
        terminal_weight=factor * CONFIG.terminal_weight,
        omega_max=tuple(factor * bound for bound in CONFIG.omega_max),
        throttle_max=0.9 + 0.1 * (tick % 2),
    )


def as_it_was(_: int) -> MpcConfig:
    return CONFIG


def flown(change: Change, monkeypatch: pytest.MonkeyPatch) -> list[LoopStep]:
    """Fly three seconds of the lemniscate, with a configuration of its own after each tick."""
    controller = Controller(CONFIG)
    monkeypatch.setattr(closed_loop, "warmed_up", lambda _: controller)
    steps = []
    for tick, step in enumerate(
        closed_loop.fly(
            mpc=CONFIG,
            simulator=SimulatorConfig(duration=3.0),
            reference=ReferenceConfig(trajectory="lemniscate"),
        )
    ):
        steps.append(step)
        if change is not as_it_was:
            controller.reconfigure(change(tick))
    return steps


def iterations_of(steps: list[LoopStep]) -> np.ndarray:
    assert all(step.tick is not None and step.tick.stats.source == "mpc" for step in steps)
    return np.array([step.tick.stats.iterations for step in steps if step.tick is not None])


def cold_iterations(steps: list[LoopStep], change: Change) -> np.ndarray:
    """Return what new controllers need, each for one situation of the flight."""
    needed = []
    for tick in range(20, len(steps), 10):
        step, controller = steps[tick], Controller(change(tick - 1))
        controller.receive_reference(step.window, now_ns=step.sent_ns)
        first = controller.receive_odometry(step.odometry, now_ns=step.sent_ns)
        assert first is not None
        needed.append(first.stats.iterations)
    return np.array(needed)


def test_the_warm_start_survives_changes_at_every_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    left_alone = iterations_of(flown(as_it_was, monkeypatch))
    steps = flown(changed, monkeypatch)
    hammered, cold = iterations_of(steps)[20:], cold_iterations(steps, changed)
    print(
        np.median(left_alone[20:]), np.percentile(hammered, (50, 75)), cold.min(), np.median(cold)
    )
    assert np.median(hammered) <= np.median(left_alone[20:])
    assert np.percentile(hammered, 75) < cold.min()
