# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reader of every YAML file of this package, with the rules of ROS.

PyYAML follows YAML 1.1 and reads ``5e-2``, ``1e3`` and ``y`` as text, ``1_000`` and ``1:30`` as
numbers, ``2026-01-01`` as a date and ``null`` as no value. ROS (``get_value`` of
rcl_yaml_param_parser) uses C functions: a word is a bool if it is in a list, else a number if
``strtoll`` with base 0 or ``strtod`` parses the whole word, else text. Real numbers in hexadecimal
or out of range are not supported here. As in ROS, aliases and empty names are rejected and tags
other than ``!!str`` are ignored. Duplicate names are rejected, too.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from quad_mpc_ros.configuration.errors import UserError
from quad_mpc_ros.configuration.text_files import file_text

_TRUE = ("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON")
_FALSE = ("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF")
_BOOLS = {**dict.fromkeys(_TRUE, True), **dict.fromkeys(_FALSE, False)}

# At most 100 digits: Python refuses to convert thousands of digits.
_INTEGER = re.compile(r"[+-]?(?:(0[xX])[0-9a-fA-F]{1,100}|(0)[0-7]{0,100}|[1-9][0-9]{0,100})")
_REAL = re.compile(
    r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
    r"|[+-]?(?:\.(?:inf|Inf|INF)|(?i:inf|infinity|nan))|\.(?:nan|NaN|NAN)"
)

_PLAIN_TAG = "!plain"
_TEXT_TAG = "tag:yaml.org,2002:str"


def scalar(word: str) -> bool | int | float | str:
    """Return the value of a word without quotes."""
    if word in _BOOLS:
        return _BOOLS[word]
    if found := _INTEGER.fullmatch(word):
        value = int(word, 16 if found[1] else 8 if found[2] else 10)
        if -(2**63) <= value < 2**63:
            return value
    return float(re.sub(r"\.(?=[inIN])", "", word)) if _REAL.fullmatch(word) else word


class _Loader(yaml.SafeLoader):
    """Loads only mappings with text as names, lists, texts, numbers and bools."""

    yaml_implicit_resolvers = {}  # noqa: RUF012, as PyYAML declares it
    yaml_constructors = {}  # noqa: RUF012

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Reject aliases, as ROS does: a few lines of aliases make millions of values."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            problem = "an alias (*name), expected the value itself"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)


class _Dumper(yaml.SafeDumper):
    """Quotes text that ROS would read as another type."""


def _value(loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    """Return the value of a node, ignoring all tags except ``!!str``; names are text."""
    if isinstance(node, yaml.MappingNode):
        return _mapping(loader, node)
    if isinstance(node, yaml.SequenceNode):
        return [loader.construct_object(element, deep=True) for element in node.value]
    if not isinstance(node, yaml.ScalarNode) or node.style in ("'", '"'):
        return node.value
    if not node.value:
        return None
    return node.value if node.tag == _TEXT_TAG else scalar(node.value)


def _mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[str, Any]:
    made: dict[str, Any] = {}
    for key, value in node.value:
        problem = ""
        if not isinstance(key, yaml.ScalarNode) or not key.value:
            problem = "expected a name"
        elif key.value in made:
            problem = f"{key.value!r} is given twice"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
        made[key.value] = loader.construct_object(value, deep=True)
    return made


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if isinstance(scalar(text), str) else "'"
    return dumper.represent_scalar(_TEXT_TAG, text, style=style)


_Loader.add_implicit_resolver(_PLAIN_TAG, re.compile(""), None)
_Loader.add_constructor(None, _value)
_Dumper.add_representer(str, _text)


def read(text: str) -> Any:
    """Parse a text, None if the text is empty; raise :class:`yaml.YAMLError`."""
    try:
        return yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise yaml.YAMLError("nested too deeply") from None


def read_text(text: str, where: str) -> Any:
    """Parse a text; raise :class:`UserError`, which begins with ``where``."""
    try:
        return read(text)
    except yaml.YAMLError as error:
        raise UserError(f"{where}: not YAML: {_reason(error)}") from error


def read_file(path: Path) -> Any:
    """Return the content of a file; raise :class:`UserError` if reading fails."""
    return read_text(file_text(path), str(path))


def _reason(error: yaml.YAMLError) -> str:
    """Return the error and its position in one line."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem is None:
        return " ".join(str(error).split())
    mark = error.problem_mark
    where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
    hint = "; indent with spaces, not with tabs" if r"'\t'" in error.problem else ""
    return f"{where}{' '.join(error.problem.split())}{hint}"


def written(content: Any, **options: Any) -> str:
    """Return a text that :func:`read` and ROS can read; ``options`` are passed to PyYAML."""
    text: str = yaml.dump(content, Dumper=_Dumper, **options)
    return text
