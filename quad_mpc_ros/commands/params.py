"""``quad_mpc params``: what can be set, on which node, to what, and what it means."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Iterable, Mapping, Sequence

from quad_mpc_ros.configuration import Configuration, ParameterSpec, UserError


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
        choices=("text", "markdown", "yaml"),
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
    from quad_mpc_ros.bridges.registry import bridge_configurations
    from quad_mpc_ros.commands.parameter_tables import FORMATS, NODES

    nodes = {**NODES, **bridge_configurations()}
    written = FORMATS[options.format]
    tables = []
    for name in options.names or nodes:
        node, specs = _found(name, nodes)
        wanted = [spec for spec in specs if spec.live or not options.live]
        if wanted:
            tables.append(written(node, wanted))
    print("\n".join(tables), end="")
    return 0


def _found(
    name: str, nodes: Mapping[str, type[Configuration]]
) -> tuple[str, Sequence[ParameterSpec]]:
    node, _, inner = name.strip("/").partition(".")
    if node not in nodes:
        raise UserError(f"there is no node {node!r}{_suggestion(node, nodes)}: {', '.join(nodes)}")
    specs = nodes[node].specs()
    if not inner:
        return node, specs
    found = [spec for spec in specs if spec.name == inner or spec.name.startswith(f"{inner}.")]
    if not found:
        suggestion = _suggestion(inner, [spec.name for spec in specs])
        raise UserError(
            f"{node} has no parameter {inner!r}{suggestion}: see quad_mpc params {node}"
        )
    return node, found


def _suggestion(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f", did you mean {close[0]!r}?" if close else ""
