# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Write config/<node>.yaml and docs/reference/parameters.md from the code.

Run the program after changing a parameter; a test fails if the files are not up to date.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

from quad_mpc_ros.commands.params import kind_text, own_nodes
from quad_mpc_ros.configuration import ParameterSpec
from quad_mpc_ros.configuration.files import value_text
from quad_mpc_ros.ros.bridges.registry import bridge_configurations, bridge_packages

ROOT = Path(__file__).resolve().parents[1]

OURS = {name for name, package in bridge_packages().items() if package == "quad_mpc_ros"}
BRIDGES = {name: kind for name, kind in bridge_configurations().items() if name in OURS}
if missing := OURS - BRIDGES.keys():
    raise SystemExit(f"setup.py has changed ({', '.join(sorted(missing))}): install it again")
ALL_NODES = {**own_nodes(), **BRIDGES}

_WIDTH = 99
_PAGE = """\
# Parameters

All parameters by node; `quad_mpc params` prints the same. `tools/update_config.py` writes this
page from the dataclasses that declare the parameters: edit the dataclasses. *Live* parameters can
change in flight (`ros2 param set`). Other parameters are read at the start, or can be set while a
node with a [lifecycle](lifecycle.md) is unconfigured. Nodes [reject](lifecycle.md#startup-checks)
unknown names and invalid values.
"""


def files() -> dict[Path, str]:
    """Return the text of every generated file."""
    texts = {
        Path("config", f"{node}.yaml"): (
            f"# Every parameter of the {node} node with its default value.\n"
            f"{as_yaml(node, kind.specs())}"
        )
        for node, kind in ALL_NODES.items()
    }
    sections = [as_markdown(node, kind.specs()) for node, kind in ALL_NODES.items()]
    texts[Path("docs", "reference", "parameters.md")] = "\n".join([_PAGE, *sections])
    return texts


def as_markdown(node: str, specs: Sequence[ParameterSpec]) -> str:
    """Return a section of ``docs/reference/parameters.md``."""
    rows = [
        (
            f"`{spec.name}`",
            kind_text(spec),
            f"`{value_text(spec.default)}`",
            spec.unit,
            spec.allowed(),
            "yes" if spec.live else "",
            spec.doc,
        )
        for spec in specs
    ]
    header = ("name", "type", "default", "unit", "range", "live", "meaning")
    lines = [_markdown_row(header), f"|{'---|' * len(header)}", *map(_markdown_row, rows)]
    return "\n".join([f"## `{node}`", "", *lines, ""])


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def as_yaml(node: str, specs: Sequence[ParameterSpec]) -> str:
    """Return a ROS parameter file with every default, advanced ones last."""
    lines = [f"/**/{node}:", "  ros__parameters:"]  # in every namespace
    within: list[str] = []
    for spec in _in_groups(specs):
        *groups, name = spec.name.split(".")
        for depth, group in enumerate(groups):
            if within[: depth + 1] != groups[: depth + 1]:
                lines.append(f"{'  ' * (depth + 2)}{group}:")
        within = groups
        indent = "  " * (len(groups) + 2)
        lines += textwrap.wrap(
            f"{spec.doc} {_rule(spec)}",
            width=_WIDTH,
            initial_indent=f"{indent}# ",
            subsequent_indent=f"{indent}# ",
        )
        # rclpy cannot infer the type of an empty list in a file.
        comment = "# " if spec.default == () else ""
        lines.append(f"{indent}{comment}{name}: {value_text(spec.default)}")
    return "\n".join(lines) + "\n"


def _in_groups(specs: Sequence[ParameterSpec]) -> list[ParameterSpec]:
    """Return parameters with those of a group together: a key may stand once in a file."""
    groups: dict[str, int] = {}
    for spec in specs:
        groups.setdefault(spec.name.rpartition(".")[0], len(groups))
    # What is advanced and in no group of it comes before the groups of it.
    return sorted(specs, key=lambda spec: (spec.advanced, groups[spec.name.rpartition(".")[0]]))


def _rule(spec: ParameterSpec) -> str:
    unit = f" [{spec.unit}]" if spec.unit else ""
    live = ", live" if spec.live else ""
    return f"({spec.allowed()}{unit}{live})"


if __name__ == "__main__":
    for path, text in files().items():
        (ROOT / path).write_text(text, encoding="utf-8")
