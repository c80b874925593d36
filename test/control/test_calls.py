# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How many Python calls a control step takes, a cost that no other process disturbs."""

from __future__ import annotations

import cProfile

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

MOST = 300
"""Reached, rounded up to the next ten; 95 of them are those of OSQP's own interface."""
BEFORE, COUNTED = 100, 100  # steps


def test_a_control_step_takes_few_python_calls() -> None:
    controller, profile, steps = warmed_up(MpcConfig()), cProfile.Profile(), 0

    def law(odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        nonlocal steps
        steps += 1
        if steps > BEFORE:
            profile.enable()
        tick = controller.step(odometry, window)
        profile.disable()
        return None if tick is None else tick.command

    for _ in fly(
        reference=ReferenceConfig(trajectory="lemniscate"),
        simulator=SimulatorConfig(duration=0.02 * (BEFORE + COUNTED)),
        controller=law,
        on_reference=True,
    ):
        pass
    calls = sum(entry.callcount for entry in profile.getstats()) / (steps - BEFORE)
    print(f"{calls:.1f} calls")
    assert calls <= MOST
