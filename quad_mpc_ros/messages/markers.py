# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A flight as ``visualization_msgs/Marker`` for viewers, and the parameters of the node.

No message package is imported, as in ``conversions``.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.configuration.box import BoxParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.vehicle import ARM, LiftParameters, Vehicle, outline
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.obstacle_messages import ADD, DELETE, Marker


@dataclass(frozen=True, kw_only=True)
class DrawnFence(BoxParameters):
    """The fence, drawn if all six walls are set."""

    owner = "visualisation.fence"


@dataclass(frozen=True, kw_only=True)
class VisualisationConfig(LiftParameters):
    """Parameters of the visualisation; mass and thrust curve turn throttle into thrust."""

    owner = "visualisation"

    publish_rate: float = parameter(
        25.0,
        doc="Largest publishing rate of markers and transforms.",
        unit="Hz",
        above=0.0,
        maximum=1000.0,
    )
    trail_duration: float = parameter(
        10.0, doc="Duration of the displayed flown path.", unit="s", minimum=0.0, maximum=3600.0
    )
    arm: float = parameter(
        ARM, doc="Distance from the centre of the drawn vehicle to a rotor.", unit="m", above=0.0
    )
    thrust_length: float = parameter(
        0.3, doc="Length of the thrust arrow at hover.", unit="m", above=0.0
    )
    gates: str = parameter("", doc="File of the gates to draw.")
    fence: DrawnFence = field(default_factory=DrawnFence)
    broadcast_tf: bool = parameter(
        True,
        doc="Broadcast the pose of the odometry on /tf, if tf2_msgs is installed; set false if "
        "an estimator broadcasts this transform.",
    )


class Trail:
    """Positions of the last ``duration`` [s], at least ``spacing`` [s] apart."""

    def __init__(self, *, duration: float, spacing: float) -> None:
        self._duration_ns, self._spacing_ns = round(duration * 1e9), round(spacing * 1e9)
        self._places: deque[tuple[int, Array]] = deque()

    def add(self, stamp_ns: int, p_WB: Array) -> None:
        """Take a position (3,) [m]; a stamp that goes backwards starts a new trail."""
        if self._places and stamp_ns < self._places[-1][0]:
            self._places.clear()
        if not self._places or stamp_ns - self._places[-1][0] >= self._spacing_ns:
            self._places.append((stamp_ns, p_WB))
        while stamp_ns - self._places[0][0] > self._duration_ns:
            self._places.popleft()

    @property
    def p_WB(self) -> Array:
        """Positions (n, 3) [m], the oldest first."""
        return np.array([p_WB for _, p_WB in self._places]).reshape(-1, 3)


# Of visualization_msgs/Marker.
ARROW, LINE_STRIP, LINE_LIST = 0, 4, 5

_SHORT_LIFETIME_NS = 500_000_000  # thrust and plan of a silent controller disappear
_NO_ROTATION = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Look:
    """A kind of line: namespace, line width [m], colour, and lifetime."""

    name: str
    kind: int
    scale: tuple[float, float, float]
    rgb: tuple[float, float, float]
    lifetime_ns: int = 0


_VEHICLE = Look(name="vehicle", kind=LINE_LIST, scale=(0.015, 0.0, 0.0), rgb=(0.2, 0.2, 0.2))
TRAIL = Look(name="trail", kind=LINE_STRIP, scale=(0.02, 0.0, 0.0), rgb=(0.0, 0.45, 0.7))
PREDICTED = Look(
    name="predicted path",
    kind=LINE_STRIP,
    scale=(0.02, 0.0, 0.0),
    rgb=(0.8, 0.47, 0.65),
    lifetime_ns=_SHORT_LIFETIME_NS,
)
_FENCE = Look(name="fence", kind=LINE_LIST, scale=(0.02, 0.0, 0.0), rgb=(0.84, 0.37, 0.0))
CORRIDOR = Look(
    name="corridor",
    kind=LINE_LIST,
    scale=(0.01, 0.0, 0.0),
    rgb=(0.0, 0.62, 0.45),
    lifetime_ns=_SHORT_LIFETIME_NS,
)
_GATES = Look(name="gates", kind=LINE_LIST, scale=(0.05, 0.0, 0.0), rgb=(0.9, 0.62, 0.0))
_THRUST = Look(
    name="thrust",
    kind=ARROW,
    scale=(0.02, 0.04, 0.06),
    rgb=(0.84, 0.37, 0.0),
    lifetime_ns=_SHORT_LIFETIME_NS,
)


def vehicle_marker(odometry: OdometrySample, *, arm: float, new: NewMessage) -> Any:
    """Return beams and rotors, ``arm`` [m] from the centre, at the pose of the vehicle."""
    beams, rotors = outline(arm)
    rims = np.stack((rotors, np.roll(rotors, -1, axis=1)), axis=2)
    points = np.vstack((beams.reshape(-1, 3), rims.reshape(-1, 3)))
    return line_marker(_VEHICLE, odometry, points, new=new, in_body=True)


def thrust_marker(
    odometry: OdometrySample, throttle: float, vehicle: Vehicle, *, length: float, new: NewMessage
) -> Any:
    """Return an arrow along body z, of ``length`` [m] if the thrust equals the weight."""
    weights = vehicle.thrust(throttle) / (vehicle.mass * vehicle.gravity)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, weights * length]])
    return line_marker(_THRUST, odometry, points, new=new, in_body=True)


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


def line_marker(
    look: Look, odometry: OdometrySample, points: Array, *, new: NewMessage, in_body: bool = False
) -> Any:
    """Return points (n, 3) [m] in the odometry frame or the body, as a line or lines.

    The points of a list are the ends of lines. Fewer than two points delete the marker.
    """
    is_line = len(points) > 1  # an empty one is an error to RViz
    marker = Marker(
        stamp_ns=odometry.stamp_ns,
        frame_id=odometry.frame_id,
        name=(look.name, 0),
        kind=look.kind,
        action=ADD if is_line else DELETE,
        p=odometry.p_WB if in_body else np.zeros(3),
        q_xyzw=odometry.q_WB_xyzw if in_body else _NO_ROTATION,
        scale=np.array(look.scale),
        lifetime_ns=look.lifetime_ns,
        points=points if is_line else points[:0],
    )
    return filled_marker(marker, rgb=look.rgb, alpha=1.0, new=new)
