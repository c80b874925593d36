"""Write config/<node>.yaml and docs/parameters.md from the configuration dataclasses.

Run it after changing a parameter; a test fails while the files are not what it would write.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

from quad_mpc_ros.bags.config import PlayerConfig
from quad_mpc_ros.bridges.aerostack2_bridge import Aerostack2Bridge
from quad_mpc_ros.bridges.crazyswarm2_bridge import Crazyswarm2Bridge
from quad_mpc_ros.bridges.mavros_bridge import MavrosBridge
from quad_mpc_ros.bridges.px4_bridge import Px4Bridge
from quad_mpc_ros.bridges.rates_bridge import RatesBridge
from quad_mpc_ros.bridges.rosflight_bridge import RosflightBridge
from quad_mpc_ros.commands.run_options import SCHEMA
from quad_mpc_ros.configuration import Configuration, ParameterSpec
from quad_mpc_ros.ros.visualisation_config import VisualisationConfig

ROOT = Path(__file__).resolve().parents[1]

BRIDGES = (
    Px4Bridge,
    MavrosBridge,
    RosflightBridge,
    Aerostack2Bridge,
    Crazyswarm2Bridge,
    RatesBridge,
)

# Those of a flight, and those that run by themselves.
NODES = {
    **SCHEMA,
    "player": PlayerConfig,
    "visualisation": VisualisationConfig,
    **{bridge.name: bridge.Config for bridge in BRIDGES},
}


def files() -> dict[Path, str]:
    """Return the text of every generated file."""
    texts = {Path("config", f"{node}.yaml"): _yaml(node, kind) for node, kind in NODES.items()}
    texts[Path("docs", "parameters.md")] = _markdown()
    return texts


def _yaml(node: str, kind: type[Configuration]) -> str:
    lines = [f"# Every parameter of the {node} node with its default value.", f"{node}:"]
    lines.append("  ros__parameters:")
    group = ""
    for spec in kind.specs():
        *groups, name = spec.name.split(".")
        if groups and groups[0] != group:
            group = groups[0]
            lines.append(f"    {group}:")
        indent = "      " if groups else "    "
        lines += textwrap.wrap(
            f"{spec.doc} {_rule(spec)}",
            width=99,
            initial_indent=f"{indent}# ",
            subsequent_indent=f"{indent}# ",
        )
        # rclpy cannot tell the type of an empty list in a file.
        comment = "# " if spec.default == () else ""
        lines.append(f"{indent}{comment}{name}: {_value(spec.default)}")
    return "\n".join(lines) + "\n"


def _markdown() -> str:
    lines = [
        "# Parameters",
        "",
        "What can be set, node by node. Written by `tools/update_config.py` from the dataclasses",
        "that declare the parameters; edit those. *Live* parameters may change in flight",
        "(`ros2 param set`), the others only at the start.",
    ]
    for node, kind in NODES.items():
        lines += ["", f"## `{node}`", "", "| name | default | allowed | live | meaning |"]
        lines.append("|---|---|---|---|---|")
        for spec in kind.specs():
            unit = f" [{spec.unit}]" if spec.unit else ""
            live = "yes" if spec.live else ""
            allowed = spec.allowed().replace("|", "\\|")
            default = _value(spec.default)
            lines.append(
                f"| `{spec.name}` | `{default}` | {allowed}{unit} | {live} | {spec.doc} |"
            )
    return "\n".join(lines) + "\n"


def _rule(spec: ParameterSpec) -> str:
    unit = f" [{spec.unit}]" if spec.unit else ""
    live = ", live" if spec.live else ""
    return f"({spec.allowed()}{unit}{live})"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"' if not value or value.startswith("/") else value
    if isinstance(value, tuple):
        return f"[{', '.join(_value(element) for element in value)}]"
    return repr(value)


if __name__ == "__main__":
    for path, text in files().items():
        (ROOT / path).write_text(text, encoding="utf-8")
