"""rclpy's message classes by type name, imported when first asked for."""

from __future__ import annotations

import functools
import importlib
import struct
from typing import Any

from rclpy.serialization import deserialize_message

from quad_mpc_ros.messages.topics import Topic


@functools.cache
def message_class(type_name: str) -> type[Any]:
    """Return the class of a type named like ``nav_msgs/msg/Odometry``.

    Raises ``ModuleNotFoundError`` or ``AttributeError`` when it is not installed.
    """
    package, kind, name = type_name.split("/")
    found: type[Any] = getattr(importlib.import_module(f"{package}.{kind}"), name)
    return found


def new_message(type_name: str) -> Any:
    """Return an empty message."""
    return message_class(type_name)()


def decoded(topic: Topic, data: bytes) -> Any:
    """Return the message of a topic that was received raw."""
    return deserialize_message(data, message_class(topic.type_name))


def stamp_of(data: bytes) -> int:
    """Return the stamp [ns] of a message received raw that begins with a header."""
    sec, nanosec = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)
