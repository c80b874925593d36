# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter files and ``-p`` on the ROS command line of a process, by section.

rclpy merges the sections for a node and ignores other sections and names, also misspelt ones. This
module reads the arguments separately, with the rules of ``--config``, to report errors. The values
come from rclpy.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Mapping, Sequence

import yaml
from rclpy.utilities import remove_ros_args

from quad_mpc_ros.configuration import ConfigurationError, UserError, files, ros_yaml
from quad_mpc_ros.configuration.files import ParameterSection
from quad_mpc_ros.configuration.spelling import did_you_mean, meant_instead_of
from quad_mpc_ros.configuration.vehicle import describes_vehicle

_FILE_OPTION = "--params-file"
_OVERRIDE_OPTIONS = ("-p", "--param")
_NODE_NAME_PATTERN = re.compile(r"(?:^|:)__node:=(\w+)$")
_OVERRIDE_PATTERN = re.compile(r"(?:(\w+):)?([\w./]+):=(.*)", re.DOTALL)


def read_arguments(arguments: Sequence[str]) -> tuple[list[ParameterSection], list[str]]:
    """Return the parameters in the arguments of a process, and the arguments not for ROS.

    Raises :class:`UserError` for an unreadable file, an invalid value, a misspelt node name, and
    for arguments that ROS rejects.
    """
    names = {found[1] for word in arguments if (found := _NODE_NAME_PATTERN.search(word))}
    given: list[ParameterSection] = []
    for option, word in itertools.pairwise(arguments):
        if option == _FILE_OPTION:
            given += files.sections(_FILE_OPTION, word, names=names)
        elif option in _OVERRIDE_OPTIONS:
            section = _override(option, word)
            files.refuse_misspelt_nodes(f"{option} {word}", [section], names)
            given.append(section)
    try:
        return given, remove_ros_args(list(arguments))
    except Exception as error:  # rclpy's own errors have no public name
        reason = re.sub(r", at \S+:\d+", "", " ".join(str(error).split()))
        raise UserError(f"ROS rejects the arguments: {reason}") from error


def check_names(given: Sequence[ParameterSection], nodes: Mapping[str, Collection[str]]) -> None:
    """Raise :class:`UserError` for parameters on the command line that no node reads.

    A section for all nodes may have parameters for nodes of other packages.

    Args:
        given: The parameters on the command line.
        nodes: The declared parameters of the nodes of the process, by full name.
    """
    for each in given:
        readers = [full for full in nodes if each.is_read_by(full)]
        if each.in_file:
            _check_namespace(each, given, nodes)
        elif not readers:
            (name,) = each.values
            raise UserError(
                f"-p {each.key}:{name}: ROS reads it for /{each.key}, expected "
                f"{' or '.join(nodes)}; write -p {name}:=VALUE"
            )
        known = {name for full in readers for name in nodes[full]}
        for name in each.values if readers else ():
            shared = each.of_any_node and describes_vehicle(name)
            if name in known or files.is_of_ros(name) or shared:
                continue
            absent = sorted(known - each.values.keys())
            if each.of_any_node and each.in_file and not meant_instead_of(name, absent):
                continue
            expected = f"a parameter of {' or '.join(readers)}{did_you_mean(name, absent)}"
            raise ConfigurationError(name, each.values[name], expected).located(each.origin)


def _check_namespace(
    section: ParameterSection, given: Sequence[ParameterSection], nodes: Collection[str]
) -> None:
    """Reject a section for the bare name of a node in a namespace: ROS reads ``mpc:`` for /mpc."""
    for full in nodes:
        name = full.rpartition("/")[2]
        if section.key.strip("/") != name or section.is_read_by(full):
            continue
        beside = (each for each in given if each.origin == section.origin)
        if not any(each.is_read_by(full) and each.key.strip("/*") for each in beside):
            raise UserError(
                f"{section.origin}: '{name}:' is for the node /{name}, and ROS does not read it "
                f"for {full}: write '/**/{name}:', which is read in every namespace"
            )


def _override(option: str, word: str) -> ParameterSection:
    """Return a ``-p`` as a section of a file."""
    rule = _OVERRIDE_PATTERN.fullmatch(word)
    if rule is None:
        raise UserError(f"{option}: given {word!r}, expected name:=value or node:name:=value")
    node, name, text = rule.groups()
    try:
        value = ros_yaml.read(text)
    except yaml.YAMLError:
        raise UserError(f"{option} {name}: given {text!r}, expected a YAML value") from None
    if isinstance(value, dict):
        raise UserError(f"{option} {name}: given {text!r}, expected one value or a list")
    files.refuse_what_ros_misreads(f"{option} {name}", value)
    return ParameterSection(origin=option, key=node or "/**", values={name: value})
