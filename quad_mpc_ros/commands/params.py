"""``quad_mpc params``: what can be set, on which node, to what, and what it means."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Iterable, Mapping, Sequence

from quad_mpc_ros.bridges.registry import bridge_configurations
from quad_mpc_ros.commands.parameter_tables import NODES, as_markdown, as_text, as_yaml
from quad_mpc_ros.configuration import Configuration, ParameterSpec, UserError

_FORMATS = {"text": as_text, "markdown": as_markdown, "yaml": as_yaml}


def print_parameters(options: argparse.Namespace) -> int:
    """Print the parameters that are asked for. Raises :class:`UserError` for an unknown name."""
    nodes = {**NODES, **bridge_configurations()}
    written = _FORMATS[options.format]
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
