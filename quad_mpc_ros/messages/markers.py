# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Surroundings of a flight as ``visualization_msgs/Marker``, and the parameters of the node.

No message package is imported, as in ``conversions``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.configuration.box import BoxParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.obstacle_messages import ADD, DELETE, Marker


@dataclass(frozen=True, kw_only=True)
class DrawnFence(BoxParameters):
    """The fence, drawn if all six walls are set."""

    owner = "visualisation.fence"


@dataclass(frozen=True, kw_only=True)
class VisualisationConfig(Configuration):
    """Parameters of the visualisation."""

    owner = "visualisation"

    publish_rate: float = parameter(
        25.0,
        doc="Largest publishing rate of markers and transforms.",
        unit="Hz",
        above=0.0,
        maximum=1000.0,
    )
    gates: str = parameter("", doc="File of the gates to draw.")
    fence: DrawnFence = field(default_factory=DrawnFence)
    broadcast_tf: bool = parameter(
        True,
        doc="Broadcast the pose of the odometry on /tf, if tf2_msgs is installed; set false if "
        "an estimator broadcasts this transform.",
    )


# Of visualization_msgs/Marker.
LINE_LIST = 5

_SHORT_LIFETIME_NS = 500_000_000  # the corridor of a silent controller disappears


@dataclass(frozen=True, kw_only=True)
class Look:
    """A kind of lines: namespace, line width [m], colour, and lifetime."""

    name: str
    width: float
    rgb: tuple[float, float, float]
    lifetime_ns: int = 0


_FENCE = Look(name="fence", width=0.02, rgb=(0.84, 0.37, 0.0))
CORRIDOR = Look(name="corridor", width=0.01, rgb=(0.0, 0.62, 0.45), lifetime_ns=_SHORT_LIFETIME_NS)
_GATES = Look(name="gates", width=0.05, rgb=(0.9, 0.62, 0.0))


def fence_marker(odometry: OdometrySample, fence: BoxParameters, *, new: NewMessage) -> Any:
    """Return the twelve edges of the fence."""
    ends = [fence.minimum, fence.maximum]
    corners = np.array([[ends[i][0], ends[j][1], ends[k][2]] for i, j, k in np.ndindex(2, 2, 2)])
    edges = [
        (corners[a], corners[b])
        for a, b in itertools.combinations(range(8), 2)
        if (a ^ b).bit_count() == 1
    ]
    return line_marker(_FENCE, odometry, np.array(edges).reshape(-1, 3), new=new)


def filled_marker(
    marker: Marker,
    *,
    new: NewMessage,
    rgb: tuple[float, float, float] = (0.84, 0.37, 0.0),
    alpha: float = 0.6,
) -> Any:
    """Return a marker as a message; obstacles are orange and translucent."""
    message = new("visualization_msgs/msg/Marker")
    conversions.fill_header(message.header, marker.stamp_ns, marker.frame_id)
    message.ns, message.id = marker.name
    message.type, message.action = marker.kind, marker.action
    conversions.fill_vector(message.pose.position, marker.p.tolist())
    conversions.fill_quaternion(message.pose.orientation, marker.q_xyzw.tolist())
    conversions.fill_vector(message.scale, marker.scale.tolist())
    message.color.r, message.color.g, message.color.b = rgb
    message.color.a = alpha
    conversions.fill_time(message.lifetime, marker.lifetime_ns)
    message.points = [new("geometry_msgs/msg/Point") for _ in marker.points]
    for point, values in zip(message.points, marker.points.tolist(), strict=True):
        conversions.fill_vector(point, values)
    return message


def gates_marker(odometry: OdometrySample, outlines: Sequence[Array], *, new: NewMessage) -> Any:
    """Return the outlines of gates as points (n, 3) [m]."""
    edges = [np.stack((points[:-1], points[1:]), axis=1) for points in outlines]
    return line_marker(_GATES, odometry, np.vstack(edges).reshape(-1, 3), new=new)


def line_marker(look: Look, odometry: OdometrySample, points: Array, *, new: NewMessage) -> Any:
    """Return lines between each two of points (n, 3) [m] in the odometry frame.

    Fewer than two points delete the marker.
    """
    is_line = len(points) > 1  # an empty one is an error to RViz
    marker = Marker(
        stamp_ns=odometry.stamp_ns,
        frame_id=odometry.frame_id,
        name=(look.name, 0),
        kind=LINE_LIST,
        action=ADD if is_line else DELETE,
        p=np.zeros(3),
        q_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        scale=np.array([look.width, 0.0, 0.0]),
        lifetime_ns=look.lifetime_ns,
        points=points if is_line else points[:0],
    )
    return filled_marker(marker, rgb=look.rgb, alpha=1.0, new=new)
