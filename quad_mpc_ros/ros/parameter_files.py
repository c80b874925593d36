# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter files and ``-p`` on the ROS command line of a process, by section.

rclpy merges the sections for a node and ignores other sections, also misspelt names. This module
reads the arguments separately, with the rules of ``--config``, to report errors. The values come
from rclpy.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import yaml

from quad_mpc_ros.configuration import UserError, files, ros_yaml
from quad_mpc_ros.configuration.extension import BRIDGES, registered_names
from quad_mpc_ros.configuration.files import ParameterSection
from quad_mpc_ros.configuration.spelling import meant_instead_of
from quad_mpc_ros.configuration.vehicle import describes_vehicle

_ROS_ARGS, _ROS_ARGS_END = "--ros-args", "--"
_FILE_OPTION = "--params-file"
_OVERRIDE_OPTIONS = ("-p", "--param")
_NODE_NAME_PATTERN = re.compile(r"(?:^|:)__node:=(\w+)$")
_OVERRIDE_PATTERN = re.compile(r"(?:(\w+):)?([\w./]+):=(.*)", re.DOTALL)
_OWN_NODES = ("mpc", "simulator", "reference", "recorder", "player", "visualisation")


class CommandLineParameters:
    """The parameters on the command line of a process."""

    def __init__(self, sections: Sequence[ParameterSection], *, several: bool) -> None:
        """Initialise with the sections; ``several``: the process has more than one node."""
        self._sections = sections
        self._in_files = [each for each in sections if each.origin not in _OVERRIDE_OPTIONS]
        self._several = several

    def of(self, name: str, namespace: str) -> dict[str, str]:
        """Return the origin of each parameter that a node receives by its own name.

        Raises :class:`UserError` for a file with the node's bare name if the node has a namespace:
        ROS reads ``mpc:`` only for the node /mpc.
        """
        full = f"{namespace.rstrip('/')}/{name}"
        read = [each for each in self._sections if each.is_read_by(full)]
        named = {each.origin for each in read if each.key.strip("/") not in ("**", "*")}
        for each in self._in_files:
            if each.key.strip("/") == name and each.origin not in named:
                raise UserError(
                    f"{each.origin}: '{name}:' is for the node /{name}, and ROS does not read it "
                    f"for {full}: write '/**/{name}:', which is read in every namespace"
                )
        found: dict[str, str] = {}
        for each in read:
            alone = each not in self._in_files and not self._several
            if alone or not each.of_any_node:
                found |= dict.fromkeys(each.values, each.origin)
        return found

    def file_of(self, name: str) -> str | None:
        """Return the last file with a parameter; None if a ``-p`` overrides it."""
        last = next((each for each in reversed(self._sections) if name in each.values), None)
        return last.origin if last in self._in_files else None

    def reject_unused_overrides(self, nodes: Mapping[str, Container[str]]) -> None:
        """Raise :class:`UserError` for a ``-p`` that no node of the process reads.

        ``nodes``: the declared parameters by full node name.
        """
        expected = " or ".join(nodes)
        for each in self._sections:
            if each in self._in_files:
                continue
            (name,) = each.values
            readers = [known for full, known in nodes.items() if each.is_read_by(full)]
            if not readers:
                raise UserError(
                    f"-p {each.key}:{name}: ROS reads it for /{each.key}, expected {expected}; "
                    f"write -p {name}:=VALUE"
                )
            of_all = files.is_of_ros(name) or describes_vehicle(name)
            if not (of_all or any(name in known for known in readers)):
                raise UserError(f"{each.origin}: given {name}, expected a parameter of {expected}")

    def unread_files(self, nodes: Iterable[str]) -> list[str]:
        """Return a warning for each file without a section for any of the nodes."""
        keys: dict[str, list[str]] = {}
        for each in self._in_files:
            keys.setdefault(each.origin, []).append(each.key)
        for each in self._in_files:
            if any(map(each.is_read_by, nodes)):
                keys.pop(each.origin, None)
        return [
            f"{origin} has no parameters of {' or '.join(nodes)}, only of {', '.join(there)}"
            for origin, there in keys.items()
        ]


_current: ContextVar[CommandLineParameters | None] = ContextVar("given_parameters", default=None)


def command_line_parameters() -> CommandLineParameters | None:
    """Return the parameters on the command line; None for a node not started by ``run``."""
    return _current.get()


@contextmanager
def using_parameters(given: CommandLineParameters) -> Iterator[None]:
    """Provide the command-line parameters to nodes that are created in this context."""
    token = _current.set(given)
    try:
        yield
    finally:
        _current.reset(token)


def own_arguments(arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are not for ROS."""
    return [word for word, for_ros in _marked(arguments) if not for_ros]


def refuse_own_arguments(arguments: Sequence[str]) -> None:
    """Raise :class:`UserError` for arguments that are not for ROS."""
    own = own_arguments(arguments)
    if own:
        raise UserError(f"given {' '.join(own)}, expected arguments for ROS, after {_ROS_ARGS}")


def read_arguments(arguments: Sequence[str], *, several: bool) -> CommandLineParameters:
    """Return the parameters in the arguments of a process.

    Raises :class:`UserError` for an unreadable file, an invalid value or a misspelt node name.
    """
    words = [word for word, for_ros in _marked(arguments) if for_ros]
    names = {found[1] for word in words if (found := _NODE_NAME_PATTERN.search(word))}
    given: list[ParameterSection] = []
    for option, word in itertools.pairwise(words):
        if option == _FILE_OPTION:
            given += read_parameter_file(_FILE_OPTION, word, names)
        elif option in _OVERRIDE_OPTIONS:
            section = _override(option, word)
            _refuse_misspelt_nodes(f"{option} {word}", [section], names)
            given.append(section)
    return CommandLineParameters(given, several=several)


def read_parameter_file(
    option: str, given: str, names: Iterable[str] = ()
) -> list[ParameterSection]:
    """Return the sections of a parameter file given by an option.

    Raises :class:`UserError` for a file that is missing or that ROS cannot read, and for a
    misspelt node name; ``names`` are additional valid names.
    """
    there = files.sections(files.parameter_file(option, given))
    _refuse_misspelt_nodes(given, there, names)
    return there


def _marked(arguments: Sequence[str]) -> Iterator[tuple[str, bool]]:
    """Yield each argument and whether it is for ROS, without the delimiters."""
    for_ros = False
    for word in arguments:
        if word == _ROS_ARGS:
            for_ros = True
        elif word == _ROS_ARGS_END and for_ros:
            for_ros = False
        else:
            yield word, for_ros


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


def _refuse_misspelt_nodes(
    origin: str, there: Sequence[ParameterSection], names: Iterable[str]
) -> None:
    """Reject a section that is certainly a misspelt node of this package.

    Sections of other nodes are ignored. ``names``: names given to nodes of this process.
    """
    given = {section.node for section in there}
    known = {*_OWN_NODES, *registered_names(BRIDGES)}
    for other in sorted(given - known - {*names, "*", "**"}):
        meant = meant_instead_of(other, sorted(known - given))
        if meant is not None:
            (key, *_) = (section.key for section in there if section.node == other)
            raise UserError(f"{origin}: given node {key!r}, did you mean {meant}?")
