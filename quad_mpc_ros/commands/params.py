# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc params``: list the parameters of the nodes."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Mapping, Sequence

from quad_mpc_ros.configuration import Configuration, ParameterSpec, UserError
from quad_mpc_ros.configuration.files import value_text
from quad_mpc_ros.configuration.spelling import did_you_mean
from quad_mpc_ros.configuration.text_tables import text_table

_WIDTH = 99
_INDENT = "    "


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the names of nodes and parameters."""
    parser.description = (
        "List the parameters of all nodes, or of some. Live parameters may change in flight (ros2 "
        "param set); the others are read when a node is configured. Exit code 2 for an unknown "
        "name."
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NODE[.PARAM]",
        help="a node, or a parameter or group of one: mpc, mpc.fence, simulator.wind "
        "(default: every node)",
    )


def run(options: argparse.Namespace) -> int:
    """Print the requested parameters. Raises :class:`UserError` for an unknown name."""
    from quad_mpc_ros.ros.bridges.registry import bridge_configurations

    nodes = {**own_nodes(), **bridge_configurations()}
    tables = (_table(*_found(name, nodes)) for name in options.names or nodes)
    print("\n".join(tables), end="")
    return 0


def own_nodes() -> dict[str, type[Configuration]]:
    """Return the configurations of the nodes of this package, without bridges."""
    from quad_mpc_ros.commands.run_configuration import SCHEMA
    from quad_mpc_ros.messages.markers import VisualisationConfig
    from quad_mpc_ros.recordings.config import PlayerConfig

    return {**SCHEMA, "player": PlayerConfig, "visualisation": VisualisationConfig}


def _found(
    name: str, nodes: Mapping[str, type[Configuration]]
) -> tuple[str, Sequence[ParameterSpec]]:
    node, _, inner = name.strip("/").partition(".")
    if node not in nodes:
        raise UserError(f"unknown node {node!r}{did_you_mean(node, nodes)}: {', '.join(nodes)}")
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


def kind_text(spec: ParameterSpec) -> str:
    """Return the type of a parameter for tables."""
    return f"{spec.kind} or 3" if spec.per_axis else spec.kind


def _table(node: str, specs: Sequence[ParameterSpec]) -> str:
    """Return a table for a terminal."""
    rows = [("parameter", "type", "default", "unit", "range", "live")]
    rows += [
        (
            f"{node}.{spec.name}",
            kind_text(spec),
            value_text(spec.default),
            spec.unit,
            spec.allowed(),
            "live" if spec.live else "",
        )
        for spec in specs
    ]
    head, *table = text_table(rows, align="llllll")
    lines = [head]
    for line, spec in zip(table, specs, strict=True):
        lines += [line, textwrap.indent(textwrap.fill(spec.doc, _WIDTH - len(_INDENT)), _INDENT)]
    return "\n".join(lines) + "\n"
