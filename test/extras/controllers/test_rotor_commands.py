# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Controllers that command rotors: directions, limits, checks, plants without rotors, RAPTOR."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros import (
    Flight,
    MpcConfig,
    OdometrySample,
    ReferenceConfig,
    ReferenceWindow,
    RotorCommand,
    SimulatorConfig,
    load_config,
    simulate,
    so3,
)
from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.controllers.raptor import RaptorController
from quad_mpc_ros.simulation.closed_loop import LoopStep
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant

LOADED = load_config("vehicles/paper", assignments=["simulator.plant=rotors"])
HOVER = ReferenceConfig(trajectory="hover")
VEHICLE = LOADED.mpc.vehicle()
FRONT_LEFT, BACK_LEFT, BACK_RIGHT, FRONT_RIGHT = np.eye(4)


class Rotors:
    """Commands fixed throttles, as changes of the hover throttle."""

    commands_rotors = True

    def __init__(self, change: Any) -> None:
        self.throttles = VEHICLE.hover_throttle + np.asarray(change, dtype=float)

    def reset(self) -> None:
        pass

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> Any:
        return RotorCommand(
            stamp_ns=odometry.stamp_ns,
            throttle=float(self.throttles.mean()),
            w_WB_B=odometry.w_WB_B,
            rotor_throttles=self.throttles,
        )


def flown(law: Any, **options: Any) -> Flight:
    start = {"initial_position": (0.0, 0.0, 2.0), "initial_throttle": VEHICLE.hover_throttle}
    simulator = LOADED.simulator.updated({**start, "duration": 0.2, "command_delay": 0.0})
    return simulate(LOADED.mpc, simulator, HOVER, controller=law, **options)


def body_rates(change: Array) -> Array:
    return flown(Rotors(0.02 * change)).w_WB_B[-1]


def test_equal_throttles_have_the_thrust_of_the_collective_throttle() -> None:
    flight = flown(Rotors(np.zeros(4)))
    assert_allclose(flight.p_WB[-1], [0.0, 0.0, 2.0], atol=1e-3)
    assert_allclose(flight.commands.throttle, VEHICLE.hover_throttle)


def test_rotors_are_counted_from_the_nose_anticlockwise() -> None:
    """More thrust on the left rolls right (+x), at the back pitches down (+y). The reaction of
    clockwise rotors (front left, back right) turns left (+z)."""
    roll = body_rates(FRONT_LEFT + BACK_LEFT)
    pitch = body_rates(BACK_LEFT + BACK_RIGHT)
    yaw = body_rates(FRONT_LEFT + BACK_RIGHT)
    assert roll[0] > 0.3 and abs(roll[1]) < 0.1 * roll[0]
    assert pitch[1] > 0.3 and abs(pitch[0]) < 0.1 * pitch[1]
    assert yaw[2] > 0.01 and abs(yaw[:2]).max() < 0.1 * yaw[2]


def test_the_rate_loop_flies_while_a_limit_changes_the_expected_motion() -> None:
    steps: list[LoopStep] = []
    flown(Rotors(0.02 * FRONT_LEFT), observe=steps.append)
    assert all(isinstance(step.command, RotorCommand) for step in steps)
    slow = LOADED.mpc.updated({"throttle_max": 0.9 * VEHICLE.hover_throttle + 0.05})
    steps = []
    simulator = LOADED.simulator.updated({"duration": 0.2, "initial_position": (0.0, 0.0, 2.0)})
    law = Rotors(np.full(4, 0.1))
    simulate(slow, simulator, HOVER, controller=law, observe=steps.append)
    assert not any(isinstance(step.command, RotorCommand) for step in steps)
    assert all(step.command and step.command.throttle <= slow.throttle_max for step in steps)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (np.zeros(3), "expected 4 numbers"),
        (np.array([0.0, 0.0, 0.0, np.nan]), "finite"),
    ],
)
def test_unusable_throttles_are_a_failsafe(
    change: Array, expected: str, caplog: pytest.LogCaptureFixture
) -> None:
    flight = flown(Rotors(change))
    assert "mpc" not in flight.stats["source"]
    assert expected in caplog.text


def test_throttles_need_the_attribute_and_a_plant_with_rotors(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with pytest.raises(ConfigurationError, match=r"simulator\.plant: given 'internal', expected"):
        simulate(MpcConfig(), SimulatorConfig(), HOVER, controller=Rotors(np.zeros(4)))

    class Plain(Rotors):
        commands_rotors = False

    flown(Plain(np.zeros(4)))
    assert "command: given 'RotorCommand', expected CommandSample" in caplog.text


def test_rotors_in_another_order_are_sorted() -> None:
    """The same vehicle with its rotors listed in reverse flies the same."""
    reverse = {
        f"rotors.{name}": getattr(LOADED.simulator.rotors, name)[::-1]
        for name in ("x", "y", "spin")
    }
    positions = []
    for simulator in (LOADED.simulator, LOADED.simulator.updated(reverse)):
        plant = RotorsPlant(simulator.updated({"initial_position": (0.0, 0.0, 2.0)}))
        plant.apply(Rotors(0.02 * FRONT_LEFT).step(OdometrySample.at_rest([0, 0, 2.0]), Any))
        plant.advance_to(200_000_000)
        positions.append(plant.odometry(0).w_WB_B)
    assert_allclose(positions[0], positions[1], atol=1e-9)
    assert positions[0][0] > 0.1 and positions[0][1] < -0.1


RAPTOR_MPC = MpcConfig(control_rate=100.0)


class Policy:
    """Records observations; the action names the rotor, clockwise from front right."""

    def __init__(self) -> None:
        self.seen: list[Array] = []
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def evaluate_step(self, observation: Array) -> Array:
        self.seen.append(observation[0])
        return np.array([[-1.0, -0.5, 0.0, 3.0]])


def test_raptor_observes_errors_in_the_heading_of_the_reference(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    policy = Policy()
    monkeypatch.setitem(sys.modules, "foundation_policy", SimpleNamespace(Raptor=lambda: policy))
    law = RaptorController(RAPTOR_MPC)
    tilt = so3.exp([0.0, 0.0, np.pi / 2]) @ so3.exp([0.2, 0.0, 0.0])
    odometry = OdometrySample(
        stamp_ns=0,
        p_WB=np.array([0.0, 0.2, 0.7]),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(tilt),
        v_WB_B=np.array([0.3, 0.0, 0.0]),
        w_WB_B=np.array([0.1, 0.2, 0.3]),
    )
    # The reference heads north: north of it is ahead, 0.7 m above it is limited to 0.5 m.
    command = law.step(odometry, ReferenceWindow.hover([0.0, 0.0, 0.0], yaw=np.pi / 2))
    seen = policy.seen[0]
    assert seen.shape == (22,)
    assert_allclose(seen[:3], [0.2, 0.0, 0.5], atol=1e-9)
    assert_allclose(seen[3:12].reshape(3, 3), so3.exp([0.2, 0.0, 0.0]), atol=1e-9)
    assert_allclose(seen[12:15], [0.3, 0.0, 0.0], atol=1e-9)
    assert_allclose(seen[15:18], odometry.w_WB_B)
    assert_array_equal(seen[18:], np.zeros(4))
    assert_allclose(command.rotor_throttles, [1.0, 0.5, 0.25, 0.0])
    law.step(odometry, ReferenceWindow.hover([0.0, 0.0, 0.0]))
    assert_array_equal(policy.seen[1][18:], [-1.0, -0.5, 0.0, 1.0])


def test_raptor_states_its_rate_its_rotors_and_its_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "foundation_policy", None)
    with pytest.raises(ConfigurationError, match=r"control_rate: given 50\.0, expected 100"):
        RaptorController(MpcConfig())
    with pytest.raises(UserError, match=r"pip install 'quad_mpc_ros\[raptor\]'"):
        RaptorController(RAPTOR_MPC)


def test_raptor_hovers_on_the_plant_with_rotors() -> None:
    pytest.importorskip("foundation_policy")
    rates = ["mpc.control_rate=100", "simulator.odom_rate=100", "simulator.plant=rotors"]
    loaded = load_config("vehicles/paper", assignments=[*rates, "mpc.controller=raptor"])
    flight = simulate(loaded.mpc, loaded.simulator, HOVER, duration=6.0, on_reference=True)
    assert set(flight.stats["source"]) == {"mpc"}
    assert np.linalg.norm(flight.p_WB[-100:] - [0.0, 0.0, 2.0], axis=1).max() < 0.15
