# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading parameters: ROS parameter files, shipped presets, and ``node.parameter=value``.

The files are standard (``node: ros__parameters:``, with ``/**`` for every node), so that the same
file serves ``ros2 run … --params-file`` and the command line of this package.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import Any

import yaml

from quad_mpc_ros.configuration import ros_yaml
from quad_mpc_ros.configuration.errors import ConfigurationError, UserError, text_of
from quad_mpc_ros.configuration.extension import ExtensibleConfiguration
from quad_mpc_ros.configuration.fields import Configuration
from quad_mpc_ros.configuration.spelling import did_you_mean
from quad_mpc_ros.configuration.vehicle import VEHICLE, describes_vehicle

Schema = Mapping[str, type[Configuration]]
"""The nodes of a file and their parameters."""

_EVERY_NODE = "/**"
_PARAMETERS = "ros__parameters"
# Set by ROS or by the launch file, not part of the configuration.
_OF_ROS = ("use_sim_time", "start_type_description_service")
_GROUP_OF_ROS = "qos_overrides."
# Nodes that are valid in a file for all nodes, but not in the schema.
_OTHER_NODES, _BRIDGE_SUFFIX = ("player", "visualisation"), "_bridge"


def load(
    sources: Sequence[str],
    assignments: Sequence[str],
    *,
    schema: Schema,
    base: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> dict[str, Configuration]:
    """Return the configuration of every node of the schema, later sources over earlier ones.

    ``base`` are parameters by node, with the lowest precedence. ``sources`` are paths or names of
    presets, ``assignments`` are ``node.parameter=value`` and have precedence. Raises
    :class:`UserError` for an unreadable file and :class:`ConfigurationError` for its content.
    """
    values, origins = _collected(sources, assignments, schema, base)
    built = {}
    for node, kind in schema.items():
        try:
            built[node] = kind.build(values[node])
        except ConfigurationError as error:
            origin = origins[node].get(error.name.partition(".")[2])
            raise error if origin is None else error.located(origin) from error
    return built


def collected(
    sources: Sequence[str],
    assignments: Sequence[str] = (),
    *,
    schema: Schema,
    base: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> dict[str, dict[str, Any]]:
    """Return the unvalidated parameters of every node of the schema; arguments as in :func:`load`.

    Each node gets its share of the parameters for every node (``/**``); parameters of a named node
    have precedence, in any order. Raises :class:`UserError` for an unreadable file or an unknown
    parameter.
    """
    return _collected(sources, assignments, schema, base)[0]


def _collected(
    sources: Sequence[str],
    assignments: Sequence[str],
    schema: Schema,
    base: Mapping[str, Mapping[str, Any]],
) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, str]]]:
    """Return parameters by node, and the file of each parameter, if any."""
    common: dict[str, Any] = {}
    values: dict[str, dict[str, Any]] = {node: {} for node in schema}
    origins: dict[str, dict[str, str]] = {node: {} for node in schema}
    for source in sources:
        path = _located(source)
        found = _read(path, schema)
        of_all = found.pop(_EVERY_NODE, {})
        common.update(of_all)
        for node in schema:
            stated = (*of_all, *found.get(node, {}))
            origins[node].update(dict.fromkeys(stated, str(path)))
        for node, parameters in found.items():
            if schema[node].pins in parameters:
                values[node].update(schema[node].share(of_all, parameters))
            values[node].update(parameters)
    for assignment in assignments:
        node, name, value = _parsed(assignment, schema)
        values[node][name] = value
        origins[node].pop(name, None)
    merged = {
        node: {**base.get(node, {}), **kind.share(common, values[node]), **values[node]}
        for node, kind in schema.items()
    }
    for node, kind in schema.items():
        if not issubclass(kind, ExtensibleConfiguration):  # its choice may follow
            known = {spec.name for spec in kind.specs()}
            for name in origins[node].keys() & merged[node].keys() - known:
                try:
                    kind.build({name: merged[node][name]})
                except ConfigurationError as error:
                    raise error.located(origins[node][name]) from error
    return merged, origins


def dump(node: str, values: Mapping[str, Any]) -> str:
    """Return a ROS parameter file of one node's parameters by dotted name.

    Empty lists are omitted: ROS cannot infer their type.
    """
    listed = {name: value for name, value in values.items() if value not in ((), [])}
    return ros_yaml.written({node: {_PARAMETERS: listed}}, default_flow_style=None)


def is_of_ros(name: str) -> bool:
    """Return whether ROS declares a parameter on every node."""
    return name in _OF_ROS or name.startswith(_GROUP_OF_ROS)


def value_text(value: Any) -> str:
    """Return a value as text that YAML reads back exactly."""
    return ros_yaml.written([value], default_flow_style=True, width=math.inf).strip()[1:-1]


def presets() -> dict[str, Path]:
    """Return the shipped parameter files by name, in subfolders as ``folder/name``."""
    folder = _config_directory()
    found = sorted([*folder.glob("*.yaml"), *folder.glob("vehicles/*.yaml")])
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in found}


def shipped_campaigns() -> dict[str, Path]:
    """Return the shipped files of campaigns and of their tuning by name."""
    return {path.stem: path for path in sorted(_config_directory().glob("campaigns/*.yaml"))}


def shipped_gates() -> dict[str, Path]:
    """Return the shipped courses of gates by name."""
    return {path.stem: path for path in sorted(_config_directory().glob("gates/*.yaml"))}


def _config_directory() -> Path:
    """Return ``config`` of a source tree, or ``share/quad_mpc_ros/config`` of an installation.

    pip and colcon put ``share`` at different distances above the package, so look upwards.
    """
    for parent in Path(__file__).resolve().parents:
        if (parent / "package.xml").is_file() and (parent / "config").is_dir():
            return parent / "config"
        if (parent / "share" / "quad_mpc_ros" / "config").is_dir():
            return parent / "share" / "quad_mpc_ros" / "config"
    raise UserError("the presets of quad_mpc_ros are not installed: install the package again")


def expanded(given: str) -> Path:
    """Return a path with ``~`` expanded.

    ``Path.expanduser`` raises for an unknown user; here the path is returned unchanged.
    """
    return Path(os.path.expanduser(given))  # noqa: PTH111


def is_file(path: Path) -> bool:
    """Return whether a file exists; False for an invalid path, for which ``Path`` raises."""
    return os.path.isfile(path)  # noqa: PTH113


def parameter_file(option: str, given: str) -> Path:
    """Return the path of a parameter file; raise :class:`UserError` unless it exists.

    ``option`` is the name of the option. The error suggests the nearest existing name.
    """
    path = Path(given)
    if is_file(path):
        return path
    reason = "is a folder" if path.is_dir() else "does not exist"
    raise UserError(
        f"{option}: given {given!r}, which {reason}, expected the path of a ROS parameter "
        f"file{_nearest_file(path)}"
    )


def _nearest_file(path: Path) -> str:
    """Return the nearest file of the same folder or preset, as a hint."""
    try:
        beside = {file.stem: file for file in path.parent.glob("*.y*ml") if file.is_file()}
    except OSError:
        beside = {}
    there = {**presets(), **beside}
    near = difflib.get_close_matches(path.stem, there, n=1)  # endings are alike
    return f" (did you mean {there[near[0]]}?)" if near else ""


def _located(source: str) -> Path:
    path = Path(source)
    if is_file(path):
        return path
    shipped = presets()
    if source in shipped:
        return shipped[source]
    raise UserError(
        f"--config: given {source!r}, expected a parameter file or a preset "
        f"({', '.join(shipped)}){_nearest_file(path)}"
    )


@dataclass(frozen=True, kw_only=True)
class ParameterSection:
    """Parameters under one key, by dotted names; ``origin`` is the file, or the option ``-p``."""

    origin: str
    key: str
    values: Mapping[str, Any]

    @property
    def node(self) -> str:
        """The name of a node, without its namespace; ``*`` or ``**`` for any."""
        return self.key.rsplit("/", 1)[-1]

    @property
    def of_any_node(self) -> bool:
        """Whether the key matches nodes of any name, like ``/**``."""
        return self.node in ("*", "**")

    def is_read_by(self, full_name: str) -> bool:
        """Whether ROS applies the section to a node with this full name: ``/uav1/mpc``."""
        words = {"**": r"(/\w+)*", "*": r"/\w+"}
        parts = (words.get(word, f"/{re.escape(word)}") for word in self.key.split("/") if word)
        return re.fullmatch("".join(parts), full_name) is not None


def sections(path: Path) -> list[ParameterSection]:
    """Return the sections of a parameter file; raise :class:`UserError` for invalid content.

    Namespaces may be nested or joined by ``/``. Content that ROS misreads is rejected.
    """
    content = ros_yaml.read_file(path)
    if content is None:
        return []
    if not isinstance(content, dict):
        raise UserError(f"{path}: expected 'node: ros__parameters: …', given {content!r:.60}")
    return list(_sections(content, "", path))


def refuse_what_ros_misreads(where: str, value: Any) -> None:
    """Raise :class:`UserError` for nested lists, and for lists of different types."""
    if not isinstance(value, list):
        return
    kinds = {type(element) for element in value}
    if kinds & {list, dict, NoneType}:
        raise UserError(f"{where}: given {text_of(value)}, expected one value or a plain list")
    if len(kinds) > 1:
        numbers = kinds == {int, float}
        hint = f"; write {text_of([float(element) for element in value])}" if numbers else ""
        raise UserError(f"{where}: given {text_of(value)}, expected elements of one type{hint}")


def _sections(content: Mapping[Any, Any], within: str, path: Path) -> Iterator[ParameterSection]:
    for name, inner in content.items():
        key = f"{within}/{name}" if within else str(name)
        if name == _PARAMETERS:
            if not within:
                raise UserError(f"{path}: expected a node's name above '{_PARAMETERS}:'")
            if not isinstance(inner, dict):
                raise UserError(f"{path}: {within}: expected parameters below '{_PARAMETERS}:'")
            values = _parameters(inner, f"{path}: {within}")
            yield ParameterSection(origin=str(path), key=within, values=values)
        elif isinstance(inner, dict) and inner:
            yield from _sections(inner, key, path)
        else:
            raise UserError(f"{path}: {key}: expected '{_PARAMETERS}:' below it")


def _parameters(content: Mapping[Any, Any], where: str) -> dict[str, Any]:
    """Return parameters by dotted names; reject names that ROS rejects."""
    values: dict[str, Any] = {}
    for name, value in flattened(content):
        if value is None or value == {}:
            raise UserError(f"{where}: {name}: given no value")
        if name in values:
            raise UserError(f"{where}: {name}: given twice")
        refuse_what_ros_misreads(f"{where}: {name}", value)
        values[name] = value
    return values


def _read(path: Path, schema: Schema) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for section in sections(path):
        values = {name: value for name, value in section.values.items() if not is_of_ros(name)}
        if section.key == _EVERY_NODE:
            _refuse_unknown(values, schema, path)
            found.setdefault(_EVERY_NODE, {}).update(values)
        elif node := _node_meant(section, schema, path):
            found.setdefault(node, {}).update(values)
    return found


def _refuse_unknown(values: Mapping[str, Any], schema: Schema, path: Path) -> None:
    """Reject parameters that no node has."""
    known = {spec.name for kind in schema.values() for spec in kind.specs()}
    for name, value in values.items():
        if name in known or describes_vehicle(name):
            continue
        raise ConfigurationError(
            f"{path}: {_EVERY_NODE}: {name}",
            value,
            f"a parameter of some node{did_you_mean(name, {*known, *VEHICLE})}",
        )


def _node_meant(section: ParameterSection, schema: Schema, path: Path) -> str:
    """Return the node of a section; empty for a node outside the schema."""
    node = section.node
    if node in schema:
        return node
    if node in _OTHER_NODES or node.endswith(_BRIDGE_SUFFIX):
        return ""
    raise UserError(
        f"{path}: given node {section.key!r}, expected one of {', '.join(schema)}"
        f"{did_you_mean(node, schema)}"
    )


def flattened(parameters: Mapping[Any, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return parameters by dotted name, at any depth of nesting."""
    flat: list[tuple[str, Any]] = []
    for name, value in parameters.items():
        if isinstance(value, dict) and value:
            flat += flattened(value, f"{prefix}{name}.")
        else:
            flat.append((f"{prefix}{name}", value))
    return flat


def _parsed(assignment: str, schema: Schema) -> tuple[str, str, Any]:
    target, equals, text = assignment.partition("=")
    node, dot, name = target.strip().partition(".")
    if not equals or not dot or not name:
        raise UserError(f"--set: given {assignment!r}, expected node.parameter=value")
    if node not in schema:
        raise UserError(
            f"--set: given node {node!r}, expected one of {', '.join(schema)}"
            f"{did_you_mean(node, schema)}"
        )
    try:
        return node, name, ros_yaml.read(text)
    except yaml.YAMLError as error:
        raise UserError(f"--set: {target}: given {text!r}, expected a YAML value") from error
