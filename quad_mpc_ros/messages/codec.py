"""Messages without ROS: made, encoded and decoded by the rosbags library."""

from __future__ import annotations

import re
import struct
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)

from quad_mpc_ros.messages.errors import BagError
from quad_mpc_ros.messages.message_plans import MessagePlans
from quad_mpc_ros.messages.schemas import IDL_ENCODING, MessageSchema

# What rosbags' generated code lets through for values and bytes that do not fit the type.
_MISFITS = (
    SerdeError,
    struct.error,
    AttributeError,
    IndexError,
    OverflowError,
    TypeError,
    ValueError,
)


class RosbagsMessages:
    """The messages of ROS 2 Jazzy, and those registered, as plain Python objects.

    An object has the fields of the rclpy message, reads and writes by attribute, and serializes
    to the same bytes, with two exceptions that carry nothing. Where rclpy on Fast DDS leaves
    alignment gaps as they happen to be in memory, they are zero here. And rclpy appends unused
    bytes to some messages, those of a fixed size that is no multiple of four and those with
    empty sequences of 8-byte numbers (``std_msgs/Bool``, ``sensor_msgs/JointState``); here there
    are none, nor has rclpy any for the shipped types.
    """

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._jazzy_types = frozenset(self._store.fielddefs)
        self._plans = MessagePlans(self._store)

    def new(self, type_name: str) -> Any:
        """Return a message of a Jazzy type as rclpy constructs it.

        Numbers are zero, texts and sequences empty, fixed arrays of numbers zero NumPy arrays,
        nested messages made likewise, and defaults of the .msg file are kept (a quaternion has
        w = 1). Raises :class:`BagError` for other types: their defaults are not known.
        """
        if type_name not in self._jazzy_types:
            raise BagError(f"{type_name} is not one of the message types of ROS 2 Jazzy")
        return self._plans.blank(type_name)

    def encode(self, type_name: str, message: Any) -> bytes:
        """Return ``message`` as little-endian CDR with its header.

        Raises :class:`BagError` for an unknown type and for a value that its field cannot hold.
        """
        self._check_known(type_name)
        try:
            packed = self._plans.packed(type_name, message)
            return bytes(self._store.serialize_cdr(packed, type_name, little_endian=True))
        except _MISFITS as error:
            raise BagError(f"cannot encode a {type_name}: {error}") from error

    def decode(self, type_name: str, data: bytes) -> Any:
        """Return the message in ``data`` (CDR with its header).

        Sequences of numbers come as NumPy arrays. Raises :class:`BagError` for an unknown type
        and for data that are not such a message.
        """
        self._check_known(type_name)
        try:
            # Of a bytearray, so that the arrays of the message can be written to.
            message = self._store.deserialize_cdr(memoryview(bytearray(data)), type_name)
        except _MISFITS as error:
            raise BagError(f"cannot decode a {type_name}: {error}") from error
        return self._plans.unpacked(type_name, message)

    def register(self, schema: MessageSchema) -> None:
        """Make the type of ``schema``, and those it uses, known.

        Raises :class:`BagError` for text that cannot be parsed or leaves a type open, and for a
        definition that differs from the one known under that name.
        """
        try:
            definitions = _definitions(schema)
            known = definitions.keys() | self._store.fielddefs.keys()
            if missing := _types_used(definitions) - known:
                raise BagError(f"schema of {schema.type_name}: {min(missing)} is not defined")
            self._store.register(definitions)
        except TypesysError as error:
            first_line = str(error).partition("\n")[0]
            raise BagError(f"schema of {schema.type_name}: {first_line}") from error

    def _check_known(self, type_name: str) -> None:
        if type_name not in self._store.fielddefs:
            raise BagError(f"the message type {type_name} is not known")


def _definitions(schema: MessageSchema) -> Typesdict:
    if schema.encoding == IDL_ENCODING:
        found: Typesdict = {}
        for section in schema.text.split(f"{'=' * 80}\nIDL: ")[1:]:
            text = section.partition("\n")[2]
            # The parser knows no directives of the preprocessor; what is included follows anyway.
            found |= get_types_from_idl(re.sub(r"(?m)^\s*#.*$", "", text))
        return found
    return get_types_from_msg(schema.text, schema.type_name)


def _types_used(definitions: Typesdict) -> set[str]:
    fields = [field for _, named in definitions.values() for _, field in named]
    elements = [
        field if field[0] in (Nodetype.BASE, Nodetype.NAME) else field[1][0] for field in fields
    ]
    return {str(element[1]) for element in elements if element[0] == Nodetype.NAME}
