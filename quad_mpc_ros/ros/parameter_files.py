"""Parameter files that ROS would silently ignore."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from quad_mpc_ros.configuration import UserError

_OPTION = "--params-file"


def refuse_unread_files(name: str, namespace: str, arguments: Sequence[str]) -> None:
    """Raise :class:`UserError` for a file with a node's bare name, given in a namespace.

    ROS reads ``mpc:`` for the node /mpc only; in a namespace such a file would be ignored and the
    defaults flown.
    """
    if namespace == "/":
        return
    for option, path in itertools.pairwise(arguments):
        if option == _OPTION and _is_ignored(Path(path), name, namespace):
            raise UserError(
                f"{path}: '{name}:' is for the node /{name}, and ROS does not read it for "
                f"{namespace}/{name}: write '/**/{name}:', which is read in every namespace"
            )


def _is_ignored(path: Path, name: str, namespace: str) -> bool:
    """Whether a file has parameters for a node of this name, but none for that namespace."""
    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return False  # ROS reports it
    if not isinstance(content, dict):
        return False
    keys = {str(key).strip("/") for key, section in content.items() if _has_parameters(section)}
    read = {f"**/{name}", f"{namespace.strip('/')}/{name}", f"{namespace.strip('/')}/*"}
    return name in keys and not keys & read


def _has_parameters(section: Any) -> bool:
    return isinstance(section, dict) and bool(section.get("ros__parameters"))
