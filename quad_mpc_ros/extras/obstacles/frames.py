# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Poses of message frames in the frame of the odometry, at their stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.messages.obstacle_messages import Transform

_POSE_HISTORY_NS = 2_000_000_000
_MAX_EXTRAPOLATION_NS = 100_000_000  # extrapolation of the last two poses
_MAX_CHAIN_LENGTH = 32
_UNIT_TOLERANCE = 1e-3  # of the length of a quaternion


class Pose(NamedTuple):
    """Position (3,) [m] and attitude (3, 3) of one frame in another."""

    p: Array
    R: Array

    def __matmul__(self, other: Any) -> Pose:
        """Return the composed pose: ``other`` is a pose in this frame."""
        return Pose(self.p + self.R @ other.p, self.R @ other.R)

    @property
    def inverse(self) -> Pose:
        """The inverse pose."""
        return Pose(-(self.R.T @ self.p), self.R.T)

    def applied(self, points: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return points (n, 3) [m] transformed by the pose, in their data type."""
        R, p = self.R.astype(points.dtype), self.p.astype(points.dtype)
        x, y, z = points.T
        # Written out: a matrix product of this shape starts threads, which take longer.
        rows = [R[i, 0] * x + R[i, 1] * y + (R[i, 2] * z + p[i]) for i in range(3)]
        return np.stack(rows).T


_IDENTITY = Pose(np.zeros(3), np.eye(3))


class Frames:
    """Poses of the body from odometry, and of other frames from transforms."""

    def __init__(self, frame_id: str) -> None:
        """Initialise with the name of the odometry's frame."""
        self._frame_id = frame_id
        self._poses: deque[OdometrySample] = deque()
        self._links: dict[str, Transform] = {}
        self._body = ""

    def receive_odometry(self, odometry: OdometrySample) -> None:
        """Receive an odometry; ignore invalid odometry; restart if the clock was set back."""
        if odometry_fault(odometry, frame_id=self._frame_id) is not None:
            return
        stamp_ns, poses = odometry.stamp_ns, self._poses
        if poses and not 0 < stamp_ns - poses[-1].stamp_ns < _POSE_HISTORY_NS:
            if stamp_ns == poses[-1].stamp_ns:
                return
            poses.clear()
        poses.append(odometry)
        while stamp_ns - poses[0].stamp_ns > _POSE_HISTORY_NS:
            poses.popleft()
        self._body = odometry.child_frame_id.lstrip("/")

    def receive_transform(self, transform: Transform) -> None:
        """Receive a transform. Raises ``ValueError`` for an invalid transform.

        The newest transform of each frame is used, because sensor mounts are static.
        """
        numbers = np.append(transform.p, transform.q_xyzw)
        near = (np.abs(numbers) <= FARTHEST).all()  # NaN compares with nothing
        unit = near and abs(float(np.linalg.norm(transform.q_xyzw)) - 1.0) < _UNIT_TOLERANCE
        if not unit or transform.child == transform.parent:
            raise ValueError(f"transform to '{transform.child}': not a rigid transform")
        self._links[transform.child] = transform

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest odometry [ns]."""
        return self._poses[-1].stamp_ns if self._poses else None

    def body_pose(self, stamp_ns: int) -> Pose:
        """Return the pose of the body at a stamp. Raises ``ValueError`` if unknown.

        The stamp is between two odometries, or shortly after the last.
        """
        poses = self._poses
        if not poses:
            raise ValueError("no odometry yet: the position is unknown")
        first, last = poses[0].stamp_ns, poses[-1].stamp_ns
        if stamp_ns < first:
            raise ValueError(f"stamp {1e-9 * (last - stamp_ns):.3f} s before the newest odometry")
        if stamp_ns - last > _MAX_EXTRAPOLATION_NS:
            raise ValueError(f"stamp {1e-9 * (stamp_ns - last):.3f} s after the newest odometry")
        stamps = [each.stamp_ns for each in poses]
        # Between two poses, or beyond the last two.
        place = min(int(np.searchsorted(stamps, stamp_ns, side="right")), len(poses) - 1)
        before, after = poses[max(place - 1, 0)], poses[place]
        R = so3.rotation_from_quaternion_xyzw(before.q_WB_xyzw)
        if before is after:
            return Pose(before.p_WB, R)
        share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
        R_after = so3.rotation_from_quaternion_xyzw(after.q_WB_xyzw)
        p = before.p_WB + share * (after.p_WB - before.p_WB)
        return Pose(p, R @ so3.exp(share * so3.log(R.T @ R_after)))

    def forget_poses(self) -> None:
        """Discard all poses of the body: the odometry frame has jumped."""
        self._poses.clear()

    def pose(self, frame_id: str, stamp_ns: int) -> Pose:
        """Return the pose of a frame in the odometry frame at a stamp.

        Raises:
            ValueError: The frame, or the body's pose at that time, is unknown.
        """
        links, body = self._links, self._body
        odometry = self._frame_id.lstrip("/")
        ours = dict(_chain(odometry, links, until=body))
        for above, pose in _chain(frame_id.lstrip("/"), links, until=body):
            if above in ours:
                return ours[above].inverse @ pose
            if above == body and body:
                return self.body_pose(stamp_ns) @ pose
        known = ", ".join(filter(None, [odometry, body, *sorted(links)]))
        raise ValueError(f"frame '{frame_id}', expected one of {known}, or tf to it")


def _chain(name: str, links: dict[str, Transform], *, until: str) -> Iterator[tuple[str, Pose]]:
    """Yield a frame and its ancestors, each with the pose of the first frame in it.

    The chain ends at the body, whose pose is the odometry's.
    """
    pose = _IDENTITY
    for _ in range(_MAX_CHAIN_LENGTH):
        yield name, pose
        link = links.get(name)
        if link is None or name == until:
            return
        step = Pose(link.p, so3.rotation_from_quaternion_xyzw(link.q_xyzw))
        pose, name = step @ pose, link.parent
