# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of bags without ROS, decoded by the rosbags library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rosbags import typesys

from quad_mpc_ros.configuration import BagError


class MessageDecoder:
    """Decodes the message types of ROS 2 Jazzy and given types, using rosbags.

    Fields as in the rclpy message, except that a ``byte`` is a signed integer and a sequence of
    numbers is a NumPy array.
    """

    def __init__(self, definitions: Mapping[str, str] | None = None) -> None:
        """Take the definitions in a bag by type name, parsed at the first message of the type."""
        self._unregistered = dict(definitions or {})
        self._store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)

    def decode(self, type_name: str, data: bytes) -> Any:
        """Return the message in ``data`` (CDR with its header).

        Raises :class:`BagError` for an unknown type, for invalid data, and for a definition that
        cannot be parsed or differs from ROS 2 Jazzy.
        """
        if type_name in self._unregistered:
            self._register(type_name, self._unregistered[type_name])
            del self._unregistered[type_name]
        if type_name not in self._store.fielddefs:
            raise BagError(f"the message type {type_name} is unknown")
        try:
            # A bytearray makes the arrays of the message writable.
            return self._store.deserialize_cdr(memoryview(bytearray(data)), type_name)
        # rosbags' generated code raises anything for bytes that do not fit the type.
        except Exception as error:
            raise BagError(f"cannot decode a {type_name}: {error}") from error

    def _register(self, type_name: str, text: str) -> None:
        try:
            self._store.register(typesys.get_types_from_msg(text, type_name))
        except typesys.TypesysError as error:
            first_line = str(error).partition("\n")[0]
            raise BagError(f"schema of {type_name}: {first_line}") from error
