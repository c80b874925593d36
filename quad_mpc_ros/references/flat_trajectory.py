# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A path with attitude and body rates by differential flatness: a trajectory."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.vehicle import VehicleParameters
from quad_mpc_ros.references.flatness import FlatInputs, ThrustFrames, flat_inputs, thrust_axis
from quad_mpc_ros.references.path import Path, PathSamples
from quad_mpc_ros.references.trajectory import TrajectorySamples, at_rest, combined, resting

# Between knots the attitude comes from the path itself; at 20 rad/s they are 0.04 rad apart.
_KNOT_STEP = 0.002  # s
_LEAST_KNOTS, _MOST_KNOTS = 1000, 20_000
_AT_REST = 1e-6
_FRAME_ROUNDS = 3


class FlatTrajectory:
    """A path, flown with the nose at ``yaw`` while level.

    A thrust above the horizon uses one chart of the Hopf fibration, otherwise rotation-minimising
    frames are used. Before the start the trajectory rests at its first position, level; if not
    periodic, it rests after its end with the last heading.
    """

    smooth = True
    fixed = True

    def __init__(self, path: Path, vehicle: VehicleParameters, *, yaw: float = 0.0) -> None:
        """Prepare the frames for a vehicle; raises ``ValueError`` with the time of free fall."""
        self._path, self._vehicle, self._yaw = path, vehicle, yaw
        self._frames = self._prepared_frames()
        start = path.at(np.zeros(1))
        self._heading = yaw + float(np.ravel(start.yaw)[0])
        self._starts_in_motion = bool(
            max(np.abs(start.v_WB_W).max(), np.abs(start.a_WB_W).max()) > _AT_REST
        )

    @property
    def period_ns(self) -> int:
        """The path's duration, or its period."""
        return round(1e9 * self._path.duration)

    @property
    def upright(self) -> bool:
        """Whether the thrust stays above the horizon, so that yaw is defined throughout."""
        return self._frames is None

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the samples at these times."""
        seconds = 1e-9 * np.array(times_ns, dtype=np.float64)
        end = np.inf if self._path.periodic else self._path.duration
        moving = self._moving(np.clip(seconds, 0.0, end))
        before, after = seconds < 0.0, seconds >= end
        if not (before.any() or after.any()):
            return moving
        parts = at_rest(moving.p_WB, yaw=self._heading), resting(moving), moving
        when = [before[:, None], after[:, None]]
        return combined(lambda *parts: np.select(when, parts[:2], parts[2]), *parts)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the start if it is in (start, end] and leads from rest into motion."""
        return [0] if self._starts_in_motion and start_ns < 0 <= end_ns else []

    def _moving(self, seconds: Array) -> TrajectorySamples:
        path = self._path.at(seconds)
        chart = None if self._frames is None else self._frames.at(seconds)
        inputs = self._flat_inputs(path, chart)
        return TrajectorySamples(
            p_WB=path.p_WB,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(inputs.R_WB),
            v_WB_W=path.v_WB_W,
            a_WB_W=path.a_WB_W,
            w_WB_W=np.einsum("nij,nj->ni", inputs.R_WB, inputs.w_WB_B),
        )

    def _flat_inputs(self, path: PathSamples, chart: Array | None) -> FlatInputs:
        return flat_inputs(
            v_WB_W=path.v_WB_W,
            a_WB_W=path.a_WB_W,
            j_WB_W=path.j_WB_W,
            yaw=self._yaw + np.asarray(path.yaw),
            yaw_rate=path.yaw_rate,
            gravity=self._vehicle.gravity,
            drag=self._vehicle.drag,
            rotor_drag=self._vehicle.rotor_drag,
            chart=chart,
        )

    def _prepared_frames(self) -> ThrustFrames | None:
        """Return the frames of a path flown upside down; raises like :func:`thrust_axis`."""
        duration = self._path.duration
        steps = np.clip(np.ceil(duration / _KNOT_STEP), _LEAST_KNOTS, _MOST_KNOTS)
        knots = np.linspace(0.0, duration, int(steps) + 1)
        # The drag at the speed of hover: the charts need not be exact.
        rotors = per_axis(self._vehicle.rotor_drag)
        total = np.add(per_axis(self._vehicle.drag), rotors)
        x_drag, y_drag = float(total[0]), float(total[1])
        depends_on_frame = x_drag != y_drag or any(rotors)
        with np.errstate(over="ignore", invalid="ignore"):
            path = self._path.at(knots)
            z, _, _ = thrust_axis(
                v_WB_W=path.v_WB_W,
                a_WB_W=path.a_WB_W,
                j_WB_W=path.j_WB_W,
                gravity=self._vehicle.gravity,
                drag=0.5 * (x_drag + y_drag),
                seconds=knots,
            )
        if self._path.periodic or z[:, 2].min() >= 0.0:
            return None
        frames = ThrustFrames(knots, z)
        for _ in range(_FRAME_ROUNDS if depends_on_frame else 0):
            # The thrust's direction depends on the frame then, a little.
            frames = ThrustFrames(knots, self._flat_inputs(path, frames.at(knots)).R_WB[..., 2])
        return frames
