# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Message definitions and type hashes, with or without a ROS installation."""

from __future__ import annotations

import functools
import json
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from quad_mpc_ros.configuration.errors import BagError

MSG_ENCODING = "ros2msg"
"""The encoding of definitions in bags."""


@dataclass(frozen=True, kw_only=True)
class MessageSchema:
    """The definition of a message type as rosbag2 stores it, and its REP-2011 hash.

    ``text`` follows ``LocalMessageDefinitionSource::get_full_text`` of rosbag2_cpp (Jazzy): the
    .msg file byte for byte; then for every used type, once, in the byte order of names: a newline,
    a line of 80 ``=``, a line ``MSG: `` with the name as spelled in the field (prefixed with the
    package if missing), the .msg file of that type, and directly after it the types used there. No
    newline is added at the end.
    """

    text: str
    type_hash: str


def schema_for(type_name: str) -> MessageSchema:
    """Return the schema of ``type_name`` (``pkg/msg/Type``).

    The schema is built from the installed message packages, below ``AMENT_PREFIX_PATH`` and, for
    ROS from wheels, ``sys.prefix``. Without these packages, rosbags' definition of ROS 2 Jazzy is
    used, without comments. Raises :class:`BagError` with the places searched.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise BagError(f"{type_name!r} is not the name of a message type; expected pkg/msg/Type")
    package, name = match.groups()
    try:
        text = _full_text(package, name, seen=set())
        hashes = json.loads(_installed_file(package, f"{name}.json"))["type_hashes"]
    except _NotInstalledError:
        schema = _jazzy_schema(type_name)
        if schema is None:
            raise
        return schema
    type_hash = next(each["hash_string"] for each in hashes if each["type_name"] == type_name)
    return MessageSchema(text=text, type_hash=type_hash)


_TYPE_NAME = re.compile(r"([a-zA-Z0-9_]+)/msg/([a-zA-Z0-9_]+)")

# The expressions and the list of local_message_definition_source.cpp: what they overlook (a
# bounded string, for one) is overlooked here too.
_FIELD_TYPE = re.compile(r"(?:^|\n)\s*([a-zA-Z0-9_/]+)(?:\[[^\]]*\])?\s+")
_PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16"}
_PRIMITIVES |= {"int32", "uint32", "int64", "uint64", "string"}


class _NotInstalledError(BagError):
    pass


def _dependencies(text: str, package: str) -> set[str]:
    found = {match[1] for match in _FIELD_TYPE.finditer(text)} - _PRIMITIVES
    return {name if "/" in name else f"{package}/{name}" for name in found}


@functools.cache
def _jazzy_schema(type_name: str) -> MessageSchema | None:
    from rosbags import typesys  # where ROS is installed, recording needs no rosbags

    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    if type_name not in store.fielddefs:
        return None
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return MessageSchema(text=text, type_hash=store.hash_rihs01(type_name))


def _full_text(package: str, name: str, *, seen: set[str]) -> str:
    text = _installed_file(package, f"{name}.msg").decode()
    parts = [text]
    for dependency in sorted(_dependencies(text, package)):
        if dependency not in seen:
            seen.add(dependency)
            parts.append(f"\n{'=' * 80}\nMSG: {dependency}\n")
            parts.append(_full_text(*dependency.split("/", 1), seen=seen))
    return "".join(parts)


def _installed_file(package: str, file_name: str) -> bytes:
    relative = Path("share", package, "msg", file_name)
    entries = (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix)
    prefixes = [Path(entry) for entry in dict.fromkeys(entries) if entry]
    for prefix in prefixes:
        if (prefix / relative).is_file():
            return (prefix / relative).read_bytes()
    raise _NotInstalledError(
        f"no message definition {relative} below any of {', '.join(map(str, prefixes))}; "
        f"install {package} or source the workspace that has it (AMENT_PREFIX_PATH)"
    )
