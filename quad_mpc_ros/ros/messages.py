# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages and quality of service for rclpy; message packages are imported on first use."""

from __future__ import annotations

import functools
import importlib
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import cdr, conversions
from quad_mpc_ros.messages.topics import IMU, ODOMETRY, REFERENCE, Topic


@functools.cache
def message_class(type_name: str) -> type[Any]:
    """Return the class of a message type such as ``nav_msgs/msg/Odometry``.

    Raises ``ModuleNotFoundError`` or ``AttributeError`` if the type is not installed.
    """
    package, kind, name = type_name.split("/")
    found: type[Any] = getattr(importlib.import_module(f"{package}.{kind}"), name)
    return found


def new_message(type_name: str) -> Any:
    """Return an empty message."""
    return message_class(type_name)()


def odometry_in(data: bytes) -> OdometrySample:
    """Return an odometry that was received raw.

    Raises ``ValueError`` for invalid bytes.
    """
    found = cdr.read_odometry(data)
    return found or conversions.odometry_from_message(message_in(ODOMETRY, data))


def imu_in(data: bytes) -> ImuSample:
    """Return the sample of an IMU message that was received raw.

    Raises ``ValueError`` for invalid bytes and for a message without acceleration.
    """
    return conversions.imu_from_message(message_in(IMU, data))


def reference_in(data: bytes) -> ReferenceWindow:
    """Return a reference that was received raw.

    Raises ``ValueError`` for invalid bytes and for a point without transform.
    """
    found = cdr.read_reference(data)
    return found or conversions.reference_from_message(message_in(REFERENCE, data))


def message_in(topic: Topic, data: bytes) -> Any:
    """Return the message of a topic that was received raw.

    Raises ``ValueError`` for invalid bytes.
    """
    try:
        return deserialize_message(data, message_class(topic.type_name))
    except Exception as error:  # rclpy raises various types
        raise ValueError(f"{topic.name}: not a valid {topic.type_name}: {error}") from error


def qos_of(topic: Topic) -> QoSProfile:
    """Return the QoS profile of a topic, for publishers and subscribers."""
    return qos_profile(depth=topic.depth, reliable=topic.reliable, latched=topic.latched)


def qos_profile(*, depth: int, reliable: bool, latched: bool) -> QoSProfile:
    """Return a QoS profile that keeps the last ``depth`` messages."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
