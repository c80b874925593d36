"""Message definitions and type hashes, with or without a ROS installation."""

from __future__ import annotations

import functools
import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from quad_mpc_ros.configuration.errors import BagError, os_reason

MSG_ENCODING = "ros2msg"
IDL_ENCODING = "ros2idl"


@dataclass(frozen=True, kw_only=True)
class MessageSchema:
    """The definition of a message type as rosbag2 stores it, and its REP-2011 hash.

    ``text`` follows ``LocalMessageDefinitionSource::get_full_text`` of rosbag2_cpp (Jazzy): the
    .msg file byte for byte, then for every type it uses, in the order of their names as bytes
    and each type once, a newline, a line of 80 ``=``, a line ``MSG: `` and the name as the field
    spells it (with its package in front when it has none), the .msg file of that type, and at
    once the types that one uses in turn. No newline is added at the end. ``encoding`` is
    ``ros2msg``, or ``ros2idl`` for a type that has only an .idl file: then a heading like those
    of the other types, with ``IDL:``, comes first.
    """

    type_name: str
    text: str
    type_hash: str
    encoding: str = MSG_ENCODING


def schema_for(type_name: str) -> MessageSchema:
    """Return the schema of ``type_name`` (``pkg/msg/Type``).

    The schema is built from the installed message packages, below ``AMENT_PREFIX_PATH`` and, for
    ROS from wheels, ``sys.prefix``. Without them it is the definition of ROS 2 Jazzy that rosbags
    has, without comments. Raises :class:`BagError` with the places searched.
    """
    package, name = _package_and_name(type_name)
    encoding = MSG_ENCODING
    try:
        text = _full_text(f"{package}/{name}", _MSG, seen=set())
    except _NotInstalledError:
        if not _is_installed(package, f"{name}.idl"):
            schema = _jazzy_schema(type_name)
            if schema is None:
                raise
            return schema
        encoding = IDL_ENCODING
        text = _IDL.heading(type_name) + _full_text(type_name, _IDL, seen=set())
    return MessageSchema(
        type_name=type_name,
        text=text,
        type_hash=_installed_hash(type_name),
        encoding=encoding,
    )


_TYPE_NAME = re.compile(r"([a-zA-Z0-9_]+)/msg/([a-zA-Z0-9_]+)")
_FIELD_TYPE_NAME = re.compile(r"([a-zA-Z0-9_]+)/(?:msg/)?([a-zA-Z0-9_]+)")

# The expressions and the list of local_message_definition_source.cpp: what they overlook (a
# bounded string, for one) is overlooked here too.
_FIELD_TYPE = re.compile(r"(?:^|\n)\s*([a-zA-Z0-9_/]+)(?:\[[^\]]*\])?\s+")
_PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16"}
_PRIMITIVES |= {"int32", "uint32", "int64", "uint64", "string"}
_INCLUDE = re.compile(r'(?:^|\n)#include\s+["<]([a-zA-Z0-9_/]+)\.idl[">]')


class _NotInstalledError(BagError):
    pass


@dataclass(frozen=True, kw_only=True)
class _Format:
    """One of the two languages in which message types are defined."""

    extension: str
    dependencies: Callable[[str, str], set[str]]

    def heading(self, type_reference: str) -> str:
        return f"{'=' * 80}\n{self.extension.upper()}: {type_reference}\n"


def _msg_dependencies(text: str, package: str) -> set[str]:
    found = {match[1] for match in _FIELD_TYPE.finditer(text)} - _PRIMITIVES
    return {name if "/" in name else f"{package}/{name}" for name in found}


def _idl_dependencies(text: str, _: str) -> set[str]:
    return {match[1] for match in _INCLUDE.finditer(text)}


_MSG = _Format(extension="msg", dependencies=_msg_dependencies)
_IDL = _Format(extension="idl", dependencies=_idl_dependencies)


@functools.cache
def _jazzy_schema(type_name: str) -> MessageSchema | None:
    from rosbags import typesys  # where ROS is installed, recording needs no rosbags

    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    if type_name not in store.fielddefs:
        return None
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    type_hash = store.hash_rihs01(type_name)
    return MessageSchema(type_name=type_name, text=text, type_hash=type_hash)


def _package_and_name(type_name: str) -> tuple[str, str]:
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise BagError(f"{type_name!r} is not the name of a message type; expected pkg/msg/Type")
    return match[1], match[2]


def _full_text(type_reference: str, kind: _Format, *, seen: set[str]) -> str:
    match = _FIELD_TYPE_NAME.fullmatch(type_reference)
    if match is None:
        raise BagError(f"{type_reference!r} is not the name of a message type")
    package, name = match[1], match[2]
    text = _installed_file(package, f"{name}.{kind.extension}").decode()
    parts = [text]
    for dependency in sorted(kind.dependencies(text, package)):
        if dependency not in seen:
            seen.add(dependency)
            parts += ["\n", kind.heading(dependency)]
            parts.append(_full_text(dependency, kind, seen=seen))
    return "".join(parts)


def _installed_hash(type_name: str) -> str:
    package, name = _package_and_name(type_name)
    description = json.loads(_installed_file(package, f"{name}.json"))
    for entry in description["type_hashes"]:
        if entry["type_name"] == type_name:
            return str(entry["hash_string"])
    raise BagError(f"{type_name}: share/{package}/msg/{name}.json holds no hash of this type")


def _installed_file(package: str, file_name: str) -> bytes:
    relative = Path("share", package, "msg", file_name)
    prefixes = list(dict.fromkeys(_prefixes()))
    for prefix in prefixes:
        path = prefix / relative
        try:
            return path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            raise BagError(f"{path}: cannot be read: {os_reason(error)}") from error
    raise _NotInstalledError(
        f"no message definition {relative} below any of {', '.join(map(str, prefixes))}; "
        f"install {package} or source the workspace that has it (AMENT_PREFIX_PATH)"
    )


def _is_installed(package: str, file_name: str) -> bool:
    return any((prefix / "share" / package / "msg" / file_name).exists() for prefix in _prefixes())


def _prefixes() -> Iterator[Path]:
    for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if entry:
            yield Path(entry)
    yield Path(sys.prefix)
