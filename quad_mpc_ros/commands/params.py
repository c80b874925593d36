"""``quad_mpc params``: what can be set, on which node, to what, and what it means."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from quad_mpc_ros.configuration import Configuration, ParameterSpec, UserError
from quad_mpc_ros.configuration.spelling import did_you_mean
from quad_mpc_ros.configuration.text_tables import labelled, markdown_table, text_table

_WIDTH = 99


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which parameters to print, and how."""
    parser.description = (
        "Print what can be set on the nodes, or on some of them. Live parameters may change "
        "in flight (ros2 param set); the others are taken when a node is configured. Exit "
        "code 2 for an unknown name."
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NODE[.PARAM]",
        help="a node, or a parameter or group of one: mpc, mpc.fence, simulator.wind "
        "(default: every node)",
    )
    parser.add_argument(
        "--format",
        choices=FORMATS,
        default="text",
        help="text to read; markdown, which docs/parameters.md is made of; yaml, a ROS parameter "
        "file with every default to edit (default: text)",
    )
    parser.add_argument(
        "--live",
        action="store_true",
        help="only those that may change in flight",
    )


def run(options: argparse.Namespace) -> int:
    """Print the parameters that are asked for. Raises :class:`UserError` for an unknown name."""
    from quad_mpc_ros.ros.bridges.registry import bridge_configurations

    nodes = {**own_nodes(), **bridge_configurations()}
    written = FORMATS[options.format]
    tables = []
    for name in options.names or nodes:
        node, specs = _found(name, nodes)
        wanted = [spec for spec in specs if spec.live or not options.live]
        if wanted:
            tables.append(written(node, wanted))
    print("\n".join(tables), end="")
    return 0


def own_nodes() -> dict[str, type[Configuration]]:
    """Return the configurations of the nodes of a flight, and of those that run by themselves."""
    from quad_mpc_ros.commands.run_configuration import SCHEMA
    from quad_mpc_ros.messages.markers import VisualisationConfig
    from quad_mpc_ros.recordings.config import PlayerConfig
    from quad_mpc_ros.ros.teleop.config import TeleopConfig

    return {
        **SCHEMA,
        "player": PlayerConfig,
        "visualisation": VisualisationConfig,
        "teleop": TeleopConfig,
    }


def _found(
    name: str, nodes: Mapping[str, type[Configuration]]
) -> tuple[str, Sequence[ParameterSpec]]:
    node, _, inner = name.strip("/").partition(".")
    if node not in nodes:
        raise UserError(
            f"there is no node {node!r}{did_you_mean(node, nodes)}: {', '.join(nodes)}"
        )
    specs = nodes[node].specs()
    if not inner:
        return node, specs
    found = [spec for spec in specs if spec.name == inner or spec.name.startswith(f"{inner}.")]
    if not found:
        suggestion = did_you_mean(inner, [spec.name for spec in specs])
        raise UserError(
            f"{node} has no parameter {inner!r}{suggestion}: see quad_mpc params {node}"
        )
    return node, found


def _kind(spec: ParameterSpec) -> str:
    return f"{spec.kind} or 3" if spec.per_axis else spec.kind


def as_text(node: str, specs: Sequence[ParameterSpec]) -> str:
    """Return a table to read on a terminal."""
    rows = [("parameter", "type", "default", "unit", "range", "live")]
    rows += [
        (
            f"{node}.{spec.name}",
            _kind(spec),
            _value(spec.default),
            spec.unit,
            spec.allowed(),
            "live" if spec.live else "",
        )
        for spec in specs
    ]
    head, *table = text_table(rows, align="llllll")
    lines = [head]
    for line, spec in zip(table, specs, strict=True):
        lines += [line, *labelled("", spec.doc, indent=4, width=_WIDTH)]
    return "\n".join(lines) + "\n"


def as_markdown(node: str, specs: Sequence[ParameterSpec]) -> str:
    """Return a section of ``docs/parameters.md``."""
    rows = [
        (
            f"`{spec.name}`",
            _kind(spec),
            f"`{_value(spec.default)}`",
            spec.unit,
            spec.allowed(),
            "yes" if spec.live else "",
            spec.doc,
        )
        for spec in specs
    ]
    header = ("name", "type", "default", "unit", "range", "live", "meaning")
    return f"## `{node}`\n\n{markdown_table(header, rows)}\n"


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
        # rclpy cannot tell the type of an empty list in a file.
        comment = "# " if spec.default == () else ""
        lines.append(f"{indent}{comment}{name}: {_value(spec.default)}")
    return "\n".join(lines) + "\n"


def _in_groups(specs: Sequence[ParameterSpec]) -> list[ParameterSpec]:
    """Return parameters with those of a group together: a key may stand once in a file."""
    groups: dict[str, int] = {}
    for spec in specs:
        groups.setdefault(spec.name.rpartition(".")[0], len(groups))
    # What is advanced and in no group of it comes before the groups of it.
    return sorted(specs, key=lambda spec: (spec.advanced, groups[spec.name.rpartition(".")[0]]))


FORMATS = {"text": as_text, "markdown": as_markdown, "yaml": as_yaml}


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
