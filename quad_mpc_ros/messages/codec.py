"""Messages of bags without ROS, decoded by the rosbags library."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable
from typing import Any

from rosbags import typesys
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.schemas import IDL_ENCODING, MessageSchema

# What rosbags' generated code lets through for bytes that do not fit the type, and for a type
# that uses an undefined one.
_MISFITS = (
    SerdeError,
    struct.error,
    AttributeError,
    LookupError,
    OverflowError,
    TypeError,
    ValueError,
)


class MessageDecoder:
    """Decodes the message types of ROS 2 Jazzy and those given, as rosbags has them.

    The fields are those of the rclpy message, but a ``byte`` is a signed integer and a sequence
    of numbers a NumPy array.
    """

    def __init__(self, schemas: Iterable[MessageSchema] = ()) -> None:
        """Take the definitions in a bag; each is parsed with its first message."""
        self._unregistered = {schema.type_name: schema for schema in schemas}
        self._store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)

    def decode(self, type_name: str, data: bytes) -> Any:
        """Return the message in ``data`` (CDR with its header).

        Raises :class:`BagError` for an unknown type, for data that are not such a message, and for
        a definition that cannot be parsed or differs from the one in ROS 2 Jazzy.
        """
        if type_name in self._unregistered:
            self._register(self._unregistered[type_name])
            del self._unregistered[type_name]
        if type_name not in self._store.fielddefs:
            raise BagError(f"the message type {type_name} is not known")
        try:
            # Of a bytearray, so that the arrays of the message can be written to.
            return self._store.deserialize_cdr(memoryview(bytearray(data)), type_name)
        except _MISFITS as error:
            raise BagError(f"cannot decode a {type_name}: {error}") from error

    def _register(self, schema: MessageSchema) -> None:
        try:
            self._store.register(_definitions(schema))
        except typesys.TypesysError as error:
            first_line = str(error).partition("\n")[0]
            raise BagError(f"schema of {schema.type_name}: {first_line}") from error


def _definitions(schema: MessageSchema) -> Typesdict:
    if schema.encoding == IDL_ENCODING:
        found: Typesdict = {}
        for section in schema.text.split(f"{'=' * 80}\nIDL: ")[1:]:
            text = section.partition("\n")[2]
            # The parser knows no directives of the preprocessor; what is included follows anyway.
            found |= typesys.get_types_from_idl(re.sub(r"(?m)^\s*#.*$", "", text))
        return found
    return typesys.get_types_from_msg(schema.text, schema.type_name)
