# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference uses a monotonic clock, and publishes windows while it plans."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from fixtures.ros_context import initialised
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.topics import ENGAGED, LANDED
from quad_mpc_ros.references.director import Reply
from quad_mpc_ros.references.timeline import StampClock
from quad_mpc_ros.ros.messages import qos_of, reference_in
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode

SECOND = 1_000_000_000
PERIOD = 0.005  # s, between odometries
# Short windows, of which many come.
ARGUMENTS = ["--ros-args", "-p", "trajectory:=circle", "-p", "circle_speed:=5.0"]
ARGUMENTS += ["-p", "advanced.window_duration:=0.4"]


class Flown:
    """A reference node in this process, and a peer with odometry."""

    def __init__(self) -> None:
        self.windows: list[tuple[int, ReferenceWindow]] = []
        self.node = ReferenceNode()
        publisher = self.node._reference
        publish = publisher.publish

        def kept(message: bytes) -> None:
            window = reference_in(message)
            self.windows.append((time.monotonic_ns(), window))
            publish(message)

        publisher.publish = kept
        self.node.begin()
        self.peer = rclpy.create_node("peer")
        self.odometry = self.peer.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.ahead_ns = 0

    def close(self) -> None:
        self.node.destroy_node()
        self.peer.destroy_node()

    def fly(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.say(np.zeros(3))

    def say(self, p_WB: Any) -> None:
        message = Odometry()
        stamp_ns = time.time_ns() + self.ahead_ns
        conversions.fill_odometry(message, OdometrySample.at_rest(p_WB, stamp_ns=stamp_ns))
        self.odometry.publish(message)
        end = time.monotonic() + PERIOD  # odometries without a pause would starve other threads
        while (left := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)

    def spin(self, until: Callable[[], object]) -> bool:
        end = time.monotonic() + 20.0
        while not until():
            if time.monotonic() > end:
                return False
            self.say(np.zeros(3))
        return True


@pytest.fixture
def flown(request: pytest.FixtureRequest) -> Iterator[Flown]:
    with initialised([*ARGUMENTS, *getattr(request, "param", [])]):
        made = Flown()
        yield made
        made.close()


def assert_steady(windows: list[tuple[int, ReferenceWindow]]) -> None:
    """The reference has moved by its speed and no more, whatever the clocks said."""
    assert len(windows) > 20
    (begun_ns, first), (ended_ns, _) = windows[0], windows[-1]
    way = sum(
        float(np.linalg.norm(other.p_WB[0] - one.p_WB[0]))
        for (_, one), (_, other) in itertools.pairwise(windows)
    )
    speed = float(np.linalg.norm(first.v_WB_W[0]))
    assert speed == pytest.approx(5.0, rel=1e-3)
    assert way == pytest.approx(speed * 1e-9 * (ended_ns - begun_ns), abs=1.0)


def test_system_clock_step_does_not_move_the_reference(
    flown: Flown, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = -3
    assert flown.spin(lambda: len(flown.windows) > 10 and flown.node._live.started)
    flown.fly(0.3)
    flown.windows.clear()
    flown.fly(0.5)
    now = Clock.now
    monkeypatch.setattr(
        Clock,
        "now",
        lambda self: Time(
            nanoseconds=now(self).nanoseconds + step * SECOND, clock_type=ClockType.ROS_TIME
        ),
    )
    flown.fly(1.0)
    assert_steady(flown.windows)
    # The odometry's stamps have not stepped, and so the windows' have not.
    assert abs(flown.windows[-1][1].stamp_ns - time.time_ns()) < SECOND


def test_windows_use_stamp_clock_and_flight_uses_its_own(flown: Flown) -> None:
    step = -3
    assert flown.spin(lambda: len(flown.windows) > 10 and flown.node._live.started)
    flown.fly(0.3)
    flown.windows.clear()
    flown.fly(0.5)
    flown.ahead_ns = step * SECOND
    flown.fly(1.0)
    assert_steady(flown.windows)
    assert abs(flown.windows[-1][1].stamp_ns - time.time_ns() - step * SECOND) < SECOND


def test_windows_continue_during_planning(flown: Flown, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def slow(now_ns: int) -> Reply:
        asked.append(now_ns)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            np.linalg.norm(np.ones(3))
        return flown.node._live._director.hold(now_ns)

    assert flown.spin(lambda: len(flown.windows) > 10 and flown.node._live.started)
    flown.windows.clear()
    begun_ns = time.monotonic_ns()
    reply = flown.node._handle("slow", slow)
    while_planned = [at for at, _ in flown.windows if at - begun_ns < SECOND]
    assert reply.accepted
    assert len(while_planned) > 10
    # What took too long was planned once more, to begin when it was ready: nothing jumps.
    assert len(asked) == 2
    assert asked[1] > asked[0] + SECOND
    flown.fly(0.5)
    for (_, one), (_, other) in zip(flown.windows[:-1], flown.windows[1:], strict=True):
        dt = 1e-9 * (other.stamp_ns - one.stamp_ns)
        assert np.linalg.norm(other.p_WB[0] - one.p_WB[0]) < 5.5 * dt + 1e-3


@pytest.mark.parametrize("flown", [["-p", "mode:=on_request"]], indirect=True)
def test_engaged_and_landed_reach_the_reference(flown: Flown) -> None:
    engaged = flown.peer.create_publisher(Bool, "engaged", qos_of(ENGAGED))
    landed = flown.peer.create_publisher(Bool, "landed", qos_of(LANDED))
    take_off = flown.peer.create_client(Trigger, "reference/takeoff")
    engaged.publish(Bool(data=False))
    landed.publish(Bool(data=False))

    def at(place: list[float]) -> bool:
        flown.say(np.array(place))
        return bool(flown.windows) and np.allclose(flown.windows[-1][1].p_WB[0], place, atol=1e-6)

    assert flown.spin(lambda: flown.node._live.waits and flown.node._live._landed is False)
    assert flown.spin(lambda: at([1.0, 2.0, 3.0]))
    assert flown.spin(lambda: at([4.0, 2.0, 3.0]))
    assert take_off.wait_for_service(5.0)
    asked = take_off.call_async(Trigger.Request())
    assert flown.spin(asked.done)
    assert "engage" in asked.result().message
    assert flown.spin(lambda: at([5.0, 2.0, 3.0]))
    engaged.publish(Bool(data=True))
    assert flown.spin(lambda: flown.node._live.started)
    held = flown.windows[-1][1].p_WB[0].copy()
    flown.fly(0.3)
    assert np.allclose(flown.windows[-1][1].p_WB[0], held)


def test_stamps_of_a_stalled_link_do_not_move_the_clock() -> None:
    clock = StampClock()
    for k in range(50):
        clock.note(20 * k, now_ns=20 * k)
    for k in range(20):  # a burst of what waited half a second
        clock.note(1_000_000_000 + 25_000_000 * k, now_ns=1_500_000_000 + 100_000 * k)
        assert clock.ahead_ns == 0
