# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The shipped vehicles: their files are consistent, and the MPC flies each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from fixtures.rotors import (
    MILLISECOND,
    SECOND,
    VEHICLES,
    command,
    configured,
    plant,
    vehicle_config,
)

from quad_mpc_ros.configuration import ConfigurationError, per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.recordings.evaluation.simulated import load_config, simulate
from quad_mpc_ros.simulation.config import SimulatorConfig

FOLDER = Path(__file__).resolve().parents[3] / "config" / "vehicles"
SHARED = ("mass", "gravity", "drag", "rotor_drag", "motor_count", "thrust_curve")


def test_all_vehicles_set_the_same_parameters() -> None:
    """A vehicle file after another one replaces all of its parameters."""
    found = [names(yaml.safe_load((FOLDER / f"{name}.yaml").read_text())) for name in VEHICLES]
    assert all(each == found[0] for each in found)


def names(tree: object, prefix: str = "") -> set[str]:
    if not isinstance(tree, dict):
        return {prefix}
    return {name for key, value in tree.items() for name in names(value, f"{prefix}.{key}")}


@pytest.mark.parametrize(
    ("name", "value"),
    [("dynamics", "paper"), ("rate_time_constant", 0.1), ("thrust_time_constant", 0.1)],
)
def test_refuses_parameters_that_the_plant_replaces(name: str, value: object) -> None:
    with pytest.raises(
        ConfigurationError, match=rf"^simulator\.{name}: given .*has its own value$"
    ):
        SimulatorConfig.build({"plant": "rotors", name: value})


@pytest.mark.parametrize("name", VEHICLES)
def test_nodes_agree_and_sources_are_given(name: str) -> None:
    config = load_config(f"vehicles/{name}")
    assert config.simulator.plant == "rotors"
    for parameter in SHARED:
        values = [getattr(node, parameter) for node in config]
        assert values[1:] == values[:-1]
    assert (FOLDER / f"{name}.yaml").read_text().startswith("# ")


@pytest.mark.parametrize("name", VEHICLES)
def test_rotors_produce_the_thrust_of_the_curve(name: str) -> None:
    """From idling to full throttle, within a thousandth of the maximum."""
    config = configured(name)
    rotors = config.rotors
    idle = len(rotors.x) * rotors.thrust_coefficient * rotors.speed_min**2
    for throttle in np.linspace(0.0, 1.0, 11):
        body = plant(name, initial_throttle=throttle)
        made = rotors.thrust_coefficient * float(body.rotor_speeds @ body.rotor_speeds)
        wanted = max(config.thrust(throttle), idle)
        assert made == pytest.approx(wanted, abs=1e-3 * config.thrust(1.0))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("name", VEHICLES)
def test_configured_lags_match_a_step_response(name: str, axis: int) -> None:
    """A rate reaches 63 % of a step after lag and delay; thrust lags like the rotors."""
    mpc = vehicle_config(name).mpc
    rates = np.zeros(3)
    rates[axis] = 0.5
    body = plant(name)
    body.apply(command(configured(name).vehicle().hover_throttle, tuple(rates)))
    while body.odometry(0).w_WB_B[axis] < 0.63 * 0.5 and body.time_ns < SECOND:
        body.advance_to(body.time_ns + MILLISECOND)
    modelled = per_axis(mpc.rate_time_constant)[axis] + mpc.input_delay
    assert modelled == pytest.approx(body.time_ns * 1e-9, rel=0.15, abs=3e-3)
    assert mpc.thrust_time_constant == configured(name).rotors.time_constant


GUESSES = [
    f"mpc.{name}={getattr(MpcConfig(), name)}"
    for name in ("rate_time_constant", "thrust_time_constant", "input_delay")
]


@pytest.mark.parametrize(("preset", "guesses"), [("default", GUESSES), ("agile", [])])
@pytest.mark.parametrize("name", VEHICLES)
def test_the_mpc_takes_off_and_hovers(name: str, preset: str, guesses: list[str]) -> None:
    """With the default lags, and with the vehicle's lags and aggressive weights."""
    hover = ["reference.trajectory=hover", "reference.height=1.5"]
    config = load_config(preset, f"vehicles/{name}", assignments=[*hover, *guesses])
    flight = simulate(*config, duration=8.0)
    error = np.linalg.norm(flight.p_WB - flight.reference.p_WB, axis=1)
    assert error[-100:].max() < 0.005


@pytest.mark.parametrize("name", VEHICLES)
def test_the_mpc_follows_a_lemniscate(name: str) -> None:
    assignments = {"reference__trajectory": "lemniscate"}
    flight = simulate(*vehicle_config(name, **assignments), duration=6.0, on_reference=True)
    error = np.linalg.norm(flight.p_WB - flight.reference.p_WB, axis=1)
    assert error.max() < 0.03
