"""Messages without ROS: made, encoded and decoded by the rosbags library."""

from __future__ import annotations

import copy
import operator
import re
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags import typesys
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from quad_mpc_ros.configuration import BagError
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
        self._store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
        self._jazzy_types = frozenset(self._store.fielddefs)
        self._fields = _MessageFields(self._store)

    def new(self, type_name: str) -> Any:
        """Return a message of a Jazzy type as rclpy constructs it.

        Numbers are zero, texts and sequences empty, fixed arrays of numbers zero NumPy arrays,
        nested messages made likewise, and defaults of the .msg file are kept (a quaternion has
        w = 1). Raises :class:`BagError` for other types: their defaults are not known.
        """
        if type_name not in self._jazzy_types:
            raise BagError(f"{type_name} is not one of the message types of ROS 2 Jazzy")
        return self._fields.maker(type_name)()

    def encode(self, type_name: str, message: Any) -> bytes:
        """Return ``message`` as little-endian CDR with its header.

        Raises :class:`BagError` for an unknown type and for a value that its field cannot hold.
        """
        self._check_known(type_name)
        try:
            packed = self._fields.converted(type_name, message, _packing)
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
        return self._fields.converted(type_name, message, _unpacking)

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

    def _check_known(self, type_name: str) -> None:
        if type_name not in self._store.fielddefs:
            raise BagError(f"the message type {type_name} is not known")


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp [ns] in CDR of a type that begins with a ``std_msgs/Header``.

    Raises :class:`BagError` for data that are too short.
    """
    try:
        seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    except (IndexError, struct.error) as error:
        raise BagError(f"cannot decode a stamp: {error}") from error
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


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


_Maker = Callable[[], Any]
_Converter = Callable[[Any], Any]
_LeafRule = Callable[[FieldDesc], _Converter | None]

_DECLARED_DEFAULTS: dict[str, dict[str, Any]] = {
    "geometry_msgs/msg/Quaternion": {"w": 1.0},
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
}
"""Defaults other than zero in the .msg files of Jazzy: rosbags drops them when it parses."""


class _MessageFields:
    """Per message type of a type store: how to make one, and how to convert it.

    Each is worked out once, at the first message of its type.

    rosbags' message classes take every field at construction, its encoder accepts NumPy arrays
    only where rclpy accepts any sequence, and it has integers where rclpy has ``bytes`` of length
    one.
    """

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._makers: dict[str, _Maker] = {}
        self._converters: dict[tuple[str, _LeafRule], _Converter | None] = {}

    def converted(self, type_name: str, message: Any, rule: _LeafRule) -> Any:
        """Return ``message`` with every value converted by a rule, a copy where any changes.

        ``_packing`` makes it as rosbags' encoder wants it, ``_unpacking`` what rosbags' decoder
        gave as in rclpy.
        """
        convert = self._converter(type_name, rule)
        return message if convert is None else convert(message)

    def maker(self, type_name: str) -> _Maker:
        """Return what makes a message as rclpy would construct it."""
        if type_name not in self._makers:
            definition = self._store.get_msgdef(type_name)
            defaults = _DECLARED_DEFAULTS.get(type_name, {})
            makers = [
                _constant(defaults[name]) if name in defaults else self._field_maker(field)
                for name, field in definition.fields
            ]
            message_class: Callable[..., Any] = definition.cls
            self._makers[type_name] = lambda: message_class(*[make() for make in makers])
        return self._makers[type_name]

    def _field_maker(self, field: FieldDesc) -> _Maker:
        if field[0] == Nodetype.BASE:
            return _constant(_zero(field[1][0]))
        if field[0] == Nodetype.NAME:
            return self.maker(field[1])
        if field[0] == Nodetype.SEQUENCE:
            return list
        element, length = field[1]
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            dtype = _dtype(element[1][0])
            return lambda: np.zeros(length, dtype)
        make = self._field_maker(element)
        return lambda: [make() for _ in range(length)]

    def _converter(self, type_name: str, rule: _LeafRule) -> _Converter | None:
        key = (type_name, rule)
        if key not in self._converters:
            fields = {
                name: convert
                for name, field in self._store.get_msgdef(type_name).fields
                if (convert := self._field_converter(field, rule)) is not None
            }
            self._converters[key] = _message_converter(fields) if fields else None
        return self._converters[key]

    def _field_converter(self, field: FieldDesc, rule: _LeafRule) -> _Converter | None:
        if field[0] == Nodetype.NAME:
            return self._converter(field[1], rule)
        if field[0] != Nodetype.BASE and field[1][0][0] == Nodetype.NAME:
            convert = self._converter(field[1][0][1], rule)
            return None if convert is None else _each(convert)
        return rule(field)


def _packing(field: FieldDesc) -> _Converter | None:
    if field[0] == Nodetype.BASE:
        return _integer_of_byte if field[1][0] == "byte" else None
    base = field[1][0][1][0]
    return None if base == "string" else _array_of(_dtype(str(base)))


def _unpacking(field: FieldDesc) -> _Converter | None:
    if field[0] == Nodetype.BASE and field[1][0] == "byte":
        return _byte_of_integer
    return None


def _constant(value: Any) -> _Maker:
    return lambda: value


def _zero(base: str) -> Any:
    if base == "byte":
        return b"\x00"
    return "" if base == "string" else _dtype(base).type(0).item()


def _dtype(base: str) -> np.dtype[Any]:
    return np.dtype("uint8" if base in ("byte", "char") else base)


# rosbags takes the byte of a .msg file for signed.
def _integer_of_byte(value: Any) -> int:
    number = ord(value) if isinstance(value, bytes | bytearray) else operator.index(value)
    return number - 256 if 128 <= number <= 255 else number


def _byte_of_integer(value: int) -> bytes:
    return bytes((value % 256,))


def _array_of(dtype: np.dtype[Any]) -> _Converter:
    def convert(values: Any) -> Any:
        if isinstance(values, bytes | bytearray):
            return np.frombuffer(values, dtype)
        return np.ascontiguousarray(values, dtype)

    return convert


def _each(convert: _Converter) -> _Converter:
    return lambda messages: [convert(message) for message in messages]


def _message_converter(fields: dict[str, _Converter]) -> _Converter:
    def convert(message: Any) -> Any:
        changed = None
        for name, convert_field in fields.items():
            value = getattr(message, name)
            converted = convert_field(value)
            if converted is not value:
                changed = changed or copy.copy(message)
                setattr(changed, name, converted)
        return changed or message

    return convert
