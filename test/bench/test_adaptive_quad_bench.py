# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The trials of AdaptiveQuadBench: drawn in its order, perturbed by physics, and flown."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from fixtures.scripts import script_module
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array

MILLISECOND = 1_000_000
G = 1e-3 * np.array([0.0, 0.0, 9.81])  # m/s in a millisecond

pytest.importorskip("rotorpy")


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return script_module("bench/adaptive_quad_bench.py")


def test_families_share_their_references_and_differ_in_one_perturbation(
    script: ModuleType,
) -> None:
    calm = script.trials("none")
    goals = np.array([trial.goal for trial in calm])
    assert goals.shape == (20, 3, 3)
    assert 1.5 < np.abs(goals).max() <= 2.0
    for family in script.FAMILIES:
        drawn = script.trials(family)
        assert_allclose([trial.goal for trial in drawn], goals)
        assert all(bool(trial.toggles) == (family in script.TOGGLED) for trial in drawn)
        for trial in drawn:
            assert not trial.force.any() or family == "force"
            assert not trial.torque.any() or family == "torque"
            assert trial.payload == 0.0 or family == "payload"
            assert (trial.efficiency == 1.0).all() or family == "rotor efficiency"
            assert not trial.assumed or family == "uncertainty"
            assert len(trial.wind) == (600 if family == "wind" else 1)
            assert (np.diff(trial.toggles) >= 0.5).all()


def moved(body: Any, speeds: Array) -> dict[str, Array]:
    """Return how velocity and rates change in a millisecond, from rest, at these rotor speeds."""
    state = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    state |= {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": speeds}
    after = body.step(state, {"cmd_motor_speeds": speeds}, 0.002)
    return {name: 0.5 * after[name] for name in ("v", "w")}


def test_pushes_payloads_and_weak_rotors_follow_newton(script: ModuleType) -> None:
    goal, still = np.zeros((3, 3)), np.zeros(4)
    hover = np.full(4, np.sqrt(0.826 * 9.81 / 4 / 7.64e-6))
    body = script.multirotor(np.ones(4))
    assert_allclose(moved(body, hover)["v"], 0.0, atol=1e-9)

    body.disturb(script.Trial(goal=goal, force=np.array([1.0, 0.0, 0.5])))
    assert_allclose(moved(body, still)["v"], 1e-3 * np.array([1, 0, 0.5]) / 0.826 - G, atol=1e-9)
    body.disturb(script.Trial(goal=goal, torque=np.array([0.1, 0.0, -0.05])))
    turned = [1e-4 / 0.0047, 0.0, -5e-5 / 0.0074]
    assert_allclose(moved(body, still)["w"], turned, rtol=3e-3, atol=1e-5)
    # What hangs 3 cm ahead falls like the rest, and lifted turns the nose down about the new
    # centre, by its weight and, as there, by that of the rotors' thrust.
    hangs = script.Trial(goal=goal, payload=0.4, payload_at=np.array([0.03, 0.0, 0.0]))
    body.disturb(hangs)
    assert_allclose(moved(body, still)["v"], -G, atol=1e-9)
    lifted = moved(body, hover * np.sqrt(1.226 / 0.826))
    assert_allclose(lifted["v"], 0.0, atol=1e-5)
    inertia = 0.005 + 0.826 * 0.4 / 1.226 * 0.03**2
    torque = 0.4 * 9.81 * 0.03 * (1.0 + 0.826 / 1.226)
    assert_allclose(lifted["w"][1], 1e-3 * torque / inertia, rtol=3e-3)

    weak = script.multirotor(np.array([1.0, 1.0, 0.7, 0.7]))  # the rear
    sagging = moved(weak, hover)
    assert_allclose(sagging["v"], 0.15 * -G, atol=1e-5)
    assert_allclose(sagging["w"][1], -1e-3 * 0.15 * 0.826 * 9.81 * 0.11738 / 0.005, rtol=3e-3)


def test_every_family_flies(script: ModuleType) -> None:
    arguments = script.parsed(["--trials", "1", "--rows", "on", "--set", "simulator.duration=1.5"])
    done = [script.flown(job) for job in script.jobs(arguments)]
    assert [flight.job.family for flight in done] == [*script.FAMILIES]
    for flight in done:
        assert flight.rmse < 0.05
        assert flight.heading < 5.0
    lines = script.table(done)
    assert [line[0] for line in lines[1:]] == [*script.FAMILIES, "all"]
    assert lines[-1][-1] == "0/7"
