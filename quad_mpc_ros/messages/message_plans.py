"""What rosbags' messages lack beside those of rclpy: blank messages and lenient field values.

rosbags' message classes take every field at construction, its encoder accepts NumPy arrays only
where rclpy accepts any sequence, and it has integers where rclpy has ``bytes`` of length one.
"""

from __future__ import annotations

import copy
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.typesys.store import Typestore

Maker = Callable[[], Any]
Converter = Callable[[Any], Any]
LeafRule = Callable[[FieldDesc], Converter | None]

_DECLARED_DEFAULTS: dict[str, dict[str, Any]] = {
    "geometry_msgs/msg/Quaternion": {"w": 1.0},
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
}
"""Defaults other than zero in the .msg files of Jazzy: rosbags drops them when it parses."""


class MessagePlans:
    """Per message type of a type store: how to make one, and how to convert it.

    Every plan is worked out once, at the first message of its type.
    """

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._makers: dict[str, Maker] = {}
        self._converters: dict[tuple[str, LeafRule], Converter | None] = {}

    def blank(self, type_name: str) -> Any:
        """Return a message as rclpy would construct it."""
        return self._maker(type_name)()

    def packed(self, type_name: str, message: Any) -> Any:
        """Return ``message`` with every value as rosbags' encoder wants it.

        Copies what has to change; ``message`` itself is left alone.
        """
        convert = self._converter(type_name, _packing)
        return message if convert is None else convert(message)

    def unpacked(self, type_name: str, message: Any) -> Any:
        """Return ``message``, fresh from rosbags' decoder, with every value as in rclpy."""
        convert = self._converter(type_name, _unpacking)
        return message if convert is None else convert(message)

    def _maker(self, type_name: str) -> Maker:
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

    def _field_maker(self, field: FieldDesc) -> Maker:
        if field[0] == Nodetype.BASE:
            return _constant(_zero(field[1][0]))
        if field[0] == Nodetype.NAME:
            return self._maker(field[1])
        if field[0] == Nodetype.SEQUENCE:
            return list
        element, length = field[1]
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            dtype = _dtype(element[1][0])
            return lambda: np.zeros(length, dtype)
        make = self._field_maker(element)
        return lambda: [make() for _ in range(length)]

    def _converter(self, type_name: str, rule: LeafRule) -> Converter | None:
        key = (type_name, rule)
        if key not in self._converters:
            fields = {
                name: convert
                for name, field in self._store.get_msgdef(type_name).fields
                if (convert := self._field_converter(field, rule)) is not None
            }
            self._converters[key] = _message_converter(fields) if fields else None
        return self._converters[key]

    def _field_converter(self, field: FieldDesc, rule: LeafRule) -> Converter | None:
        if field[0] == Nodetype.NAME:
            return self._converter(field[1], rule)
        if field[0] != Nodetype.BASE and field[1][0][0] == Nodetype.NAME:
            convert = self._converter(field[1][0][1], rule)
            return None if convert is None else _each(convert)
        return rule(field)


def _packing(field: FieldDesc) -> Converter | None:
    if field[0] == Nodetype.BASE:
        return _integer_of_byte if field[1][0] == "byte" else None
    base = field[1][0][1][0]
    return None if base == "string" else _array_of(_dtype(str(base)))


def _unpacking(field: FieldDesc) -> Converter | None:
    if field[0] == Nodetype.BASE and field[1][0] == "byte":
        return _byte_of_integer
    return None


def _constant(value: Any) -> Maker:
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


def _array_of(dtype: np.dtype[Any]) -> Converter:
    def convert(values: Any) -> Any:
        if isinstance(values, bytes | bytearray):
            return np.frombuffer(values, dtype)
        return np.ascontiguousarray(values, dtype)

    return convert


def _each(convert: Converter) -> Converter:
    return lambda messages: [convert(message) for message in messages]


def _message_converter(fields: dict[str, Converter]) -> Converter:
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
