"""Messages of bags without ROS, decoded by the rosbags library."""

from __future__ import annotations

import re
import struct
from typing import Any

from rosbags import typesys
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.schemas import IDL_ENCODING, MessageSchema

# What rosbags' generated code lets through for bytes that do not fit the type.
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


class MessageDecoder:
    """Decodes the message types of ROS 2 Jazzy and those registered, as rosbags has them.

    The fields are those of the rclpy message, but a ``byte`` is a signed integer and a sequence
    of numbers a NumPy array.
    """

    def __init__(self) -> None:
        self._store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)

    def decode(self, type_name: str, data: bytes) -> Any:
        """Return the message in ``data`` (CDR with its header).

        Raises :class:`BagError` for an unknown type and for data that are not such a message.
        """
        if type_name not in self._store.fielddefs:
            raise BagError(f"the message type {type_name} is not known")
        try:
            # Of a bytearray, so that the arrays of the message can be written to.
            return self._store.deserialize_cdr(memoryview(bytearray(data)), type_name)
        except _MISFITS as error:
            raise BagError(f"cannot decode a {type_name}: {error}") from error

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


def _types_used(definitions: Typesdict) -> set[str]:
    fields = [field for _, named in definitions.values() for _, field in named]
    elements = [
        field if field[0] in (Nodetype.BASE, Nodetype.NAME) else field[1][0] for field in fields
    ]
    return {str(element[1]) for element in elements if element[0] == Nodetype.NAME}
