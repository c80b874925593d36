# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One vehicle file: every node and the simulator read their share of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest
import yaml

from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import files
from quad_mpc_ros.configuration.vehicle import VEHICLE, disagreements
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.simulation.config import SimulatorConfig

VEHICLE_FILE = """
/**:
  ros__parameters:
    mass: 0.8
    thrust_curve: [12.0, 1.0, 0.0]
    drag: [0.3, 0.3, 0.5]
    rate_time_constant: [0.05, 0.05, 0.2]
    thrust_time_constant: 0.03
    input_delay: 0.035
    omega_max: [8.0, 8.0, 4.0]
    thrust_map: {kind: linear, full_thrust: 60.0}
"""
ALL = {**SCHEMA, "bridge": BridgeConfig}


def loaded(tmp_path: Path, text: str, *more: str, settings: tuple[str, ...] = ()) -> Any:
    file = tmp_path / "vehicle.yaml"
    file.write_text(text)
    return files.load([*more, str(file)], settings, schema=ALL)


def test_every_node_reads_its_share(tmp_path: Path) -> None:
    nodes = loaded(tmp_path, VEHICLE_FILE)
    mpc = cast(MpcConfig, nodes["mpc"])
    simulator = cast(SimulatorConfig, nodes["simulator"])
    reference = cast(ReferenceConfig, nodes["reference"])
    assert mpc.vehicle() == simulator.vehicle() == reference.vehicle()
    assert (mpc.mass, mpc.omega_max) == (0.8, (8.0, 8.0, 4.0))
    assert simulator.rate_time_constant == (0.05, 0.05, 0.2)
    assert (simulator.thrust_time_constant, simulator.command_delay) == (0.03, 0.035)
    assert nodes["bridge"].mass == 0.8
    assert nodes["bridge"].thrust_map.full_thrust == 60.0
    assert nodes["recorder"] == SCHEMA["recorder"]()


def test_the_simulator_may_fly_another_vehicle(tmp_path: Path) -> None:
    settings = ("simulator.mass_scale=1.2", "simulator.rate_time_constant=0.1")
    nodes = loaded(tmp_path, VEHICLE_FILE, settings=settings)
    simulator = cast(SimulatorConfig, nodes["simulator"])
    assert simulator.vehicle().mass == pytest.approx(1.2 * 0.8)
    assert simulator.rate_time_constant == 0.1
    assert nodes["mpc"].rate_time_constant == (0.05, 0.05, 0.2)


def test_the_delay_of_the_odometry_is_part_of_the_input_delay(tmp_path: Path) -> None:
    nodes = loaded(tmp_path, VEHICLE_FILE, settings=("simulator.odom_delay=0.01",))
    assert nodes["simulator"].command_delay == pytest.approx(0.025)
    assert not disagreements({node: config.vehicle_values() for node, config in nodes.items()})


def test_a_plant_keeps_the_parameters_of_its_own_file(tmp_path: Path) -> None:
    before = files.load(["vehicles/racer"], [], schema=ALL)["simulator"]
    nodes = loaded(tmp_path, VEHICLE_FILE, "vehicles/racer")
    assert nodes["simulator"] == before
    assert nodes["mpc"].mass == nodes["reference"].mass == 0.8


@pytest.mark.parametrize("preset", [name for name in files.presets() if "/" in name])
def test_shipped_vehicles_state_each_number_once(preset: str) -> None:
    text = files.presets()[preset].read_text()
    for name in VEHICLE:
        assert text.count(f"\n    {name}:") <= 1, name
    nodes = files.load([preset], [], schema=ALL)
    assert not disagreements({node: config.vehicle_values() for node, config in nodes.items()})


def test_vehicle_parameters_have_equal_meaning_in_every_node() -> None:
    for name in VEHICLE:
        specs = [s for kind in ALL.values() for s in kind.specs() if s.name == name]
        assert specs
        assert len({(s.kind, s.unit, s.default, s.per_axis) for s in specs}) == 1, name


def test_vehicle_mismatch_names_every_node_with_its_value() -> None:
    vehicles = {
        "mpc": {"mass": 0.9, "drag": 0.2, "omega_max": [6.0, 6.0, 3.0]},
        "reference": {"mass": 0.397, "drag": [0.2, 0.2, 0.2]},
        "px4_bridge": {"mass": 0.9},
    }
    assert disagreements(vehicles) == {
        "mass": "mass 0.9 of mpc and px4_bridge, 0.397 of reference"
    }
    vehicles["reference"]["mass"] = 0.9
    assert disagreements(vehicles) == {}
    assert disagreements({}) == {}


def test_empty_list_uses_the_default() -> None:
    """With an empty list in a file, rclpy does not start the node, because it has no type."""
    text = files.dump("mpc", {"gates": (), "Q": (1.0, 2.0), "name": ""})
    assert yaml.safe_load(text) == {"mpc": {"ros__parameters": {"Q": [1.0, 2.0], "name": ""}}}
