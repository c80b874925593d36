"""Weights and bounds that change with every tick of a flight: the solver stays warm."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from fixtures.presets import ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation import closed_loop
from quad_mpc_ros.simulation.closed_loop import LoopStep

Change = Callable[[int], MpcConfig]

CONFIG = MpcConfig()
SETTLED = 50  # ticks, after which the vehicle has left the ground and caught up


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
    """Fly four seconds of the lemniscate, with a configuration of its own after each tick."""
    controller = Controller(CONFIG)
    monkeypatch.setattr(closed_loop, "warmed_up", lambda _, guide: controller)
    steps = []
    for tick, step in enumerate(
        closed_loop.fly(
            mpc=CONFIG,
            simulator=ideal(duration=4.0),
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


def test_the_warm_start_survives_changes_at_every_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison uses new controllers, which start cold, in the same situations."""
    left_alone = iterations_of(flown(as_it_was, monkeypatch))
    steps = flown(changed, monkeypatch)
    hammered = iterations_of(steps)
    assert np.median(hammered[SETTLED:]) <= np.median(left_alone[SETTLED:])

    looked_at = range(SETTLED, len(steps), 5)
    cold = 0
    for tick in looked_at:
        step, controller = steps[tick], Controller(changed(tick - 1))
        controller.receive_reference(step.window, now_ns=step.sent_ns)
        first = controller.receive_odometry(step.odometry, now_ns=step.sent_ns)
        assert first is not None
        cold += first.stats.iterations
    assert sum(hammered[tick] for tick in looked_at) < 0.7 * cold
