"""What a world of obstacles hears beside clouds: markers, plans and transforms, from bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.messages.cdr_reader import CdrReader

# Of visualization_msgs/Marker.
CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST = 1, 2, 3, 6, 7
ADD, DELETE, DELETEALL = 0, 2, 3

_LEAST_MARKER, _LEAST_POSE, _LEAST_TRANSFORM = 180, 72, 76  # bytes
_POINT, _COLOUR, _UV = 24, 16, 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Marker:
    """What counts of a ``visualization_msgs/Marker``, unchecked.

    ``p`` (3,) [m] and ``q_xyzw`` (4,) are its pose in ``frame_id``, ``scale`` (3,) [m] its size,
    ``points`` (n, 3) [m] the elements of a list in the frame of the pose. ``lifetime_ns`` is 0 for
    one that stays.
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
    points: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TimedPath:
    """A ``nav_msgs/Path``: positions ``p`` (n, 3) [m] in ``frame_id`` at times (n,) [ns]."""

    stamp_ns: int
    frame_id: str
    times_ns: NDArray[np.int64]
    p: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Transform:
    """A ``geometry_msgs/TransformStamped``: the child's pose in its parent, unchecked."""

    stamp_ns: int
    parent: str
    child: str
    p: Array
    q_xyzw: Array


def read_markers(data: bytes) -> list[Marker]:
    """Return the markers of a ``visualization_msgs/MarkerArray``; ``ValueError`` if it is none."""
    reader = CdrReader(data)
    return [_marker(reader) for _ in range(reader.length(least=_LEAST_MARKER))]


def read_path(data: bytes) -> TimedPath:
    """Return a ``nav_msgs/Path`` that is stamped pose by pose; ``ValueError`` if it is none."""
    reader = CdrReader(data)
    stamp_ns, frame_id = reader.header()
    times_ns, rows = [], []
    for _ in range(reader.length(least=_LEAST_POSE)):
        at_ns, _ = reader.header()
        times_ns.append(at_ns)
        rows.append(reader.array("f8", 7)[:3])
    p = np.array(rows).reshape(-1, 3)
    times = np.array(times_ns, dtype=np.int64)
    return TimedPath(stamp_ns=stamp_ns, frame_id=frame_id, times_ns=times, p=p)


def read_transforms(data: bytes) -> list[Transform]:
    """Return what a ``tf2_msgs/TFMessage`` holds; ``ValueError`` if it is none."""
    reader = CdrReader(data)
    return [_transform(reader) for _ in range(reader.length(least=_LEAST_TRANSFORM))]


def _transform(reader: CdrReader) -> Transform:
    stamp_ns, parent = reader.header()
    child, numbers = reader.text(), reader.array("f8", 7)
    return Transform(
        stamp_ns=stamp_ns,
        parent=parent.lstrip("/"),
        child=child.lstrip("/"),
        p=numbers[:3],
        q_xyzw=numbers[3:],
    )


def _marker(reader: CdrReader) -> Marker:
    """Read all of a marker, of which colours, textures, text and meshes are left out."""
    stamp_ns, frame_id = reader.header()
    space = reader.text()
    number, kind, action = (reader.whole("i") for _ in range(3))
    numbers = reader.array("f8", 10)
    reader.skip(_COLOUR, align=4)
    lifetime_ns = reader.time_ns()
    reader.skip(1)  # whether it is locked to its frame
    points = reader.array("f8", 3 * reader.length(least=_POINT)).reshape(-1, 3)
    reader.skip(_COLOUR * reader.length(least=_COLOUR), align=4)
    reader.text()  # a texture, its image and where it lies
    reader.header()
    reader.text()
    reader.octets()
    reader.skip(_UV * reader.length(least=_UV), align=4)
    reader.text()  # its own text
    reader.text()  # a mesh and its file
    reader.text()
    reader.octets()
    reader.skip(1)
    return Marker(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        name=(space, number),
        kind=kind,
        action=action,
        p=numbers[:3],
        q_xyzw=numbers[3:7],
        scale=numbers[7:],
        lifetime_ns=lifetime_ns,
        points=points,
    )
