"""Reading and writing the YAML files of campaigns and studies."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration import ConfigurationError, UserError, ros_yaml
from quad_mpc_ros.configuration.spelling import did_you_mean


def read_content(path: Path, what: str) -> dict[Any, Any]:
    """Return the content of a file of a campaign or study. Raises :class:`UserError`."""
    content = ros_yaml.read_file(path)
    if not isinstance(content, dict):
        raise UserError(f"{path}: expected the keys of a {what}, given {content!r:.60}")
    return content


def content_text(content: Mapping[str, Any]) -> str:
    """Return the text of a file with these keys and exact numbers."""
    return ros_yaml.written(content, sort_keys=False, default_flow_style=None, width=math.inf)


@contextlib.contextmanager
def errors_of(where: str) -> Iterator[None]:
    """Prefix errors with the source of the content."""
    try:
        yield
    except ConfigurationError as error:
        raise error.located(where) from error
    except UserError as error:
        raise UserError(f"{where}: {error}") from error


def check_keys(content: Mapping[Any, Any], known: Sequence[str]) -> None:
    """Raise :class:`UserError` for an unknown key."""
    for key in content:
        if key not in known:
            hint = did_you_mean(str(key), known) or f" ({', '.join(known)})"
            raise UserError(f"unknown key {key!r}{hint}")


def number(name: str, given: Any, *, most: float = sys.float_info.max) -> float:
    """Return a number from 0 to ``most``. Raises :class:`ConfigurationError`."""
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 <= given <= most:
        expected = "a number >= 0" if most > 1.0 else f"a number from 0 to {most:g}"
        raise ConfigurationError(name, given, expected)
    return float(given)


def integer(name: str, given: Any, *, least: int, most: int) -> int:
    """Return an integer within bounds. Raises :class:`ConfigurationError`."""
    if type(given) is not int or not least <= given <= most:
        raise ConfigurationError(name, given, f"a whole number from {least} to {most}")
    return given
