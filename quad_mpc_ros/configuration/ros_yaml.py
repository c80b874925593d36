"""The reader of every YAML file of this package; it reads YAML as ROS does.

PyYAML follows YAML 1.1 and takes ``5e-2``, ``1e3`` and ``y`` for text, ``1_000`` and ``1:30`` for
numbers, ``2026-01-01`` for a date and ``null`` for nothing. To ROS (``get_value`` of
rcl_yaml_param_parser) a word is a bool if it is one of a list, else a number if C takes all of it
for one, else text. Octal and hexadecimal numbers are text here. As in ROS, aliases and empty names
are refused and tags other than ``!!str`` mean nothing. A name that is given twice is refused, too.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import yaml

from quad_mpc_ros.configuration.errors import UserError
from quad_mpc_ros.configuration.text_files import file_text

_TRUE = ("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON")
_FALSE = ("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF")
_BOOLS = {**dict.fromkeys(_TRUE, True), **dict.fromkeys(_FALSE, False)}

_INTEGER = re.compile(r"[+-]?(?:0|[1-9][0-9]{0,18})")
_REAL = re.compile(r"[+-]?(?:0|[1-9][0-9]*|[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(?:\.?inf|\.?nan|infinity)", re.ASCII | re.IGNORECASE)
_LOOKS_LIKE_A_NUMBER = re.compile(r"[-+.0-9].*|(?i:nan).*", re.DOTALL)

_PLAIN = "!plain"
_TEXT = "tag:yaml.org,2002:str"


def scalar(word: str) -> bool | int | float | str:
    """Return the value of a word that is not in quotes."""
    if word in _BOOLS:
        return _BOOLS[word]
    if _INTEGER.fullmatch(word) and -(2**63) <= int(word) < 2**63:
        return int(word)
    if _REAL.fullmatch(word) and abs(float(word)) < math.inf:
        return float(word)
    if _NOT_FINITE.fullmatch(word):
        return float(word.replace(".", ""))
    return word


class _Loader(yaml.SafeLoader):
    """Makes nothing but mappings with text as names, lists, texts, numbers and bools."""

    yaml_implicit_resolvers = {}  # noqa: RUF012, as PyYAML declares it
    yaml_constructors = {}  # noqa: RUF012

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse aliases, as ROS does: a few lines of them make millions of values."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            problem = "an alias (*name), expected the value itself"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)


class _Dumper(yaml.SafeDumper):
    """Puts text into quotes that ROS would take for something else."""


def _value(loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    """Return the value of a node; of tags only that of text counts."""
    if isinstance(node, yaml.MappingNode):
        return _mapping(loader, node)
    if isinstance(node, yaml.SequenceNode):
        return [loader.construct_object(element, deep=True) for element in node.value]
    if not isinstance(node, yaml.ScalarNode) or node.style in ("'", '"'):
        return node.value
    if not node.value:
        return None
    return node.value if node.tag == _TEXT else scalar(node.value)


def _mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[str, Any]:
    """Return a mapping whose names are text, whatever they look like."""
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
    plain = isinstance(scalar(text), str) and not _LOOKS_LIKE_A_NUMBER.fullmatch(text)
    return dumper.represent_scalar(_TEXT, text, style=None if plain else "'")


_Loader.add_implicit_resolver(_PLAIN, re.compile(""), None)
_Loader.add_constructor(None, _value)
_Dumper.add_representer(str, _text)


def read(text: str) -> Any:
    """Return the content of a text, nothing at all as None; raise :class:`yaml.YAMLError`."""
    try:
        return yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise yaml.YAMLError("it is nested too deeply") from None


def read_text(text: str, where: str) -> Any:
    """Return the content of a text; raise :class:`UserError`, which begins with ``where``."""
    try:
        return read(text)
    except yaml.YAMLError as error:
        raise UserError(f"{where}: not YAML: {_reason(error)}") from error


def read_file(path: Path) -> Any:
    """Return the content of a file; raise :class:`UserError` when it cannot be read."""
    return read_text(file_text(path), str(path))


def _reason(error: yaml.YAMLError) -> str:
    """Return in one line what is wrong, and where."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem is None:
        return " ".join(str(error).split())
    mark = error.problem_mark
    where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
    hint = "; indent with spaces, not with tabs" if r"'\t'" in error.problem else ""
    return f"{where}{' '.join(error.problem.split())}{hint}"


def written(content: Any, **options: Any) -> str:
    """Return a text that :func:`read`, and ROS, read back; ``options`` are those of PyYAML."""
    text: str = yaml.dump(content, Dumper=_Dumper, **options)
    return text
