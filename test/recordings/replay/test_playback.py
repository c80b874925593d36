# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""When messages are due, on a clock of the test's: nothing here waits or needs ROS."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator

import pytest

from quad_mpc_ros.recordings.reader import BagReader, RecordedMessage
from quad_mpc_ros.recordings.replay.playback import Playback, read_ahead
from quad_mpc_ros.recordings.writer import BagWriter

CLOCK = "rosgraph_msgs/msg/Clock"
MS = 1_000_000
RECORDED = [1000 * MS, 1020 * MS, 1020 * MS, 1050 * MS, 1300 * MS]
STEADY_START = 77_000 * MS


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> BagReader:
    directory = tmp_path_factory.mktemp("playback") / "bag"
    with BagWriter(directory) as writer:
        writer.add_topic("/clock", CLOCK)
        for index, time_ns in enumerate(RECORDED):
            data = b"\x00\x01\x00\x00" + index.to_bytes(4, "little") + bytes(4)
            writer.write("/clock", data, log_time_ns=time_ns, publish_time_ns=0)
    return BagReader(directory)


class Player:
    """A playback with its clock: sleeps until something is due, and notes what was published."""

    def __init__(
        self,
        reader: BagReader,
        *,
        rate: float = 1.0,
        start_ns: int = RECORDED[0],
        clock_rate: float = 0.0,
    ) -> None:
        self.now_ns = STEADY_START
        self.published: list[tuple[int, int]] = []
        self.clock: list[tuple[int, int]] = []
        self.playback = Playback(
            reader.messages(from_ns=start_ns),
            recorded_ns=start_ns,
            steady_ns=STEADY_START + 500 * MS,
            rate=rate,
            publish=self._on_message,
            publish_clock=lambda time_ns: self.clock.append((self.now_ns, time_ns)),
            clock_rate=clock_rate,
        )

    def _on_message(self, message: RecordedMessage) -> None:
        self.published.append((self.now_ns - STEADY_START, message.message.clock.sec))

    def run(self, until_ns: int, *, late_ns: int = 0) -> None:
        """Go on to a time since the start; every wake-up comes so much too late."""
        while (at_ns := self.playback.step(self.now_ns)) is not None:
            if at_ns > STEADY_START + until_ns:
                break
            assert at_ns > self.now_ns, "woken for nothing"
            self.now_ns = at_ns + late_ns
        self.now_ns = max(self.now_ns, STEADY_START + until_ns)


def times(player: Player) -> list[float]:
    return [time_ns / MS for time_ns, _ in player.published]


@pytest.mark.parametrize("rate", [1.0, 2.0, 0.1, 1000.0])
def test_publishes_messages_at_their_times(reader: BagReader, rate: float) -> None:
    player = Player(reader, rate=rate)
    player.run(10_000 * MS)
    assert times(player) == pytest.approx(
        [500.0 + (time_ns - RECORDED[0]) / MS / rate for time_ns in RECORDED], abs=1e-5
    )
    assert [number for _, number in player.published] == [0, 1, 2, 3, 4]
    assert player.playback.finished


def test_late_message_delays_no_other(reader: BagReader) -> None:
    player = Player(reader)
    player.run(10_000 * MS, late_ns=4 * MS)
    assert times(player) == [504.0, 524.0, 524.0, 554.0, 804.0]


def test_starts_in_the_middle(reader: BagReader) -> None:
    player = Player(reader, start_ns=1040 * MS)
    player.run(10_000 * MS)
    assert player.published == [(510 * MS, 3), (760 * MS, 4)]


def test_clock_is_even(reader: BagReader) -> None:
    player = Player(reader, rate=2.0, clock_rate=100.0)
    player.run(600 * MS)
    steady = [now_ns for now_ns, _ in player.clock]
    assert {after - before for before, after in itertools.pairwise(steady)} == {10 * MS}
    for now_ns, time_ns in player.clock:
        assert time_ns == RECORDED[0] + 2 * max(0, now_ns - STEADY_START - 500 * MS)


def test_read_ahead_keeps_order_and_depth() -> None:
    taken: list[int] = []

    def numbers() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            yield number

    ahead = read_ahead(numbers(), depth=5)
    assert [next(ahead) for _ in range(10)] == list(range(10))
    assert len(taken) <= 15
    assert list(ahead) == list(range(10, 100))


def test_read_ahead_raises_errors_in_turn() -> None:
    def failing() -> Iterator[int]:
        yield 1
        raise ValueError("torn page")

    ahead = read_ahead(failing(), depth=5)
    assert next(ahead) == 1
    with pytest.raises(ValueError, match="torn page"):
        next(ahead)


def test_read_ahead_closes() -> None:
    before = threading.active_count()
    ahead = read_ahead(itertools.count(), depth=5)
    next(ahead)
    ahead.close()
    assert threading.active_count() == before
