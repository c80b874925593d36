# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Only one of two MPCs in a namespace sends commands, in every order of starting."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.processes import PATIENCE
from geometry_msgs.msg import TwistStamped
from rclpy.qos import qos_profile_sensor_data

from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.diagnostics import OK
from quad_mpc_ros.ros.command_ownership import DISCOVERING, CommandOwnership

Start = Callable[..., Any]


class Commands:
    """Counts the commands for each odometry."""

    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self._answers: Counter[tuple[int, int]] = Counter()
        peer.node.create_subscription(
            TwistStamped, "command", self._receive, qos_profile_sensor_data
        )

    def _receive(self, command: TwistStamped) -> None:
        self._answers[command.header.stamp.sec, command.header.stamp.nanosec] += 1

    def most(self, odometries: int = 15) -> int:
        """Return the most commands for one odometry, once so many have been answered."""
        self._answers.clear()
        assert self._peer.wait(lambda: len(self._answers) > odometries)
        return max(self._answers.values())

    def come(self, seconds: float) -> bool:
        """Return whether a command comes within a time."""
        self._answers.clear()
        return bool(self._peer.wait(lambda: self._answers, timeout=seconds))


@pytest.mark.parametrize("in_a_row", [True, False], ids=["one after another", "at once"])
def test_only_one_of_two_mpcs_sends_commands(
    in_a_row: bool, start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    names, commands = ("first", "second"), Commands(peer)
    nodes = {name: managed(name) for name in names}
    processes, logs = {}, {name: tmp_path / f"{name}.log" for name in names}
    feed.odometry = in_a_row
    for name in names:
        processes[name] = start("mpc", "-r", f"__node:={name}")
        (tmp_path / "mpc.log").rename(logs[name])
        if in_a_row and name == "first":
            assert nodes[name].reports("active")
    if not in_a_row:
        assert all(nodes[name].reports("inactive", "no odometry yet") for name in names)
        assert peer.wait(lambda: all(knows(nodes[name].health) for name in names))
        feed.odometry = True

    def yields(name: str) -> bool:
        """Whether a node has logged that the other one is in command."""
        text = logs[name].read_text()
        return "already publishing" in text or "has been in command for longer" in text

    assert peer.wait(lambda: any(map(yields, names)))
    waits, flies = sorted(names, key=yields, reverse=True)
    assert flies == "first" or not in_a_row
    assert not yields(flies)
    assert nodes[waits].reports("inactive") and nodes[flies].reports("active")
    assert commands.most() == 1
    warning = f"2 publishers on /command, expected one: also /{waits}"
    assert nodes[flies].reports("active", warning)
    assert warning in logs[flies].read_text()
    assert not nodes[waits].to("activate")
    assert commands.most() == 1

    processes[flies].send_signal(signal.SIGINT)
    assert processes[flies].wait(PATIENCE) == 0
    assert peer.wait(lambda: nodes[waits].health["text"] == "inactive")
    assert not commands.come(0.3), "takes over by itself"
    assert nodes[waits].to("activate")
    assert commands.most() == 1


def knows(health: dict[str, str]) -> bool:
    """Whether an MPC reports that it has discovered the other nodes."""
    return health[DISCOVERING] == "false"


def health_of(name: str, values: list[tuple[str, str]]) -> bytes:
    return cdr.written_diagnostics(stamp_ns=0, level=OK, name=name, text="", values=values)


def discovered(peer: Any, name: str) -> CommandOwnership:
    """Return what knows who commands beside a new node, after it has had time to find them."""
    node = peer.node
    commanders = CommandOwnership(node)
    commanders.watch(node.create_publisher(TwistStamped, name, qos_profile_sensor_data))
    assert commanders.is_discovering
    commanders.note_message()
    assert peer.wait(lambda: not commanders.is_discovering)
    return commanders


def test_any_other_publisher_of_commands_is_named(peer: Any) -> None:
    commanders = discovered(peer, "vehicle/command")
    assert commanders.activation_blocker() is None
    other = peer.node.create_publisher(TwistStamped, "vehicle/command", qos_profile_sensor_data)
    assert peer.wait(lambda: commanders.activation_blocker() is not None)
    blocker = str(commanders.activation_blocker())
    assert "/test_peer can publish /vehicle/command as well" in blocker
    assert "2 publishers on /vehicle/command, expected one: also /test_peer" in commanders.fault()
    peer.node.destroy_publisher(other)
    assert peer.wait(lambda: commanders.activation_blocker() is None)
    assert commanders.fault() == ""


def test_ignores_mpcs_in_other_namespaces(peer: Any) -> None:
    ours, theirs = discovered(peer, "a/command"), discovered(peer, "b/command")
    theirs.begin()
    ours.receive(health_of("/b/mpc", theirs.values()))
    assert ours.activation_blocker() is None
    assert ours.fault() == ""


def test_an_inactive_mpc_may_wait_next_to_an_active_one(peer: Any) -> None:
    ours, theirs = discovered(peer, "command"), discovered(peer, "command")
    assert peer.wait(lambda: ours.activation_blocker() is not None)
    ours.receive(health_of("/standby", theirs.values()))
    assert ours.activation_blocker() is None
    theirs.begin()
    ours.receive(health_of("/standby", theirs.values()))
    blocker = str(ours.activation_blocker())
    assert "/standby" in blocker and "is already publishing commands" in blocker
    theirs.end()
    ours.receive(health_of("/standby", theirs.values()))
    assert ours.activation_blocker() is None


def test_exactly_one_of_two_active_mpcs_stops(peer: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also in the same nanosecond."""
    one, two = discovered(peer, "command"), discovered(peer, "command")
    for moments in ((1, 2), (2, 1), (1, 1)):
        for each, moment in zip((one, two), moments, strict=True):
            monkeypatch.setattr(time, "time_ns", lambda moment=moment: moment)
            each.begin()
        values = one.values(), two.values()
        answers = one.receive(health_of("/b", values[1])), two.receive(health_of("/a", values[0]))
        stops = bool(answers[0]), bool(answers[1])
        assert sorted(stops) == [False, True]
        assert moments == (1, 1) or stops == (moments[0] > moments[1], moments[1] > moments[0])
