# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles published as markers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.extras.obstacles.frames import Frames, Pose
from quad_mpc_ros.extras.obstacles.surfaces import area, surface_points
from quad_mpc_ros.messages.obstacle_messages import (
    ADD,
    CUBE,
    CYLINDER,
    DELETE,
    DELETEALL,
    SPHERE,
    Marker,
)
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape, Sphere

NAMESPACE = "obstacles"
"""Namespace of markers made from shapes."""

_SUPPORTED_TYPES = {CUBE: "CUBE", SPHERE: "SPHERE", CYLINDER: "CYLINDER"}
_UNIT_TOLERANCE = 1e-3  # off the length of a quaternion
_MAX_SCALE = 1e5  # m
_MAX_AREA = 4000.0  # m^2

# s between two messages, to compute a speed.
_MIN_INTERVAL, _MAX_INTERVAL = 0.01, 1.0
_MIN_SPEED, _MAX_SPEED = 0.05, 30.0  # m/s: noise below, another object above
_PREDICTION_TIME = 1.0  # s: longest prediction of a motion


class MovingShape(NamedTuple):
    """A moving shape at its predicted position, its time of reception [ns], and its number."""

    shape: Shape
    received_ns: int
    number: int


class _TrackedMarker(NamedTuple):
    """A shape, points (n, 3) on it if it is at rest, times of reception and expiry [ns]."""

    number: int
    shape: Shape
    points: Array
    stamp_ns: int
    until_ns: float

    def body_at(self, stamp_ns: int) -> Shape:
        """Return the shape at its predicted position."""
        return self.shape.after(min(1e-9 * (stamp_ns - self.stamp_ns), _PREDICTION_TIME))


class Markers:
    """The current markers, by namespace and number.

    A marker that is received at another position moves: its position is predicted for a second
    with the speed between two messages, and then held until the next message or the expiry.
    """

    def __init__(self, frames: Frames, *, spacing: float) -> None:
        """Initialise with frames and the spacing of points on surfaces [m]."""
        self._frames, self._spacing = frames, spacing
        self._tracked: dict[tuple[str, int], _TrackedMarker] = {}
        self._count = 0
        self.revision = 0
        """A number that increases with changes of static markers."""

    def receive(self, markers: Sequence[Marker]) -> None:
        """Receive an array of markers.

        Unusable markers are skipped, then ``ValueError`` is raised with the first reason.
        """
        refused = None
        for marker in markers:
            try:
                self._receive(marker)
            except ValueError as error:
                refused = refused or error
        if refused is not None:
            raise refused

    def clear(self) -> None:
        """Remove all markers."""
        self._tracked.clear()
        self.revision += 1

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform all markers by an odometry jump."""
        for name, known in self._tracked.items():
            shape = known.shape
            shape = dataclasses.replace(
                shape,
                p_WO=reset.points(shape.p_WO),
                R_WO=reset.vectors(shape.R_WO.T).T,
                v_WO_W=reset.vectors(shape.v_WO_W),
            )
            self._tracked[name] = known._replace(shape=shape, points=reset.points(known.points))
        self.revision += 1

    def forget(self, now_ns: int) -> None:
        """Remove expired markers."""
        ended = [name for name, known in self._tracked.items() if known.until_ns < now_ns]
        for name in ended:
            del self._tracked[name]
        self.revision += len(ended)

    @property
    def static_points(self) -> list[Array]:
        """Points (n, 3) [m] on the surfaces of static markers."""
        return [known.points for known in self._tracked.values() if len(known.points)]

    def moving(self, stamp_ns: int) -> list[MovingShape]:
        """Return the moving shapes at their predicted positions at a time."""
        return [
            MovingShape(known.body_at(stamp_ns), known.stamp_ns, known.number)
            for known in self._tracked.values()
            if known.shape.moves
        ]

    def _receive(self, marker: Marker) -> None:
        if marker.action == DELETEALL:
            self.clear()
        elif marker.action == DELETE:
            self.revision += self._tracked.pop(marker.name, None) is not None
        elif marker.action == ADD:
            self._add(marker)
        else:
            raise ValueError(f"{_named(marker)} with the action {marker.action}, expected 0, 2, 3")

    def _add(self, marker: Marker) -> None:
        _check(marker)
        newest_ns = self._frames.newest_ns
        if newest_ns is None:
            raise ValueError(f"{_named(marker)} without odometry: its position is unknown")
        # No stamp means now, as in RViz.
        stamp_ns = marker.stamp_ns or newest_ns
        in_odometry = self._frames.pose(marker.frame_id, min(stamp_ns, newest_ns))
        placed = in_odometry @ Pose(marker.p, so3.rotation_from_quaternion_xyzw(marker.q_xyzw))
        until_ns = stamp_ns + marker.lifetime_ns if marker.lifetime_ns > 0 else math.inf
        shape = _shape(marker, placed)
        if area(shape) > _MAX_AREA:
            raise ValueError(
                f"{_named(marker)} with a surface of {area(shape):.0f} m^2, expected "
                f"{_MAX_AREA:.0f} m^2 at most"
            )
        shape = self._with_speed(shape, marker, stamp_ns)
        points = np.zeros((0, 3)) if shape.moves else surface_points(shape, self._spacing)
        before = self._tracked.get(marker.name)
        number = self._count if before is None else before.number
        self._count += before is None
        self._tracked[marker.name] = _TrackedMarker(number, shape, points, stamp_ns, until_ns)
        if before is None or not np.array_equal(before.points, points):
            self.revision += 1

    def _with_speed(self, shape: Shape, marker: Marker, stamp_ns: int) -> Shape:
        """Return the shape with its speed since the last message, for an unchanged object."""
        before = self._tracked.get(marker.name)
        if before is None or type(before.shape) is not type(shape):
            return shape
        seconds = 1e-9 * (stamp_ns - before.stamp_ns)
        if not seconds >= _MIN_INTERVAL:  # repeated message: keep the speed
            return dataclasses.replace(shape, v_WO_W=before.shape.v_WO_W)
        velocity = (shape.p_WO - before.shape.p_WO) / seconds
        speed = float(np.linalg.norm(velocity))
        if seconds > _MAX_INTERVAL or not _MIN_SPEED <= speed <= _MAX_SPEED:
            return shape
        return dataclasses.replace(shape, v_WO_W=velocity)


def shape_marker(shape: Shape | None, number: int, *, stamp_ns: int, frame_id: str) -> Marker:
    """Return the marker of a shape; without a shape, the deletion of the number."""
    kind, p, q_xyzw, scale = CUBE, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.ones(3)
    if shape is not None:
        kind = CUBE if isinstance(shape, Box) else SPHERE
        kind = CYLINDER if isinstance(shape, Cylinder) else kind
        q_xyzw = so3.quaternion_xyzw_from_rotation(shape.R_WO)
        p, scale = shape.p_WO, 2.0 * shape.half_extents
    return Marker(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        name=(NAMESPACE, number),
        kind=kind,
        action=DELETE if shape is None else ADD,
        p=p,
        q_xyzw=q_xyzw,
        scale=scale,
        lifetime_ns=0,
    )


def _named(marker: Marker) -> str:
    space, number = marker.name
    return f"marker '{space}' {number}"


def _check(marker: Marker) -> None:
    if marker.kind not in _SUPPORTED_TYPES:
        raise ValueError(
            f"{_named(marker)} of type {marker.kind}, expected one of "
            f"{', '.join(f'{name} ({kind})' for kind, name in _SUPPORTED_TYPES.items())}"
        )
    places = np.concatenate((marker.p, marker.q_xyzw))
    if not ((np.abs(places) <= FARTHEST).all() and (marker.scale <= _MAX_SCALE).all()):
        raise ValueError(
            f"{_named(marker)} with numbers that are not finite, beyond {FARTHEST:g} m, or with a "
            f"scale beyond {_MAX_SCALE:g} m"
        )
    if not (marker.scale > 0.0).all():
        raise ValueError(f"{_named(marker)} scale {marker.scale.tolist()}, expected 3 above 0")
    if not abs(float(np.linalg.norm(marker.q_xyzw)) - 1.0) < _UNIT_TOLERANCE:
        raise ValueError(f"{_named(marker)} whose orientation is not a unit quaternion")


def _shape(marker: Marker, placed: Pose) -> Shape:
    """Return the shape of a marker; round bounds of flattened spheres and cylinders."""
    x, y, z = marker.scale.tolist()
    if marker.kind == CUBE:
        return Box(p_WO=placed.p, R_WO=placed.R, size=marker.scale)
    if marker.kind == CYLINDER:
        return Cylinder(p_WO=placed.p, R_WO=placed.R, radius=0.5 * max(x, y), height=z)
    return Sphere(p_WO=placed.p, R_WO=placed.R, radius=0.5 * max(x, y, z))
