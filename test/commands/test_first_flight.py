# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The vehicle file of the page on the first flight works with every node and command."""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from fixtures.bridges import BRIDGES

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands import recording
from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import Configuration, files
from quad_mpc_ros.extras.campaigns.campaign_file import Overrides, read_campaign
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.ros.bridges.config import BridgeConfig

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/tutorials/first_flight.md").read_text()
VEHICLE_FILE = re.findall(
    r"^```yaml vehicle.yaml\n(/\*\*:.*?)^```", PAGE, re.DOTALL | re.MULTILINE
)[0]
STATED: dict[str, Any] = dict(
    files.flattened(yaml.safe_load(VEHICLE_FILE)["/**"]["ros__parameters"])
)
# What users add for one node, below its name: of MPC and bridge, and in any namespace.
SECTIONS = """
mpc:
  ros__parameters:
    limits: {tilt_max: 0.4}
/**/reference:
  ros__parameters: {max_speed: 1.0}
px4_bridge:
  ros__parameters: {frame_id: odom}
"""
NODES: dict[str, type[Configuration]] = {
    **SCHEMA,
    **{name: kind.Config for name, kind in BRIDGES.items()},
}


@pytest.fixture(params=["below /**", "with sections of nodes"])
def vehicle_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    file = tmp_path / "vehicle.yaml"
    file.write_text(VEHICLE_FILE + (SECTIONS if "sections" in request.param else ""))
    return file


def known(kind: type[Configuration]) -> dict[str, Any]:
    """Return what the page states of what a node has, as its parameters are."""
    names = {spec.name for spec in kind.specs()}
    return {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in STATED.items()
        if name in names
    }


def held(values: dict[str, Any], kind: type[Configuration]) -> dict[str, Any]:
    """Return of a node's parameters those that the page states."""
    return {
        name: tuple(values[name]) if isinstance(values[name], list) else values[name]
        for name in known(kind)
    }


@pytest.fixture
def ros(vehicle_file: Path) -> Iterator[None]:
    rclpy = pytest.importorskip("rclpy")
    rclpy.init(args=["test", "--ros-args", "--params-file", str(vehicle_file)])
    yield
    rclpy.shutdown()


@pytest.mark.parametrize("name", NODES)
def test_a_node_with_the_file_has_the_vehicle(name: str, ros: None) -> None:
    from rclpy.node import Node

    from quad_mpc_ros.ros.parameters import declare

    node = Node(name)
    config = declare(node, NODES[name])
    node.destroy_node()
    assert held(config.flattened(), NODES[name]) == known(NODES[name])


def test_simulate_flies_the_vehicle(vehicle_file: Path, tmp_path: Path) -> None:
    flown = ("--reference", "hover", "--duration", "0.3", "--out", str(tmp_path / "run"))
    assert main(["simulate", "--config", str(vehicle_file), *flown]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    for name, kind in SCHEMA.items():
        if known(kind):
            assert held(summary["config"][name], kind) == known(kind), name
    commands = Recording(tmp_path / "run").flight().commands
    assert commands is not None
    assert commands.throttle[0] == pytest.approx(hover_throttle(), abs=1e-3)


def hover_throttle() -> float:
    """Return the throttle s at which n (a s^2 + b s + c) = m g, by the page's numbers."""
    a, b, c = STATED["thrust_curve"]
    wanted = STATED["mass"] * 9.81 / STATED["motor_count"]
    return (math.sqrt(b * b + 4.0 * a * (wanted - c)) - b) / (2.0 * a)


def test_check_reference_uses_the_limits_of_the_vehicle(
    vehicle_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hovering needs the throttle of the page's mass and curve: by hand, 0.4."""
    asked = ("--reference", "hover", "--out", str(tmp_path / "check"))
    assert main(["check-reference", "--config", str(vehicle_file), *asked]) == 0
    (line,) = [
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("highest throttle")
    ]
    assert float(line.split()[2]) == pytest.approx(hover_throttle(), abs=5e-4)
    assert hover_throttle() == pytest.approx(0.4, abs=1e-3)


def test_the_check_of_the_page_finds_its_reference_feasible(
    vehicle_file: Path, tmp_path: Path
) -> None:
    (words,) = re.findall(r"^quad_mpc check-reference (.*)$", PAGE, re.MULTILINE)
    asked = words.replace("vehicle.yaml", str(vehicle_file)).split()
    assert main(["check-reference", *asked, "--out", str(tmp_path / "check")]) == 0


def test_a_campaign_flies_the_vehicle(vehicle_file: Path) -> None:
    file = ROOT / "config" / "campaigns" / "hover.yaml"
    campaign = read_campaign(file, Overrides(config=[str(vehicle_file)], flights=1))
    for config in campaign.configured(campaign.drawn(0)):
        varied = {name.partition(".")[2] for name in campaign.vary}
        assert not varied & known(type(config)).keys()
        assert held(config.flattened(), type(config)) == known(type(config))


@pytest.mark.parametrize("vehicle_file", ["with sections of nodes"], indirect=True)
def test_identify_starts_from_the_vehicle_and_keeps_its_thrust_map(
    vehicle_file: Path, tmp_path: Path
) -> None:
    """The flight was recorded without the vehicle's parameters, as by another recorder."""
    flown = ("--reference", "excitation", "--duration", "6", "--out", str(tmp_path / "run"))
    heavy = ("--set", "simulator.mass_scale=1.1")
    assert main(["simulate", "--config", str(vehicle_file), *heavy, *flown]) == 0
    parser = argparse.ArgumentParser()
    recording.add_options(parser)
    options = parser.parse_args([str(tmp_path / "run"), "--config", str(vehicle_file)])
    run = Recording(options.bag).run(recording.topic_names(options), topics=())
    mpc = recording.configuration(options, run)["mpc"]
    assert held(mpc.flattened(), type(mpc)) == known(type(mpc))

    out = tmp_path / "identified.yaml"
    asked = [str(options.bag), "--config", str(vehicle_file), "--out", str(out)]
    assert main(["identify", *asked, "--keep", "curve"]) == 0
    found = files.load([str(out)], [], schema={**SCHEMA, "bridge": BridgeConfig})
    assert found["mpc"].mass == pytest.approx(1.1 * STATED["mass"], rel=0.02)
    bridge = cast(BridgeConfig, found["bridge"])
    assert bridge.thrust_map.kind == STATED["thrust_map.kind"]
    # The thrust of the curve is kept, and so is that of the map.
    assert bridge.thrust_map.full_thrust == STATED["thrust_map.full_thrust"]


def test_warns_of_a_file_for_the_mpc_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text(VEHICLE_FILE.replace("/**:", "mpc:").partition("    thrust_map:")[0])
    flown = ("--reference", "hover", "--duration", "0.1", "--out", str(tmp_path / "run"))
    main(["simulate", "--config", str(file), *flown])
    said = capsys.readouterr().err
    assert "warning: the nodes have different vehicle parameters: mass 0.9 of mpc, 0.3" in said
