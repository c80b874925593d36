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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import Any

import yaml

from quad_mpc_ros.configuration import ros_yaml
from quad_mpc_ros.configuration.errors import ConfigurationError, UserError, text_of
from quad_mpc_ros.configuration.extension import (
    BRIDGES,
    ExtensibleConfiguration,
    registered_names,
)
from quad_mpc_ros.configuration.fields import Configuration, unknown_parameter
from quad_mpc_ros.configuration.spelling import did_you_mean, meant_instead_of
from quad_mpc_ros.configuration.vehicle import VEHICLE, describes_vehicle

Schema = Mapping[str, type[Configuration]]
"""The nodes of a file and their parameters."""

_EVERY_NODE = "/**"
_PARAMETERS = "ros__parameters"
# Set by ROS or by the launch file, not part of the configuration.
_OF_ROS = ("use_sim_time", "start_type_description_service")
_GROUP_OF_ROS = "qos_overrides."
_OWN_NODES = ("mpc", "simulator", "reference", "recorder", "player", "visualisation")


@dataclass(frozen=True, kw_only=True)
class ParameterSection:
    """Parameters under one key, by dotted names; ``origin`` is the file, or an option like -p."""

    origin: str
    key: str
    values: Mapping[str, Any]

    @property
    def in_file(self) -> bool:
        """Whether the section is in a file."""
        return not self.origin.startswith("-")

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
    given = _given(sources, assignments, schema)
    built = {}
    for node, values in _merged(given, schema, base).items():
        try:
            built[node] = schema[node].build(values)
        except ConfigurationError as error:
            read = [each for each in given if each.of_any_node or each.node == node]
            raise located(error, read) from error
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
    parameter in a file.
    """
    return _merged(_given(sources, assignments, schema), schema, base)


def located(error: ConfigurationError, given: Sequence[ParameterSection]) -> ConfigurationError:
    """Return an error with the file of its value, unless the value is from an option."""
    name = error.name.partition(".")[2]
    last = next((each for each in reversed(given) if name in each.values), None)
    return error.located(last.origin) if last is not None and last.in_file else error


def _given(
    sources: Sequence[str], assignments: Sequence[str], schema: Schema
) -> list[ParameterSection]:
    """Return the sections of files and assignments; reject parameters in files without a node."""
    given = []
    for source in sources:
        for each in sections("--config", source, others=presets()):
            _check_names(each, schema)
            given.append(each)
    return given + [_assignment(each, schema) for each in assignments]


def _merged(
    given: Sequence[ParameterSection], schema: Schema, base: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    common: dict[str, Any] = {}
    own: dict[str, dict[str, Any]] = {node: {} for node in schema}
    for each in given:
        values = {name: value for name, value in each.values.items() if not is_of_ros(name)}
        if each.of_any_node:
            common |= values
        elif kind := schema.get(each.node):
            if kind.pins in values:
                of_all = [i for i in given if i.of_any_node and i.origin == each.origin]
                shared = {name: value for i in of_all for name, value in i.values.items()}
                own[each.node] |= kind.share(shared, values)
            own[each.node] |= values
    return {
        node: {**base.get(node, {}), **kind.share(common, own[node]), **own[node]}
        for node, kind in schema.items()
    }


def _check_names(section: ParameterSection, schema: Schema) -> None:
    """Reject parameters that the node of a section, or any node for ``/**``, does not have."""
    if section.of_any_node:
        known = {spec.name for kind in schema.values() for spec in kind.specs()} | {*VEHICLE}
    elif (kind := schema.get(section.node)) and not issubclass(kind, ExtensibleConfiguration):
        known = {spec.name for spec in kind.specs()}
    else:  # of another program, or a later choice may add parameters
        return
    for name, value in section.values.items():
        of_all = is_of_ros(name) or (section.of_any_node and describes_vehicle(name))
        if name not in known and not of_all:
            owner = _EVERY_NODE if section.of_any_node else section.node
            raise unknown_parameter(owner, name, value, known).located(section.origin)


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
    return {**shipped(""), **{f"vehicles/{name}": at for name, at in shipped("vehicles").items()}}


def shipped(folder: str) -> dict[str, Path]:
    """Return the shipped YAML files in a folder of ``config`` by name.

    This is ``config`` of a source tree, or ``share/quad_mpc_ros/config`` of an installation. pip
    and colcon put ``share`` at different distances above the package, so look upwards.
    """
    for parent in Path(__file__).resolve().parents:
        for place in (parent, parent / "share" / "quad_mpc_ros"):
            if (place / "package.xml").is_file() and (place / "config").is_dir():
                return {
                    file.stem: file for file in sorted((place / "config" / folder).glob("*.yaml"))
                }
    raise UserError("the presets of quad_mpc_ros are not installed: install the package again")


def expanded(given: str) -> Path:
    """Return a path with ``~`` expanded.

    ``Path.expanduser`` raises for an unknown user; here the path is returned unchanged.
    """
    return Path(os.path.expanduser(given))  # noqa: PTH111


def is_file(path: Path) -> bool:
    """Return whether a file exists; False for an invalid path, for which ``Path`` raises."""
    return os.path.isfile(path)  # noqa: PTH113


def sections(
    option: str,
    given: str,
    *,
    names: Iterable[str] = (),
    others: Mapping[str, Path] = MappingProxyType({}),
) -> list[ParameterSection]:
    """Return the sections of a parameter file given by an option.

    Namespaces may be nested or joined by ``/``. Content that ROS misreads is rejected.

    Args:
        option: Name of the option, for errors.
        given: Path of the file, or a key of ``others``.
        names: Names of nodes besides those of this package.
        others: Further files by name, such as presets.

    Raises:
        UserError: The file is missing or invalid, or the name of a node is misspelt.
    """
    path = Path(given) if is_file(Path(given)) else others.get(given)
    if path is None:
        what = (
            f"a ROS parameter file or a preset ({', '.join(others)})"
            if others
            else ("the path of a ROS parameter file")
        )
        reason = "is a folder" if Path(given).is_dir() else "does not exist"
        near = _nearest_file(Path(given))
        raise UserError(f"{option}: given {given!r}, which {reason}, expected {what}{near}")
    content = ros_yaml.read_file(path)
    if content is None:
        return []
    if not isinstance(content, dict):
        raise UserError(f"{path}: expected 'node: ros__parameters: …', given {content!r:.60}")
    found = list(_sections(content, "", path))
    refuse_misspelt_nodes(str(path), found, names)
    return found


def _nearest_file(path: Path) -> str:
    """Return the nearest file of the same folder or preset, as a hint."""
    try:
        beside = {file.stem: file for file in path.parent.glob("*.y*ml") if file.is_file()}
    except OSError:
        beside = {}
    there = {**presets(), **beside}
    near = difflib.get_close_matches(path.stem, there, n=1)  # endings are alike
    return f" (did you mean {there[near[0]]}?)" if near else ""


def refuse_misspelt_nodes(
    origin: str, there: Sequence[ParameterSection], names: Iterable[str]
) -> None:
    """Raise :class:`UserError` for a section that is certainly a misspelt node of this package.

    Sections of other nodes are ignored. ``names``: names given to nodes of this process.
    """
    given = {section.node for section in there}
    known = {*_OWN_NODES, *registered_names(BRIDGES)}
    for section in there:
        other = section.node
        if other in {*known, *names} or section.of_any_node:
            continue
        if meant := meant_instead_of(other, sorted(known - given)):
            raise UserError(f"{origin}: given node {section.key!r}, did you mean {meant}?")


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


def flattened(parameters: Mapping[Any, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return parameters by dotted name, at any depth of nesting."""
    flat: list[tuple[str, Any]] = []
    for name, value in parameters.items():
        if isinstance(value, dict) and value:
            flat += flattened(value, f"{prefix}{name}.")
        else:
            flat.append((f"{prefix}{name}", value))
    return flat


def _assignment(assignment: str, schema: Schema) -> ParameterSection:
    """Return ``node.parameter=value`` as a section of a file."""
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
        value = ros_yaml.read(text)
    except yaml.YAMLError as error:
        raise UserError(f"--set: {target}: given {text!r}, expected a YAML value") from error
    return ParameterSection(origin="--set", key=node, values={name: value})
