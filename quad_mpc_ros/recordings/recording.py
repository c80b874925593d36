# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The recording of one vehicle: opens a bag once and converts its messages to values."""

from __future__ import annotations

import contextlib
import dataclasses
import operator
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import BagError, Configuration, UserError, files, optional_part
from quad_mpc_ros.configuration.arguments import instance
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.control.model.state import with_body_twist
from quad_mpc_ros.control.safety.odometry_gate import NOT_ADVANCING
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import (
    BATTERY,
    COMMAND,
    ENGAGED,
    GATES,
    IMU,
    LANDED,
    ODOMETRY,
    ODOMETRY_RESET,
    PARAMETER_EVENTS,
    RECORDED_COMMAND,
    REFERENCE,
    STATS,
    Topic,
)
from quad_mpc_ros.recordings.flight import Flight, GatePoses, ReferenceSampler, flown_arrays
from quad_mpc_ros.recordings.logs import Log, Received, Stamps, T, tick_stats
from quad_mpc_ros.recordings.parameters import read_parameters, recorded_parameters
from quad_mpc_ros.recordings.reader import CDR, BagReader, RecordedMessage, encoding_error
from quad_mpc_ros.recordings.run import RecordedRun
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.shapes import Scene

Taker = Callable[[RecordedMessage], None]

VOLTAGE_FIELDS = {
    BATTERY.type_name: "voltage",
    "crazyflie_interfaces/msg/Status": "battery_voltage",
    "px4_msgs/msg/BatteryStatus": "voltage_v",
    "rosflight_msgs/msg/BatteryStatus": "voltage",
}
"""Message types with a battery's voltage [V], and its field."""
SCENE_NAME = "obstacles.yaml"
"""Name of the obstacle file in the folder of a run."""

_MAX_LISTED = 12
_RUN_TOPICS = (
    *(REFERENCE, COMMAND, ENGAGED, LANDED, ODOMETRY_RESET, STATS),
    *(IMU, PARAMETER_EVENTS),
)


class Recording:
    """A recorded run of one vehicle, in any namespace.

    Opening reads the index. :meth:`flight` and :meth:`run` stream the messages, and keep only the
    values of this package. Every failure is a :class:`BagError` that names the bag.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a bag directory, one ``.mcap`` file, or the folder of a run with ``bag/`` in it."""
        instance(path, "path", str, Path)
        self.bag = BagReader(Path(path))
        self.path = self.bag.path

    @cached_property
    def parameters(self) -> Mapping[str, Mapping[str, Any]]:
        """The recorded parameters by node, and by dotted name."""
        return read_parameters(self.bag.metadata)

    def parameters_of(self, kind: type[Configuration]) -> dict[str, Any]:
        """Return the recorded parameters of the node that ``kind`` configures, if any."""
        return recorded_parameters(self.parameters, kind)

    def flight(self) -> Flight:
        """Return the flight as arrays.

        The flight ends with the last usable odometry; later stamps are omitted, because the
        controller's watchdog acts when a simulator has ended. Odometry and references that the
        controller rejects (not finite, no unit quaternion) are omitted, too. If messages
        were resent, as in lockstep, the first is used.

        Raises:
            BagError: The bag has no usable odometry, or a topic of this package twice.
            ConfigurationError: The recorded parameters cannot be used.
        """
        recorded = self.parameters_of(MpcConfig)
        mpc = MpcConfig.build(recorded)
        rejected: Counter[str] = Counter()
        usable = partial(
            _usable,
            twist_frame=mpc.odometry.twist_frame,
            frame_id=mpc.odometry.frame_id if recorded else None,
            rejected=rejected,
        )
        odometry, commands, stats = Log(OdometrySample), Log(CommandSample), Log(TickStats)
        takers: dict[Topic, Taker] = {
            ODOMETRY: _into(odometry.append, usable),
            COMMAND: _into(commands.append, conversions.command_from_message),
            STATS: _into(stats.append, self._figures),
        }
        self._stream(takers)
        if len(odometry) == 0:
            reasons = "".join(f"; {count} rejected: {why}" for why, count in rejected.items())
            raise BagError(
                f"{self.path}: no flight: expected usable {ODOMETRY.type_name} messages on a "
                f"topic that ends in /{ODOMETRY.name}{reasons}{self._other_encodings()}"
            )
        arrays = flown_arrays(odometry, commands, stats)
        stamp_ns = arrays["stamp_ns"]
        self._check_stamps_advance(stamp_ns, count=len(odometry))
        # In a second pass, with the stamps known at which references count.
        sampler = ReferenceSampler(stamp_ns, mpc.vehicle())
        again: dict[Topic, Taker] = {
            REFERENCE: _into(
                lambda each: sampler.take(each.value), conversions.reference_from_message
            )
        }
        gates: list[GatePoses] = []
        again[GATES] = _gates_into(gates, frame_id=mpc.odometry.frame_id)
        self._stream(again)
        return Flight(
            **arrays,
            reference=sampler.track(),
            parameters=self.parameters,
            mpc=mpc,
            scene=self.scene(),
            gates=gates,
            rejected=rejected,
        )

    def scene(self) -> Scene | None:
        """Return the obstacles of a simulated flight: the file in the run, or the configured one.

        None without obstacles, or if neither file exists.
        """
        given = self.parameters_of(SimulatorConfig).get("obstacles.file")
        if not given:
            return None
        folder = self.path if self.path.is_dir() else self.path.parent
        for file in (folder.parent / SCENE_NAME, files.expanded(str(given))):
            if file.is_file():
                read = optional_part("read_scene", needed_by="simulator.obstacles.file")
                scene: Scene = read(file)
                return scene
        return None

    def run(
        self,
        names: Mapping[Topic, str] = MappingProxyType({}),
        *,
        topics: Collection[Topic] = _RUN_TOPICS,
    ) -> RecordedRun:
        """Return the odometry and ``topics`` of the controller; other topics are empty.

        Args:
            names: Names of topics in a bag of another stack. Topics of this package are found in
                any namespace, and the battery by its type.
            topics: Topics to read besides the odometry.

        Raises:
            BagError: The bag has no odometry, a duplicate topic, a missing named topic or one of
                another type, or two batteries and no ``--battery-topic``.
        """
        run = RecordedRun(bag=self.path, parameters=self.parameters)
        flown = Log(CommandSample)
        named = dict(names)
        takers: dict[Topic, Taker] = {
            ODOMETRY: _into(run.odometries.append, conversions.odometry_from_message),
            REFERENCE: _into(run.windows.append, conversions.reference_from_message),
            COMMAND: _into(run.commands.append, conversions.command_from_message),
            ENGAGED: _into(run.engagements.append, lambda m: bool(m.data)),
            LANDED: _into(run.landings.append, lambda m: bool(m.data)),
            ODOMETRY_RESET: _into(run.resets.append, conversions.reset_from_message),
            STATS: _into(run.stats.append, self._figures),
            IMU: _into(run.imu.append, conversions.imu_from_message),
            PARAMETER_EVENTS: self._changes(run.changes),
        }
        wanted = {ODOMETRY, *topics} - {BATTERY}
        takers = {topic: take for topic, take in takers.items() if topic in wanted}
        if BATTERY in topics and (battery := self._battery(names.get(BATTERY))) is not None:
            voltage_of = operator.attrgetter(VOLTAGE_FIELDS[battery.type_name])
            takers[battery] = _into(run.voltages.append, lambda m: float(voltage_of(m)))
            named[battery] = battery.name
        if COMMAND in topics and COMMAND not in names:
            takers[RECORDED_COMMAND] = _into(flown.append, conversions.command_from_message)
        self._stream(takers, names=named)
        if not run.odometries:
            raise BagError(
                f"{self.path}: contains no odometry: expected {ODOMETRY.type_name} on a topic "
                f"that ends in /{ODOMETRY.name}, or --odom-topic; it contains "
                f"{self._listed_topics()}{self._other_encodings()}"
            )
        self._check_stamps_advance(np.unique(run.odometries.stamp_ns), count=len(run.odometries))
        # In a bag that was resolved, the vehicle flew these and not the ones beside them.
        return dataclasses.replace(run, commands=flown or run.commands)

    def _stream(
        self, takers: Mapping[Topic, Taker], *, names: Mapping[Topic, str] | None = None
    ) -> None:
        """Pass the messages of topics on one by one, in log-time order.

        ``names``: full names of topics with names of other stacks.
        """
        given = names or {}
        taker_of = {
            name: take
            for topic, take in takers.items()
            for name in (
                [self._topic_named(given[topic], types=[topic.type_name]).name]
                if topic in given
                else self._names_of(topic)
            )
        }
        self.bag.require_cdr(taker_of)
        for message in self.bag.messages(taker_of.keys()):
            taker_of[message.topic](message)

    def _figures(self, message: Any) -> TickStats:
        """Return the figures in a message, and reject messages of another package."""
        try:
            return tick_stats(message)
        except (KeyError, ValueError) as error:
            raise BagError(f"{self.path}: unusable message on /{STATS.name}: {error}") from error

    def _changes(self, changes: list[Received[Mapping[str, Any]]]) -> Taker:
        """Return a function that collects parameter changes of the recorded controller."""
        spaces = [name.removesuffix(STATS.name) for name in self._names_of(STATS)]

        def take(message: RecordedMessage) -> None:
            node, values = conversions.parameter_changes_from_message(message.message)
            space, name = node.rsplit("/", 1) if "/" in node else ("", node)
            if values and name == MpcConfig.owner and f"{space}/" in (spaces or [f"{space}/"]):
                changes.append(_received(message, values))

        return take

    def _topic_named(self, name: str, *, types: Collection[str]) -> Topic:
        """Return the topic with a given name. Raises :class:`BagError` for another type."""
        known = self.bag.topics
        full = name if name.startswith("/") or name in known else f"/{name}"
        info = known.get(full)
        if info is None:
            raise BagError(
                f"{self.path}: topic {name} is not in the bag; it contains {self._listed_topics()}"
            )
        if info.type_name not in types:
            raise BagError(
                f"{self.path}: topic {full} is of type {info.type_name or 'unknown'}, "
                f"expected {' or '.join(types)}"
            )
        return Topic(name=full, type_name=info.type_name)

    def _battery(self, name: str | None) -> Topic | None:
        """Return the topic ``name``, or the only one that reports a battery's voltage."""
        if name:
            return self._topic_named(name, types=VOLTAGE_FIELDS)
        found = [
            Topic(name=name, type_name=info.type_name)
            for name, info in sorted(self.bag.topics.items())
            if info.type_name in VOLTAGE_FIELDS and info.message_count > 0
        ]
        if len(found) > 1:
            raise BagError(
                f"{self.path}: {', '.join(topic.name for topic in found)} all report a battery: "
                "select the flown battery with --battery-topic"
            )
        return found[0] if found else None

    def _names_of(self, topic: Topic) -> list[str]:
        """Return the full names of a topic: one, or none if it was not recorded."""
        names = [
            name
            for name, info in self.bag.topics.items()
            if f"/{name}".endswith(f"/{topic.name.removeprefix('/')}")
            and info.type_name == topic.type_name
            and info.message_count > 0
        ]
        if len(names) > 1:
            raise BagError(
                f"{self.path}: {', '.join(sorted(names))} all end in /{topic.name}: expected a "
                "bag of one vehicle; record each vehicle in a separate bag"
            )
        return names

    def _check_stamps_advance(self, stamp_ns: Stamps, *, count: int) -> None:
        """Reject a bag in which most odometries repeat a stamp; in lockstep few do."""
        if 2 * len(stamp_ns) < count:
            raise BagError(
                f"{self.path}: {NOT_ADVANCING}: given {count} odometries with "
                f"{len(stamp_ns)} different stamps, the first {1e-9 * int(stamp_ns[0]):.3f} s; "
                "set header.stamp to the time of each measurement"
            )

    def _other_encodings(self) -> str:
        """Return the error for messages of another middleware; empty for ROS 2."""
        others = {info.encoding for info in self.bag.topics.values()} - {CDR}
        return "".join(f"; {encoding_error(each)}" for each in sorted(others))

    def _listed_topics(self) -> str:
        """Return the topics and their types as text for an error."""
        topics = self.bag.topics
        shown = [
            f"{name} ({info.type_name or 'no type'})"
            for name, info in sorted(topics.items())[:_MAX_LISTED]
        ]
        more = len(topics) - len(shown)
        return ", ".join(shown + ([f"{more} more"] if more else [])) or "no topic"


def _usable(
    message: Any, *, twist_frame: str, frame_id: str | None, rejected: Counter[str]
) -> OdometrySample:
    """Return an odometry with its twist in body axes; raises ``ValueError`` if unusable.

    ``rejected`` counts why the controller rejects odometries. Odometry in a frame other than the
    controller's ``frame_id`` is returned as well.
    """
    odometry = conversions.odometry_from_message(message)
    fault = odometry_fault(odometry, frame_id=frame_id or odometry.frame_id)
    if fault is not None:
        rejected[fault] += 1
        if (fault := odometry_fault(odometry, frame_id=odometry.frame_id)) is not None:
            raise ValueError(fault)
    return with_body_twist(odometry) if twist_frame == "world" else odometry


def _gates_into(gates: list[GatePoses], *, frame_id: str) -> Taker:
    """Return a function that appends changed gate poses; other frames are omitted."""

    def take(message: RecordedMessage) -> None:
        with contextlib.suppress(UserError):
            p_WG, q_WG_xyzw = conversions.poses_from_message(message.message, frame_id=frame_id)
            poses = GatePoses(message.publish_time_ns, p_WG, q_WG_xyzw)
            if not gates or not all(map(np.array_equal, poses[1:], gates[-1][1:])):
                gates.append(poses)

    return take


def _into(use: Callable[[Received[T]], None], convert: Callable[[Any], T]) -> Taker:
    """Return a function that converts messages and passes the values on, except invalid ones."""

    def take(message: RecordedMessage) -> None:
        try:
            value = convert(message.message)
        except ValueError:
            return
        use(_received(message, value))

    return take


def _received(message: RecordedMessage, value: T) -> Received[T]:
    return Received(
        value=value,
        log_time_ns=message.log_time_ns,
        publish_time_ns=message.publish_time_ns,
    )
