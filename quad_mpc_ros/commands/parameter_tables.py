"""Every parameter of every node, as text, as Markdown and as ROS parameter files."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import Configuration, ParameterSpec
from quad_mpc_ros.messages.markers import VisualisationConfig
from quad_mpc_ros.recordings.config import PlayerConfig
from quad_mpc_ros.text_tables import labelled, markdown_table, text_table

# Those of a flight, and those that run by themselves.
NODES: Mapping[str, type[Configuration]] = {
    **SCHEMA,
    "player": PlayerConfig,
    "visualisation": VisualisationConfig,
}

_WIDTH = 99


def as_text(node: str, specs: Sequence[ParameterSpec]) -> str:
    """Return a table to read on a terminal."""
    rows = [("parameter", "type", "default", "unit", "range", "live")]
    rows += [
        (
            f"{node}.{spec.name}",
            spec.kind,
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
            spec.kind,
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
    """Return a ROS parameter file with every default."""
    lines = [f"{node}:", "  ros__parameters:"]
    group = ""
    for spec in specs:
        *groups, name = spec.name.split(".")
        if groups and groups[0] != group:
            group = groups[0]
            lines.append(f"    {group}:")
        indent = "      " if groups else "    "
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
