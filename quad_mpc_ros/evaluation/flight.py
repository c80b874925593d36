"""A recorded flight as arrays: what was flown, what was asked for, what was commanded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.lie import Array
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, REFERENCE, STATS
from quad_mpc_ros.model.reference_window import sample
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.model.state import with_body_twist
from quad_mpc_ros.model.vehicle import Vehicle
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.paper import reference_input
from quad_mpc_ros.recordings.parameters import read_parameters, recorded_parameters
from quad_mpc_ros.recordings.reader import BagReader, RecordedMessage
from quad_mpc_ros.recordings.recorded_stats import recorded_stats
from quad_mpc_ros.recordings.recorded_topics import messages_by_topic
from quad_mpc_ros.safety.validation import odometry_fault, reference_fault

Stamps = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceTrack:
    """The reference in force at each of n odometries.

    Shapes: ``p_WB`` [m], ``v_WB_B`` [m/s] and ``w_WB_B`` [rad/s] (n, 3), the last two in the body
    frame of the reference; ``R_WB`` (n, 3, 3); ``throttle`` (n,), which holds the reference.
    """

    p_WB: Array
    R_WB: Array
    v_WB_B: Array
    w_WB_B: Array
    throttle: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandTrack:
    """The m commands of a flight, by the stamp of the odometry they answer.

    Shapes: ``stamp_ns``, ``publish_time_ns`` and ``throttle`` (m,); ``w_WB_B`` (m, 3) [rad/s].
    """

    stamp_ns: Stamps
    publish_time_ns: Stamps
    throttle: Array
    w_WB_B: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """A flight of n odometries, at least one. Everything is in order of stamps, each stamp once.

    Shapes: ``stamp_ns``, ``publish_time_ns`` (n,); ``p_WB`` [m], ``v_WB_B`` [m/s], ``w_WB_B``
    [rad/s] (n, 3); ``q_WB_xyzw`` (n, 4) with the sign that was recorded. ``reference`` is None
    when none was recorded. ``stats`` are the figures of the k ticks of the controller, each (k,),
    by their name in :class:`TickStats`. ``parameters`` are those recorded, by node; ``mpc`` are
    those of the controller, defaults where they were not recorded.
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

    @property
    def time(self) -> Array:
        """Time of each odometry from the first one (n,) [s]."""
        return self.time_of(self.stamp_ns)

    @property
    def tick_time(self) -> Array:
        """Time of each tick of the controller from the first odometry (k,) [s]."""
        return self.time_of(np.asarray(self.stats["stamp_ns"], dtype=np.int64))

    @property
    def odometry_period(self) -> float:
        """Usual time between two odometries [s]; that of the control for a single one."""
        if len(self.stamp_ns) < 2:
            return 1.0 / self.mpc.control_rate
        return float(np.median(np.diff(self.stamp_ns))) * 1e-9

    def time_of(self, stamp_ns: Stamps) -> Array:
        """Return stamps as times from the first odometry [s]."""
        return np.asarray((stamp_ns - self.stamp_ns[0]) * 1e-9)


def read_flight(bag: Path) -> Flight:
    """Read the flight of one vehicle from a bag, under whatever namespace it was recorded.

    It ends with the last usable odometry: what is stamped later is left out, as the watchdog of
    the controller rightly acts when a simulator has ended. Odometry and references that the
    controller refuses (not finite, no unit quaternion) are left out too, and of messages that
    were sent again, as in lockstep, the first one counts.

    Raises :class:`BagError` for a bag that cannot be read, that has no usable odometry or that
    has one of our topics twice, and ``ConfigurationError`` for unusable recorded parameters.
    """
    recorded = messages_by_topic(bag, (ODOMETRY, REFERENCE, COMMAND, STATS))
    parameters = read_parameters(BagReader(bag).metadata)
    mpc = MpcConfig.build(recorded_parameters(parameters, MpcConfig))
    odometry = _odometry(recorded[ODOMETRY], twist_frame=mpc.odometry.twist_frame)
    if len(odometry["stamp_ns"]) == 0:
        raise BagError(
            f"{bag}: no flight in it: expected usable {ODOMETRY.type_name} messages on a topic "
            f"that ends in /{ODOMETRY.name}"
        )
    stamp_ns = odometry["stamp_ns"]
    return Flight(
        **odometry,
        reference=_reference(recorded[REFERENCE], stamp_ns, mpc.vehicle()),
        commands=_commands(recorded[COMMAND], end_ns=stamp_ns[-1]),
        stats=_stats(bag, recorded[STATS], end_ns=stamp_ns[-1]),
        parameters=parameters,
        mpc=mpc,
    )


def _odometry(messages: Sequence[RecordedMessage], *, twist_frame: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of :class:`Flight` that come from odometry, the twist in body axes."""
    usable = [
        (odometry, message.publish_time_ns)
        for message in messages
        for odometry in [conversions.odometry_from_message(message.message)]
        if odometry_fault(odometry, frame_id=odometry.frame_id) is None
    ]
    samples = [odometry for odometry, _ in usable]
    if twist_frame == "world":
        samples = [with_body_twist(odometry) for odometry in samples]
    stamp_ns, first = _by_stamp([odometry.stamp_ns for odometry in samples])
    return {
        "stamp_ns": stamp_ns,
        "publish_time_ns": _integers([time_ns for _, time_ns in usable])[first],
        "p_WB": _rows([odometry.p_WB for odometry in samples], 3)[first],
        "q_WB_xyzw": _rows([odometry.q_WB_xyzw for odometry in samples], 4)[first],
        "v_WB_B": _rows([odometry.v_WB_B for odometry in samples], 3)[first],
        "w_WB_B": _rows([odometry.w_WB_B for odometry in samples], 3)[first],
    }


def _reference(
    messages: Sequence[RecordedMessage], stamp_ns: Stamps, vehicle: Vehicle
) -> ReferenceTrack | None:
    """Sample at each stamp the window in force there: the last one stamped no later.

    Before the first window it is the first one.
    """
    windows = sorted(_usable_windows(messages), key=lambda window: window.stamp_ns)
    if not windows:
        return None
    starts = [window.stamp_ns for window in windows]
    in_force = np.maximum(np.searchsorted(starts, stamp_ns, side="right") - 1, 0)
    points = [
        sample(windows[number], stamp) for number, stamp in zip(in_force, stamp_ns, strict=True)
    ]
    return ReferenceTrack(
        p_WB=np.array([point.p_WB for point in points]),
        R_WB=np.array([point.R_WB for point in points]),
        v_WB_B=np.array([point.v_WB_B for point in points]),
        w_WB_B=np.array([point.w_WB_B for point in points]),
        throttle=np.array([reference_input(point, vehicle).throttle for point in points]),
    )


def _usable_windows(messages: Sequence[RecordedMessage]) -> list[ReferenceWindow]:
    windows = []
    for message in messages:
        try:
            window = conversions.reference_from_message(message.message)
        except ValueError:
            continue
        if reference_fault(window, frame_id=window.frame_id) is None:
            windows.append(window)
    return windows


def _commands(messages: Sequence[RecordedMessage], *, end_ns: int) -> CommandTrack:
    commands = [conversions.command_from_message(message.message) for message in messages]
    stamp_ns, first = _by_stamp([command.stamp_ns for command in commands], end_ns=end_ns)
    return CommandTrack(
        stamp_ns=stamp_ns,
        publish_time_ns=_integers([message.publish_time_ns for message in messages])[first],
        throttle=np.array([command.throttle for command in commands], dtype=np.float64)[first],
        w_WB_B=_rows([command.w_WB_B for command in commands], 3)[first],
    )


def _stats(
    bag: Path, messages: Sequence[RecordedMessage], *, end_ns: int
) -> dict[str, NDArray[Any]]:
    """Return every figure of :class:`TickStats` as an array of its type."""
    ticks = recorded_stats(bag, messages)
    figures = {
        name: np.array([getattr(tick, name) for tick in ticks], dtype=_DTYPES[kind])
        for name, kind in get_type_hints(TickStats).items()
    }
    _, first = _by_stamp(figures["stamp_ns"], end_ns=end_ns)
    return {name: values[first] for name, values in figures.items()}


_DTYPES: dict[type, Any] = {int: np.int64, float: np.float64, str: np.str_}


def _by_stamp(
    stamps_ns: ArrayLike, *, end_ns: int | None = None
) -> tuple[Stamps, NDArray[np.intp]]:
    """Return the stamps up to the end, ascending, and where each first occurs."""
    stamp_ns, first = np.unique(np.asarray(stamps_ns, dtype=np.int64), return_index=True)
    count = len(stamp_ns) if end_ns is None else np.searchsorted(stamp_ns, end_ns, side="right")
    return stamp_ns[:count], first[:count]


def _integers(values: Sequence[int]) -> Stamps:
    return np.array(values, dtype=np.int64)


def _rows(vectors: Sequence[Array], width: int) -> Array:
    """Stack vectors, none included, to (n, width)."""
    return np.array(vectors, dtype=np.float64).reshape(-1, width)
