# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A recorded flight as arrays: odometry, reference, commands, statistics of control steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.reference_window import (
    PointRecord,
    packed,
    reference_points,
    sample_into,
)
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.target import reference_throttles
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.safety.window_validation import reference_fault
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.recordings.logs import Log, Stamps
from quad_mpc_ros.simulation.shapes import Scene

STATES = ("p_WB", "q_WB_xyzw", "v_WB_B", "w_WB_B")
"""Fields of an odometry with the state of the vehicle."""

_CLEARANCE_SAMPLES = 5  # two odometries, at which a clearance is taken
_GAP_PERIODS = 2.5  # of the odometry: less is jitter


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceTrack:
    """The active reference at each of n odometries.

    Shapes: ``p_WB`` [m], ``v_WB_B`` [m/s] and ``w_WB_B`` [rad/s] (n, 3), the last two in the body
    frame of the reference; ``R_WB`` (n, 3, 3); ``throttle`` (n,) that holds the reference.
    """

    p_WB: Array
    R_WB: Array
    v_WB_B: Array
    w_WB_B: Array
    throttle: Array

    def sampled(self, time: Array, at: Array) -> ReferenceTrack:
        """Return the track, given at times (n,) [s], interpolated at other times (m,) [s]."""
        values = {
            name: np.stack(
                [np.interp(at, time, column) for column in track.reshape(len(time), -1).T], axis=-1
            ).reshape(len(at), *track.shape[1:])
            for name, track in vars(self).items()
        }
        left, _, right = np.linalg.svd(values["R_WB"])  # the nearest rotation
        return ReferenceTrack(**{**values, "R_WB": left @ right})


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandTrack:
    """The m commands of a flight, by the stamp of the odometry they answer.

    Shapes: ``stamp_ns``, ``publish_time_ns`` and ``throttle`` (m,); ``w_WB_B`` (m, 3) [rad/s].
    """

    stamp_ns: Stamps
    publish_time_ns: Stamps
    throttle: Array
    w_WB_B: Array


class GatePoses(NamedTuple):
    """Published poses of the gates of a course: (n, 3) [m] and (n, 4), in the file's order."""

    publish_time_ns: int
    p_WG: Array
    q_WG_xyzw: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """A flight of n odometries, at least one. Everything is in order of stamps, each stamp once.

    Shapes: ``stamp_ns``, ``publish_time_ns`` (n,); ``p_WB`` [m], ``v_WB_B`` [m/s], ``w_WB_B``
    [rad/s] (n, 3); ``q_WB_xyzw`` (n, 4) with the recorded sign. ``reference`` is None if not
    recorded. ``stats`` are the figures of the k ticks of the controller, each (k,), with their
    names in :class:`TickStats`. ``parameters`` are the recorded parameters, by node; ``mpc`` are
    the controller's, with defaults for missing ones. ``scene`` are the obstacles, with times from
    the first odometry on; None if unknown. ``gates`` are the changed gate poses received in
    flight. ``rejected`` counts odometries that the controller rejects, by reason.
    """

    stamp_ns: Stamps
    publish_time_ns: Stamps
    p_WB: Array
    q_WB_xyzw: Array
    v_WB_B: Array
    w_WB_B: Array
    reference: ReferenceTrack | None
    commands: CommandTrack
    stats: Mapping[str, NDArray[Any]]
    parameters: Mapping[str, Mapping[str, Any]]
    mpc: MpcConfig
    scene: Scene | None = None
    gates: Sequence[GatePoses] = ()
    rejected: Mapping[str, int] = field(default_factory=dict)

    @property
    def time(self) -> Array:
        """Time of each odometry from the first one (n,) [s]."""
        return self.time_of(self.stamp_ns)

    @cached_property
    def followed(self) -> ReferenceTrack | None:
        """The reference delayed by ``progress_delay_s``, for the errors.

        Without formulation contouring this is ``reference``.
        """
        behind = self.stats.get("progress_delay_s", np.zeros(0))
        if self.reference is None or not behind.any():
            return self.reference
        time = self.time
        return self.reference.sampled(time, time - np.interp(time, self.tick_time, behind))

    @property
    def tick_time(self) -> Array:
        """Time of each tick of the controller from the first odometry (k,) [s]."""
        return self.time_of(np.asarray(self.stats["stamp_ns"], dtype=np.int64))

    @cached_property
    def clearance(self) -> Array | None:
        """Clearance to the nearest obstacle (n,) [m], None without obstacles.

        The minimum since the previous odometry; negative inside.
        """
        if self.scene is None or not self.scene.shapes:
            return None
        before = np.maximum(np.arange(len(self.time)) - 1, 0)
        least = np.full(len(self.time), np.inf)
        for share in np.linspace(0.0, 1.0, _CLEARANCE_SAMPLES, endpoint=False):
            p_WB = (1.0 - share) * self.p_WB + share * self.p_WB[before]
            time = (1.0 - share) * self.time + share * self.time[before]
            least = np.minimum(least, self.scene.clearances(p_WB, time))
        return np.asarray(least - self.mpc.radius)

    @property
    def odometry_period(self) -> float:
        """Median time between two odometries [s]; the control period for a single odometry."""
        if len(self.stamp_ns) < 2:
            return 1.0 / self.mpc.control_rate
        return float(np.median(np.diff(self.stamp_ns))) * 1e-9

    @cached_property
    def gaps(self) -> list[tuple[float, float]]:
        """Times [s] between successive odometries that are longer than ``odom_timeout``.

        The flight between these times was not recorded.
        """
        longest = max(self.mpc.odom_timeout, _GAP_PERIODS * self.odometry_period)
        begins = np.flatnonzero(np.diff(self.time) > longest)
        return [(float(self.time[i]), float(self.time[i + 1])) for i in begins]

    def broken(self, time: Array, *values: Array) -> tuple[Array, ...]:
        """Return times (n,) [s] and values (n, …) with NaN in the middle of each gap."""
        middles = np.mean(self.gaps, axis=1) if self.gaps else np.zeros(0)
        places = np.searchsorted(time, middles)
        broken = [np.insert(each.astype(np.float64), places, np.nan, axis=0) for each in values]
        return np.insert(time, places, middles), *broken

    def time_of(self, stamp_ns: Stamps) -> Array:
        """Return stamps as times from the first odometry [s]."""
        return np.asarray((stamp_ns - self.stamp_ns[0]) * 1e-9)


def flown_arrays(
    odometry: Log[OdometrySample], commands: Log[CommandSample], ticks: Log[TickStats]
) -> dict[str, Any]:
    """Return the odometry of a :class:`Flight`, and commands and ticks until its end."""
    stamp_ns, first = first_by_stamp(odometry.stamp_ns)
    end_ns = int(stamp_ns[-1])
    command_ns, sent = first_by_stamp(commands.stamp_ns, end_ns=end_ns)
    figures = ticks.columns()
    _, tick = first_by_stamp(figures["stamp_ns"], end_ns=end_ns)
    return {
        "stamp_ns": stamp_ns,
        "publish_time_ns": odometry.publish_time_ns[first],
        **{name: odometry.column(name)[first] for name in STATES},
        "commands": CommandTrack(
            stamp_ns=command_ns,
            publish_time_ns=commands.publish_time_ns[sent],
            throttle=commands.column("throttle")[sent],
            w_WB_B=commands.column("w_WB_B")[sent],
        ),
        "stats": {name: values[tick] for name, values in figures.items()},
    }


def first_by_stamp(
    stamps_ns: ArrayLike, *, end_ns: int | None = None
) -> tuple[Stamps, NDArray[np.intp]]:
    """Return the ascending stamps up to the end, and the first index of each."""
    stamp_ns, first = np.unique(np.asarray(stamps_ns, dtype=np.int64), return_index=True)
    count = len(stamp_ns) if end_ns is None else np.searchsorted(stamp_ns, end_ns, side="right")
    return stamp_ns[:count], first[:count]


class ReferenceSampler:
    """Samples the reference at the stamps of odometries, given its windows one by one.

    At each stamp the active window is the last window stamped no later; before the first window,
    the first window. The last of windows with equal stamps is used; a window stamped before an
    earlier window was resent and is omitted.
    """

    def __init__(self, stamp_ns: Stamps, vehicle: Vehicle) -> None:
        """Take the ascending stamps (n,) [ns], and the vehicle that flies the reference."""
        self._stamp_ns = stamp_ns
        self._vehicle = vehicle
        self._points = PointRecord.zeros(len(stamp_ns))
        self._newest: ReferenceWindow | None = None
        self._begin = 0  # the place from which the newest is in force

    def take(self, window: ReferenceWindow) -> None:
        """Use a window, unless the controller rejects it."""
        if reference_fault(window, frame_id=window.frame_id) is not None:
            return
        if self._newest is not None:
            if window.stamp_ns < self._newest.stamp_ns:
                return
            place = int(self._stamp_ns.searchsorted(window.stamp_ns))
            self._sample(self._newest, end=place)
        self._newest = window

    def track(self) -> ReferenceTrack | None:
        """Return the reference at all stamps; None without a window."""
        if self._newest is None:
            return None
        self._sample(self._newest, end=len(self._stamp_ns))
        points = reference_points(self._points)
        return ReferenceTrack(
            p_WB=points.p_WB,
            R_WB=points.R_WB,
            v_WB_B=points.v_WB_B,
            w_WB_B=points.w_WB_B,
            throttle=reference_throttles(points, self._vehicle),
        )

    def _sample(self, window: ReferenceWindow, *, end: int) -> None:
        """Sample a window up to an index, from which the next window is active."""
        points = PointRecord.zeros(end - self._begin)
        stamp_ns = self._stamp_ns[self._begin : end]
        sample_into(stamp_ns - window.stamp_ns, packed(window), points)
        self._points[self._begin : end] = points
        self._begin = end
