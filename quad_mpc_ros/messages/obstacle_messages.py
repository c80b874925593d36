# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages about obstacles other than clouds: markers, plans and transforms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.messages.conversions import (
    nanoseconds,
    positions_from_path,
    quaternion,
    vector,
)

# Of visualization_msgs/Marker.
CUBE, SPHERE, CYLINDER = 1, 2, 3
ADD, DELETE, DELETEALL = 0, 2, 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Marker:
    """The used fields of a ``visualization_msgs/Marker``, unchecked.

    ``p`` (3,) [m] and ``q_xyzw`` (4,) are the marker's pose in ``frame_id``, ``scale`` (3,) [m] is
    its size, ``points`` (n, 3) [m] are points of drawn lines. ``lifetime_ns`` is 0 for a permanent
    marker.
    """

    stamp_ns: int
    frame_id: str
    name: tuple[str, int]
    kind: int
    action: int
    p: Array
    q_xyzw: Array
    scale: Array
    lifetime_ns: int
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Transform:
    """A ``geometry_msgs/TransformStamped``: the child's pose in its parent, unchecked."""

    stamp_ns: int
    parent: str
    child: str
    p: Array
    q_xyzw: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TimedPath:
    """A ``nav_msgs/Path``: positions ``p`` (n, 3) [m] in ``frame_id`` at times (n,) [ns]."""

    stamp_ns: int
    frame_id: str
    times_ns: NDArray[np.int64]
    p: Array


def markers_from_message(message: Any) -> list[Marker]:
    """Return the markers of a ``visualization_msgs/MarkerArray``."""
    return [
        Marker(
            stamp_ns=nanoseconds(each.header.stamp),
            frame_id=each.header.frame_id,
            name=(each.ns, each.id),
            kind=each.type,
            action=each.action,
            p=vector(each.pose.position),
            q_xyzw=quaternion(each.pose.orientation),
            scale=vector(each.scale),
            lifetime_ns=nanoseconds(each.lifetime),
        )
        for each in message.markers
    ]


def path_from_message(message: Any) -> TimedPath:
    """Return a ``nav_msgs/Path`` with a stamp for each pose."""
    return TimedPath(
        stamp_ns=nanoseconds(message.header.stamp),
        frame_id=message.header.frame_id,
        times_ns=np.array([nanoseconds(p.header.stamp) for p in message.poses], dtype=np.int64),
        p=positions_from_path(message),
    )


def transforms_from_message(message: Any) -> list[Transform]:
    """Return the transforms of a ``tf2_msgs/TFMessage``."""
    return [
        Transform(
            stamp_ns=nanoseconds(each.header.stamp),
            parent=each.header.frame_id.lstrip("/"),
            child=each.child_frame_id.lstrip("/"),
            p=vector(each.transform.translation),
            q_xyzw=quaternion(each.transform.rotation),
        )
        for each in message.transforms
    ]
