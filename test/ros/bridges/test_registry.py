# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bridges are found by entry point, also those of other packages and those that do not load."""

from __future__ import annotations

import importlib
import itertools
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from fixtures.setup_py import declared, write_metadata
from fixtures.stack_messages import sound_message

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.extension import BRIDGES
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.ros.bridges.bridge import Bridge, OutgoingMessage
from quad_mpc_ros.ros.bridges.registry import bridge_packages, load_bridge

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(("name", "target"), declared(BRIDGES).items())
def test_every_entry_is_a_bridge_with_an_executable_of_its_name(name: str, target: str) -> None:
    module, kind = target.split(":")
    bridge = getattr(importlib.import_module(module), kind)
    assert issubclass(bridge, Bridge)
    assert bridge.name == name == bridge.Config.owner
    assert declared("console_scripts")[name] == f"quad_mpc_ros.entry:{name}"


def test_other_packages_add_theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = ["kite_bridge = a_kite:KiteBridge", "ghost_bridge = not_there:GhostBridge"]
    write_metadata(tmp_path, "some-body", {BRIDGES: theirs})
    (tmp_path / "a_kite.py").write_text("class KiteBridge:\n    name = 'kite_bridge'\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert load_bridge("kite").name == "kite_bridge"
    with pytest.raises(UserError, match="ghost_bridge = not_there:GhostBridge cannot be loaded"):
        load_bridge("ghost")
    assert bridge_packages()["kite_bridge"] == "some_body"
    assert bridge_packages()["rates_bridge"] == "quad_mpc_ros"


def test_the_bridge_of_contributing_passes_commands_on() -> None:
    diff = (
        (ROOT / "CONTRIBUTING.md").read_text().split("+++ b/quad_mpc_ros/ros/bridges/kite.py\n")[1]
    )
    lines = itertools.takewhile(lambda line: line.startswith("+"), diff.splitlines())
    module = types.ModuleType("kite")
    sys.modules["kite"] = module  # where dataclasses look
    exec("\n".join(line[1:] for line in lines), module.__dict__)
    bridge: Bridge = module.KiteBridge(module.KiteConfig(), lambda _: types.SimpleNamespace())
    command = CommandSample(stamp_ns=1, throttle=0.3, w_WB_B=np.array([0.5, 1.0, 1.5]))

    (odometry,) = bridge.subscriptions
    odometry.receive(sound_message("nav_msgs/msg/Odometry", 1), 1)
    assert bridge.receive_command(command, now_ns=1) == []
    assert bridge.engage(True, now_ns=1).accepted
    (outgoing,) = bridge.receive_command(command, now_ns=1)
    assert isinstance(outgoing, OutgoingMessage)
    assert outgoing.topic.name == "/kite/pull"
    assert vars(outgoing.message) == {"p": 0.5, "q": 1.0, "r": 1.5, "throttle": 0.3}
    assert [each.topic.name for each in bridge.subscriptions] == ["/kite/odometry"]


def test_bridges_import_no_ros() -> None:
    # Tests and simulations of a codec need no ROS.
    script = (
        "import sys\n"
        + "".join(f"import {target.split(':')[0]}\n" for target in declared(BRIDGES).values())
        + "sys.exit(any(name.split('.')[0] in ('rclpy', 'geometry_msgs', 'std_srvs') "
        "for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT, timeout=60).returncode == 0
