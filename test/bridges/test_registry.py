"""Bridges are found by entry point: ours, other people's, and those that do not load."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from quad_mpc_ros.bridges.bridge import Bridge
from quad_mpc_ros.bridges.registry import GROUP, registered_bridges
from quad_mpc_ros.cli import main

ROOT = Path(__file__).resolve().parents[2]


def declared() -> dict[str, list[str]]:
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text())):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup":
            for keyword in node.keywords:
                if keyword.arg == "entry_points":
                    found: dict[str, list[str]] = ast.literal_eval(keyword.value)
                    return found
    raise AssertionError("setup.py has no entry points")


def install(folder: Path, name: str, *entries: str) -> None:
    """Put the metadata of a distribution into a folder of the search path."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = "\n".join(entries)
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{lines}\n")


@pytest.mark.parametrize("entry", declared()[GROUP])
def test_every_entry_is_a_bridge_with_an_executable_of_its_name(entry: str) -> None:
    name, target = entry.split(" = ")
    module, kind = target.split(":")
    bridge = getattr(importlib.import_module(module), kind)
    assert issubclass(bridge, Bridge)
    assert bridge.name == name == bridge.Config.owner
    assert f"{name} = {module}:main" in declared()["console_scripts"]


def test_other_packages_add_theirs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(tmp_path, "quad-mpc-ros-under-test", *declared()[GROUP])
    install(
        tmp_path,
        "somebody",
        "kite_bridge = a_kite:KiteBridge",
        "ghost_bridge = not_there:GhostBridge",
    )
    (tmp_path / "a_kite.py").write_text(
        "class KiteBridge:\n"
        "    name, speaks = 'kite_bridge', 'Kites: pulls on two lines'\n"
        "    packages, how_to_get = ('kite_msgs',), 'ask the wind'\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    found = {bridge.name: bridge for bridge in registered_bridges()}

    assert found["kite_bridge"].missing == ("kite_msgs",)
    assert "not_there" in found["ghost_bridge"].fault
    assert found["rates_bridge"].missing == ()

    assert main(["bridges"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert lines["kite_bridge"].endswith("missing kite_msgs: ask the wind")
    assert lines["rates_bridge"].endswith("installed")
    assert "broken" in lines["ghost_bridge"]


def test_bridges_know_no_ros() -> None:
    # Whoever tests or simulates with a codec needs none of it.
    script = (
        "import sys\n"
        + "".join(f"import {entry.split(' = ')[1].split(':')[0]}\n" for entry in declared()[GROUP])
        + "sys.exit(any(name.split('.')[0] in ('rclpy', 'geometry_msgs', 'std_srvs') "
        "for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT, timeout=60).returncode == 0
