# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The player node: publishes the messages of a bag at their recorded times."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.publisher import Publisher

from quad_mpc_ros.configuration import BagError, ConfigurationError
from quad_mpc_ros.messages.conversions import fill_time
from quad_mpc_ros.messages.diagnostics import OK
from quad_mpc_ros.messages.schemas import schema_for
from quad_mpc_ros.messages.topics import CLOCK
from quad_mpc_ros.recordings.config import PlayerConfig
from quad_mpc_ros.recordings.mcap_file import TopicInfo
from quad_mpc_ros.recordings.qos import parse_qos_text
from quad_mpc_ros.recordings.reader import BagReader, RecordedMessage
from quad_mpc_ros.recordings.replay.playback import Playback
from quad_mpc_ros.ros.health import Health, ReportingNode
from quad_mpc_ros.ros.messages import message_class, new_message, qos_of
from quad_mpc_ros.ros.nodes.bag_qos import playback_profile
from quad_mpc_ros.ros.spin import EXIT_BAD_INPUT, run, stop

_ACKNOWLEDGE_TIMEOUT = Duration(seconds=2)
_PROGRESS_PERIOD = 0.5
# Reading ahead must not delay a due message: Python's default of 5 ms is a quarter of a period
# at 50 Hz.
_SWITCH_INTERVAL_S = 0.0005
_NS_PER_S = 1_000_000_000
_MAX_LISTED = 10


class PlayerNode(ReportingNode[PlayerConfig]):
    """Publishes the serialized messages of a bag with their recorded quality of service."""

    def __init__(self) -> None:
        self._threads = ExitStack()
        super().__init__("player", PlayerConfig)
        try:
            self._prepare()
        except BaseException:  # also signals: nothing else would stop the threads
            self._threads.close()
            raise

    def _prepare(self) -> None:
        config = self.config
        if not config.bag:
            raise ConfigurationError("player.bag", config.bag, "a bag directory or .mcap file")
        reader = BagReader(Path(config.bag))
        topics, refused = played_topics(reader, config)
        for topic, why in refused.items():
            self.get_logger().warning(f"not played: {topic}: {why}")
        self._start_ns, self._end_ns = _played_span(reader, config)
        self._outputs = {
            topic: self.create_publisher(
                message_class(info.type_name),
                topic,
                playback_profile(parse_qos_text(info.qos_profiles)),
            )
            for topic, info in topics.items()
        }
        self._clock_output = None
        if config.clock_rate:
            clock = message_class(CLOCK.type_name)
            self._clock_output = self.create_publisher(clock, CLOCK.name, qos_of(CLOCK))
        self._clock_message = new_message(CLOCK.type_name)
        self._playback = Playback(
            reader.messages(topics, from_ns=self._start_ns),
            recorded_ns=self._start_ns,
            steady_ns=time.monotonic_ns() + round(config.delay * _NS_PER_S),
            rate=config.rate,
            publish=self._publish,
            publish_clock=self._publish_clock,
            clock_rate=config.clock_rate,
        )
        self._threads.callback(self._playback.stop)
        if self._playback.finished:
            raise BagError(f"{config.bag}: no message after {config.start:g} s on these topics")
        if config.progress:
            self.create_timer(_PROGRESS_PERIOD, self._show_progress)
        sys.setswitchinterval(_SWITCH_INTERVAL_S)

    def begin(self) -> None:
        """Start to play."""
        self.get_logger().info(f"playing {self.config.bag}: {len(self._outputs)} topics")
        self._playback.start(at_end=self._at_end)

    def destroy_node(self) -> None:
        """Stop playing, then destroy the node."""
        self._threads.close()
        super().destroy_node()

    def _publish(self, message: RecordedMessage) -> None:
        self._send(self._outputs[message.topic], message.data)

    def _publish_clock(self, recorded_ns: int) -> None:
        if self._clock_output is not None:
            fill_time(self._clock_message.clock, min(recorded_ns, self._end_ns))
            self._send(self._clock_output, self._clock_message)

    def _send(self, publisher: Publisher, message: Any) -> None:
        with self._unless_shut_down():
            publisher.publish(message)

    @contextmanager
    def _unless_shut_down(self) -> Iterator[None]:
        """Ignore errors after a signal has shut ROS down."""
        try:
            yield
        except RuntimeError:  # of rclpy
            if self.context.ok():
                raise

    def _at_end(self, problem: Exception | None) -> None:
        if isinstance(problem, BagError):
            self.get_logger().fatal(f"playback ended: {problem}")
            self.exit_code = EXIT_BAD_INPUT
        elif problem is not None:
            self.get_logger().fatal(f"playback ended: {problem!r}")
            self.exit_code = 1
        else:
            for publisher in self._outputs.values():  # slow subscribers would lose messages
                with self._unless_shut_down():
                    publisher.wait_for_all_acked(_ACKNOWLEDGE_TIMEOUT)
            self.get_logger().info(f"played {self._playback.count} messages")
        stop()

    def _position(self) -> float:
        recorded_ns = min(self._playback.recorded_ns(time.monotonic_ns()), self._end_ns)
        return self.config.start + (recorded_ns - self._start_ns) / _NS_PER_S

    def _show_progress(self) -> None:
        end = self.config.start + (self._end_ns - self._start_ns) / _NS_PER_S
        print(f"  {self._position():8.1f} s of {end:.1f} s", file=sys.stderr, flush=True)

    def report(self) -> Health:
        """Return the position in the bag."""
        return Health(
            level=OK,
            text="playing",
            values=[
                ("position", f"{self._position():.3f}"),
                ("messages", str(self._playback.count)),
            ],
        )


def played_topics(
    reader: BagReader, config: PlayerConfig
) -> tuple[dict[str, TopicInfo], dict[str, str]]:
    """Return the selected topics that can be played, and the errors of the others.

    Raises :class:`BagError` if a given topic is not in the bag, or none can be played.
    """
    # Some recorders omit the slash.
    names = tuple(
        name if name in reader.topics else f"/{name.lstrip('/')}" for name in config.topics
    )
    for name in names:
        if name not in reader.topics:
            raise BagError(f"{config.bag}: no topic {name} in the bag: {_listed(reader.topics)}")
    playable: dict[str, TopicInfo] = {}
    refused: dict[str, str] = {}
    for topic, info in reader.topics.items():
        if (names and topic not in names) or (config.clock_rate and topic == CLOCK.name):
            continue
        if why := _playback_error(info):
            refused[topic] = why
        else:
            playable[topic] = info
    if not any(info.message_count for info in playable.values()):
        why = "".join(f"; {topic}: {reason}" for topic, reason in refused.items())
        raise BagError(
            f"{config.bag}: contains no playable message on the selected topics; its topics: "
            f"{_listed(reader.topics)}{why}"
        )
    return playable, refused


def _playback_error(info: TopicInfo) -> str:
    """Return the reason why a topic cannot be played, or an empty string."""
    if info.encoding != "cdr":
        return f"its messages are encoded as {info.encoding!r}, expected 'cdr'"
    try:
        message_class(info.type_name)
        type_hash = schema_for(info.type_name).type_hash
    except (ImportError, AttributeError, ValueError, BagError):
        return f"its type {info.type_name!r} is not installed"
    if info.type_hash and info.type_hash != type_hash:
        return f"its type {info.type_name} has changed since it was recorded"
    return ""


def _listed(topics: Collection[str]) -> str:
    shown = ", ".join(sorted(topics)[:_MAX_LISTED]) or "no topic"
    return shown if len(topics) <= _MAX_LISTED else f"{shown}, …"


def _played_span(reader: BagReader, config: PlayerConfig) -> tuple[int, int]:
    """Return the first and last log time to play, both included."""
    span = reader.span
    assert span is not None  # there is a message to play
    start_ns = span.start_ns + round(config.start * _NS_PER_S)
    if start_ns > span.end_ns:
        duration = span.duration_ns / _NS_PER_S
        expected = f"at most the {duration:.3f} s of the bag"
        raise ConfigurationError("player.start", config.start, expected)
    return start_ns, span.end_ns


main = functools.partial(run, PlayerNode)

if __name__ == "__main__":
    sys.exit(main())
