"""YAML as ROS reads it: which plain words of a parameter file are numbers, and which are not.

PyYAML follows YAML 1.1 and takes ``5e-2``, ``1e3`` and ``y`` for text, ``1_000`` and ``1:30`` for
numbers and ``null`` for nothing. ROS (``get_value`` of rcl_yaml_param_parser) asks C: a word is a
bool if it is one of a list, else what ``strtoll`` with base 0 or ``strtod`` takes as a whole, else
text. The same file is read by both, so it is read here as ROS does.
"""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from typing import Any

import yaml

from quad_mpc_ros.configuration.errors import UserError, os_reason

_TRUE = ("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON")
_FALSE = ("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF")
_BOOLS = {**dict.fromkeys(_TRUE, True), **dict.fromkeys(_FALSE, False)}

_INTEGERS = {
    16: re.compile(r"[+-]?0[xX][0-9a-fA-F]+"),
    8: re.compile(r"[+-]?0[0-7]*"),
    10: re.compile(r"[+-]?[1-9][0-9]*"),
}
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_HEXADECIMAL = re.compile(
    r"[+-]?0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)(?:[pP][+-]?[0-9]+)?"
)
_INFINITE = re.compile(r"([+-]?)(?:\.(?:inf|Inf|INF)|(?i:inf|infinity))")
_NOT_A_NUMBER = re.compile(r"\.(?:nan|NaN|NAN)|[+-]?(?i:nan)(?:\([0-9a-zA-Z_]*\))?")

_LONGEST = 100  # digits; Python refuses to count thousands of them

_PLAIN = "!plain"
_TEXT = "tag:yaml.org,2002:str"


def scalar(word: str) -> bool | int | float | str:
    """Return the value of a word that is not in quotes."""
    if word in _BOOLS:
        return _BOOLS[word]
    for base, form in _INTEGERS.items():
        if form.fullmatch(word) and len(word) <= _LONGEST:
            value = int(word, base)
            if -(2**63) <= value < 2**63:
                return value
    number = _real(word)
    return word if number is None else number


def _real(word: str) -> float | None:
    """Return what ``strtod`` makes of a word; None if it takes only a part, or finds no double."""
    if infinite := _INFINITE.fullmatch(word):
        return -math.inf if infinite[1] == "-" else math.inf
    if _NOT_A_NUMBER.fullmatch(word):
        return math.nan
    try:
        if _DECIMAL.fullmatch(word):
            number = float(word)
        elif _HEXADECIMAL.fullmatch(word):
            number = float.fromhex(word)
        else:
            return None
    except OverflowError:
        return None
    # Beyond the range, or so small that digits are lost: ERANGE.
    return number if number == 0.0 or sys.float_info.min <= abs(number) < math.inf else None


class _Loader(yaml.SafeLoader):
    """Refuses a key that is given twice, of which YAML readers take one and drop the other."""

    yaml_implicit_resolvers = {}  # noqa: RUF012, as PyYAML declares it

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping whose keys are text, whatever they look like."""
        given: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.MarkedYAMLError(problem="expected a name", problem_mark=key.start_mark)
            key.tag = _TEXT
            if key.value in given:
                problem = f"{key.value!r} is given twice"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            given.add(key.value)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Puts text into quotes that ROS would take for something else."""


def _plain(_: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:
    return scalar(node.value) if node.value else None


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if isinstance(scalar(text), str) else "'"
    return dumper.represent_scalar(_TEXT, text, style=style)


_Loader.add_implicit_resolver(_PLAIN, re.compile(""), None)
_Loader.add_constructor(_PLAIN, _plain)
_Dumper.add_representer(str, _text)


def read(text: str) -> Any:
    """Return the content of a text, nothing at all as None; raise :class:`yaml.YAMLError`."""
    try:
        return yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise yaml.YAMLError("it is nested too deeply") from None
    except ValueError as error:  # of an explicit tag: !!int x
        raise yaml.YAMLError(str(error)) from None


def read_file(path: Path) -> Any:
    """Return the content of a file; raise :class:`UserError` when it cannot be read."""
    try:
        return read(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {os_reason(error)}") from error
    except UnicodeDecodeError as error:
        raise UserError(
            f"{path}: not UTF-8 at byte {error.start}: expected a text file in UTF-8"
        ) from error
    except yaml.YAMLError as error:
        raise UserError(f"{path}: not YAML: {_reason(error)}") from error


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
