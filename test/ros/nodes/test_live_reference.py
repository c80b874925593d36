# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Live flights with the reference node: services, goals and trajectories over DDS."""

from __future__ import annotations

import itertools
import math
import struct
import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import cdr, conversions, diagnostics
from quad_mpc_ros.messages.topics import REP147_NAMES

Start = Callable[..., "subprocess.Popen[bytes]"]

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Pilot:
    """Asks the reference node for what is to be flown, and keeps what it publishes.

    With ``rep147``, the requests use the topic names of REP-147.
    """

    def __init__(self, peer: Any, *, rep147: bool = False) -> None:
        self._peer = peer
        self._raw: list[bytes] = []
        self.paths: list[PathMessage] = []
        self.requests: list[str] = []
        self._last_replies: dict[str, str] = {}
        self.odometries: list[Odometry] = []
        self.sources: list[str] = []
        self.throttles: list[float] = []
        node = peer.node
        node.create_subscription(
            MultiDOFJointTrajectory, "reference", self._raw.append, 100, raw=True
        )
        node.create_subscription(PathMessage, "reference/path", self.paths.append, LATCHED)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._clients = {
            name: node.create_client(Trigger, f"reference/{name}")
            for name in ("takeoff", "start", "hold", "land")
        }
        names = ("goal_pose", "trajectory", "cmd_vel")
        if rep147:
            names = ("command_pose", "command_trajectory", "command_velocity")
        self._goal = node.create_publisher(PoseStamped, names[0], 1)
        self._trajectory = node.create_publisher(MultiDOFJointTrajectory, names[1], 1)
        self._velocity = node.create_publisher(TwistStamped, names[2], 1)

    def await_node(self) -> None:
        assert self._peer.wait(
            lambda: (
                self._goal.get_subscription_count()
                and self._trajectory.get_subscription_count()
                and self._velocity.get_subscription_count()
                and self._peer.node.count_publishers("reference")
                and all(client.service_is_ready() for client in self._clients.values())
            )
        )

    def call(self, name: str) -> Any:
        return self._peer.call(self._clients[name], Trigger.Request())

    def send_goal(self, p: tuple[float, float, float], *, yaw: float = 0.0) -> str:
        """Send a goal as RViz does; return what the node says of it."""
        message = PoseStamped()
        message.header.frame_id = "odom"
        message.pose.position.x, message.pose.position.y, message.pose.position.z = p
        message.pose.orientation.z = math.sin(0.5 * yaw)
        message.pose.orientation.w = math.cos(0.5 * yaw)
        return self._replied("goal", lambda: self._goal.publish(message))

    def send_trajectory(self, message: MultiDOFJointTrajectory) -> str:
        return self._replied("trajectory", lambda: self._trajectory.publish(message))

    def send_velocity(self, *, frame_id: str, x: float = 0.3, yaw_rate: float = 0.0) -> None:
        message = TwistStamped()
        message.header.frame_id, message.twist.linear.x = frame_id, x
        message.twist.angular.z = yaw_rate
        self._velocity.publish(message)

    @property
    def now(self) -> float:
        """The stamp of the newest window [s]; 0 before the first."""
        if not self._raw:
            return 0.0
        # Only the beginning of the little-endian CDR, because the flight reads it continuously.
        seconds, nanoseconds = struct.unpack_from("<iI", self._raw[-1], 4)
        return float(seconds + 1e-9 * nanoseconds)

    def fly(self, seconds: float) -> None:
        """Let so much time of the flight pass."""
        end = self.now + seconds
        assert self._peer.wait(lambda: self.now >= end)

    def windows(self) -> list[ReferenceWindow]:
        return [
            conversions.reference_from_message(deserialize_message(raw, MultiDOFJointTrajectory))
            for raw in self._raw
        ]

    def _replied(self, name: str, ask: Callable[[], None]) -> str:
        """Send a request and return the new reply; the diagnostics also repeat the last one."""
        before = self._last_replies.get(name)

        def new() -> list[str]:
            return [reply for reply in self.requests if reply.startswith(name) and reply != before]

        self.requests.clear()
        ask()
        assert self._peer.wait(new)
        self._last_replies[name] = new()[-1]
        return self._last_replies[name]

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("reference"):
                values = {pair.key: pair.value for pair in status.values}
                if values["request"]:
                    self.requests.append(values["request"])


def assert_nothing_jumps(windows: list[ReferenceWindow]) -> None:
    """Between windows, poses change by their velocities and velocities by their accelerations.

    The tolerances are for what the slopes change by from one window to the next. Windows that a
    busy machine left far apart are not compared.
    """
    assert len(windows) > 50
    judged = 0
    for one, other in itertools.pairwise(windows):
        dt = 1e-9 * (other.stamp_ns - one.stamp_ns)
        assert dt >= 0.0
        if dt > 0.06:
            continue
        judged += 1
        R_one, R_other = (so3.rotation_from_quaternion_xyzw(w.q_WB_xyzw[0]) for w in (one, other))
        step = {
            "p_WB": other.p_WB[0] - one.p_WB[0],
            "v_WB_W": other.v_WB_W[0] - one.v_WB_W[0],
            "R_WB": so3.log(R_other @ R_one.T),
        }
        slope = {"p_WB": "v_WB_W", "v_WB_W": "a_WB_W", "R_WB": "w_WB_W"}
        for name, tolerance in (("p_WB", 1e-3), ("v_WB_W", 1e-2), ("R_WB", 1e-2)):
            fastest = max(
                float(np.linalg.norm(getattr(window, slope[name])[0])) for window in (one, other)
            )
            assert np.linalg.norm(step[name]) <= 1.1 * fastest * dt + tolerance, (name, dt)
    assert judged > 50


def trajectory_message(
    points: list[tuple[float, float, float]], seconds: list[float]
) -> MultiDOFJointTrajectory:
    count, rest = len(points), np.zeros((len(points), 3))
    window = ReferenceWindow(
        stamp_ns=0,
        offset_ns=np.array([round(1e9 * t) for t in seconds], dtype=np.int64),
        p_WB=np.reshape(np.array(points, dtype=float), (count, 3)),
        q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        v_WB_W=rest,
        a_WB_W=rest,
        w_WB_W=rest,
    )
    data = cdr.written_reference(window, child_frame_id="b")
    return deserialize_message(data, MultiDOFJointTrajectory)


@pytest.fixture
def pilot(start: Start, peer: Any, request: pytest.FixtureRequest) -> Pilot:
    """Return the pilot of a node in real time whose vehicle stands on the ground.

    The parameter is whether the node is remapped as launch files do with ``rep147:=true``.
    """
    rep147 = getattr(request, "param", False)
    made = Pilot(peer, rep147=rep147)
    remaps = [f"{name}:={to}" for name, to in REP147_NAMES.items()] if rep147 else []
    many = ("-p", "advanced.window_duration:=0.4")  # a shorter window is renewed sooner
    rules = [word for remap in remaps for word in ("-r", remap)]
    start("reference", "-p", "mode:=on_request", "-p", "takeoff_height:=0.5", *many, *rules)
    made.await_node()
    odometry = peer.node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
    assert peer.wait(odometry.get_subscription_count)
    peer.spin(0.3)
    assert not made.windows()
    answer = made.call("takeoff")
    assert not answer.success
    assert answer.message == "no usable odometry yet"
    message = Odometry()
    # Again and again: a best-effort message may be lost on a machine that is busy.
    for _ in range(50):
        stamp_ns = int(peer.node.get_clock().now().nanoseconds)
        conversions.fill_odometry(
            message, OdometrySample.at_rest([0.0, 0.0, 0.0], stamp_ns=stamp_ns)
        )
        odometry.publish(message)
        if peer.wait(lambda: made.now > 0.0, timeout=0.3):
            return made
    raise AssertionError("no window for the odometry")


def test_bad_input_is_rejected_with_a_reason_and_the_flight_continues(
    pilot: Pilot, peer: Any
) -> None:
    assert "goal is rejected in mode ground" in pilot.send_goal((1.0, 0.0, 1.0))
    assert "is rejected in mode ground" in pilot.call("land").message
    assert pilot.call("takeoff").success
    pilot.fly(0.5)
    no_transform = trajectory_message([(0, 0, 1), (1, 0, 1)], [0, 2])
    no_transform.points[1].transforms = []
    for request, reason in (
        (lambda: pilot.send_goal((1.0, 0.0, -1.0)), "1 m below the ground"),
        (lambda: pilot.send_trajectory(trajectory_message([], [])), "0 points"),
        (lambda: pilot.send_trajectory(no_transform), "no transform"),
        (lambda: pilot._replied("velocity", lambda: pilot.send_velocity(frame_id="map")), "'map'"),
        (
            lambda: pilot._replied("velocity", lambda: pilot.send_velocity(frame_id="base_link")),
            "velocity is rejected in mode takeoff",
        ),
    ):
        verdict = request()
        assert " refused: " in verdict
        assert reason in verdict
    paths = len(pilot.paths)
    pilot.fly(3.0)
    assert len(pilot.paths) == paths  # nothing new is drawn
    windows = pilot.windows()
    assert_nothing_jumps(windows)
    assert windows[-1].p_WB[-1, 2] > 0.3  # the take-off goes on


@pytest.mark.parametrize("pilot", [False, True], ids=["default", "rep147"], indirect=True)
def test_requests_are_accepted_reported_and_drawn(pilot: Pilot, peer: Any) -> None:
    steps = peer.node.create_publisher(TransformStamped, "odom_reset", 10)
    assert pilot.call("takeoff").success
    pilot.fly(3.0)
    assert "accepted" in pilot.send_trajectory(
        trajectory_message([(0, 0, 0.5), (0.5, 0, 0.7), (0.5, 0.5, 0.5)], [0, 1, 2])
    )
    assert peer.wait(lambda: np.allclose(_end(pilot.paths[-1]), [0.5, 0.5, 0.5], atol=1e-3))
    pilot.fly(0.7)
    assert pilot.call("hold").success
    assert "accepted" in pilot.send_goal((0.2, 0.1, 0.0), yaw=1.0)
    assert peer.wait(lambda: np.allclose(_end(pilot.paths[-1])[:2], [0.2, 0.1], atol=1e-3))
    assert peer.wait(lambda: _rests(pilot), timeout=20.0)
    assert_nothing_jumps(pilot.windows())
    pilot.send_velocity(frame_id="map")
    assert peer.wait(lambda: any(each.startswith("velocity") for each in pilot.requests))

    # A reference at rest moves along with a step of the estimate.
    held = pilot.windows()[-1]
    step, message = np.array([2.0, -1.0, 0.5]), TransformStamped()
    reset = EstimateReset(stamp_ns=held.stamp_ns, turn=0.0, step_W=step)
    conversions.fill_reset(message, reset)
    reply = pilot._replied("reset", lambda: steps.publish(message))
    assert "accepted: the odometry jumps by 2.29 m: moves along" in reply
    moved = held.p_WB[-1] + step
    assert peer.wait(lambda: np.allclose(pilot.windows()[-1].p_WB, moved), timeout=10.0)


def test_follows_velocities_of_teleop_twist_keyboard_and_teleop_twist_joy(
    pilot: Pilot, peer: Any
) -> None:
    """Both publish reliably: the keyboard without a frame, and the joystick with its own frame."""

    def send(*, frame_id: str, x: float = 0.3, yaw_rate: float = 0.0) -> Any:
        """Send for a second, return the displacement (3,) until the reference rests."""
        begin = pilot.windows()[-1].p_WB[0]
        for _ in range(20):
            pilot.send_velocity(frame_id=frame_id, x=x, yaw_rate=yaw_rate)
            peer.spin(0.05)
        assert np.any(pilot.windows()[-1].v_WB_W) == (x != 0.0)
        assert peer.wait(lambda: _rests(pilot), timeout=20.0)
        return pilot.windows()[-1].p_WB[0] - begin

    assert pilot.call("takeoff").success
    assert peer.wait(lambda: _rests(pilot), timeout=20.0)
    way = send(frame_id="odom")
    assert 0.2 < way[0] < 1.0
    assert np.allclose(way[1:], 0.0, atol=1e-6)

    assert np.allclose(send(frame_id="", x=0.0, yaw_rate=1.0), 0.0, atol=1e-6)  # the key j
    nose = so3.rotation_from_quaternion_xyzw(pilot.windows()[-1].q_WB_xyzw[-1])[:, 0]
    assert 0.4 < math.atan2(nose[1], nose[0]) < 2.0

    way = send(frame_id="base_link")  # frame:=base_link
    assert 0.2 < way @ nose < 1.0
    assert np.allclose(way, (way @ nose) * nose, atol=1e-3)

    pilot.send_velocity(frame_id="teleop_twist_joy")  # the default of its parameter frame
    refusal = "velocity refused: frame 'teleop_twist_joy', expected 'base_link'"
    assert peer.wait(lambda: any(each.startswith(refusal) for each in pilot.requests))
    assert_nothing_jumps(pilot.windows())


def _rests(pilot: Pilot) -> bool:
    newest = pilot.windows()[-1]
    moves = np.any(newest.v_WB_W) or np.any(newest.w_WB_W)
    return bool(newest.p_WB[0, 2] > 0.4 and not moves)


def _end(path: PathMessage) -> list[float]:
    position = path.poses[-1].pose.position
    return [position.x, position.y, position.z]


@pytest.mark.slow
def test_live_flight_from_take_off_to_landing(start: Start, peer: Any) -> None:
    """Take-off, square, goal from RViz, landing: one flight with simulator and MPC."""
    pilot = Pilot(peer)
    node = peer.node
    node.create_subscription(Odometry, "odom", pilot.odometries.append, qos_profile_sensor_data)
    node.create_subscription(
        DiagnosticArray,
        "mpc/stats",
        lambda m: pilot.sources.append(diagnostics.stats_from_message(m)["source"]),
        10,
    )
    node.create_subscription(
        TwistStamped,
        "command",
        lambda m: pilot.throttles.append(m.twist.linear.z),
        qos_profile_sensor_data,
    )
    simulated = ("-p", "lockstep:=true", "-p", "use_sim_time:=true")
    quick = ("-p", "max_acceleration:=6.0", "-p", "max_speed:=3.0", "-p", "dwell_time:=0.3")
    start("mpc", *simulated)
    start("reference", *simulated, *quick, "-p", "mode:=on_request", "-p", "side:=1.5")
    start("simulator", "-p", "lockstep:=true", "-p", "autostart:=false")
    pilot.await_node()
    client = node.create_client(Trigger, "simulator/start")
    assert peer.wait(lambda: node.count_publishers("command") and client.service_is_ready())
    assert peer.call(client, Trigger.Request()).success
    assert peer.wait(lambda: pilot.now > 0.0)

    pilot.fly(0.5)
    assert max(pilot.throttles) < 0.01  # idles on the ground until a request
    assert pilot.call("takeoff").success
    pilot.fly(4.5)
    assert pilot.call("start").success
    pilot.fly(10.0)
    assert "accepted" in pilot.send_goal((2.0, -0.5, 0.0), yaw=1.5)
    pilot.fly(3.0)
    assert pilot.call("land").success
    assert peer.wait(lambda: any("touchdown accepted" in reply for reply in pilot.requests), 30.0)
    touchdown = pilot.now  # the reference, below the ground by then, ends on it
    pilot.fly(2.0)

    assert_nothing_jumps([w for w in pilot.windows() if 1e-9 * w.stamp_ns < touchdown - 0.01])
    assert set(pilot.sources) == {"mpc"}
    flown = np.array([_place(o) for o in pilot.odometries])
    corners = np.array([[0, 0, 2], [1.5, 0, 2], [1.5, 1.5, 2], [0, 1.5, 2]])
    distances = np.linalg.norm(flown[:, None] - corners, axis=2).min(axis=0)
    assert distances.max() < 0.05
    assert np.linalg.norm(flown - [2.0, -0.5, 2.0], axis=1).min() < 0.02
    assert flown[-1] == pytest.approx([2.0, -0.5, 0.0], abs=0.02)
    assert max(pilot.throttles[-50:]) < 0.01  # idles again


def _place(odometry: Odometry) -> list[float]:
    position = odometry.pose.pose.position
    return [position.x, position.y, position.z]
