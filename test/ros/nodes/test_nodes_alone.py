"""Each node by itself, as ``ros2 run`` starts it."""

from __future__ import annotations

import signal
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fixtures.processes import PATIENCE
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rosbags.highlevel import AnyReader
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import cdr, conversions, diagnostics

Start = Callable[..., "subprocess.Popen[bytes]"]

NODES = ["simulator", "reference", "mpc", "recorder"]
BAD_PARAMETERS = {
    "simulator": ("mass_scale:=0.0", "simulator.mass_scale: given 0.0, expected a number > 0"),
    "reference": ("side:=-1.0", "reference.side: given -1.0, expected a number > 0"),
    "mpc": ("Q:=[1.0]", "mpc.Q: given [1.0], expected 9 numbers >= 0"),
    "recorder": ("colour:=red", "recorder.colour: given 'red', expected a known parameter"),
}


def _arguments(node: str, tmp_path: Path) -> list[str]:
    return ["-p", f"directory:={tmp_path / 'bag'}"] if node == "recorder" else []


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ends_cleanly_on_a_signal(
    node: str, number: int, start: Start, peer: Any, tmp_path: Path
) -> None:
    received: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    process = start(node, *_arguments(node, tmp_path))
    # Not when it is on the graph, where one of the same name that was killed may still be.
    assert peer.wait(lambda: received)

    process.send_signal(number)

    assert process.wait(PATIENCE) == 0
    assert "Traceback" not in (tmp_path / f"{node}.log").read_text()


@pytest.mark.parametrize("node", ["mpc", "reference", "simulator", "recorder"])
def test_ends_cleanly_in_the_middle_of_a_flight(
    node: str, start: Start, peer: Any, tmp_path: Path
) -> None:
    names = ("simulator", "reference", "recorder", "mpc")
    processes = {name: start(name, *_arguments(name, tmp_path)) for name in names}
    logs = {name: tmp_path / f"{name}.log" for name in names}
    assert peer.wait(lambda: "the MPC flies" in logs["mpc"].read_text())
    assert peer.wait(lambda: "active" in logs["recorder"].read_text().split())

    processes[node].send_signal(signal.SIGINT)

    assert processes[node].wait(PATIENCE) == 0
    log = logs[node].read_text()
    assert "Traceback" not in log
    assert "FATAL" not in log


def test_warns_of_two_odometry_sources_and_zero_lags(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    received: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    rivals = [
        peer.node.create_publisher(Odometry, "odom", qos_profile_sensor_data) for _ in range(2)
    ]
    lags = ("-p", "input_delay:=0.0", "-p", "rate_time_constant:=0.03")
    start("mpc", *lags, "-p", "envelope.tilt_max:=0.5")

    def warned() -> bool:
        return bool(received) and received[-1].status[0].message.startswith(
            "2 publishers on odom,"
        )

    assert peer.wait(warned)
    assert received[-1].status[0].level == DiagnosticStatus.WARN
    peer.node.destroy_publisher(rivals[1])
    assert peer.wait(lambda: not warned())
    log = (tmp_path / "mpc.log").read_text()
    assert log.count("input_delay = 0: every real vehicle lags") == 1
    assert log.count("limits.tilt_max allows 0.61 rad in the plan, envelope.tilt_max is 0.5") == 1


@pytest.mark.parametrize("node", NODES)
def test_bad_parameter_is_one_line_and_exit_code_2(
    node: str, start: Start, tmp_path: Path
) -> None:
    argument, reason = BAD_PARAMETERS[node]

    process = start(node, "-p", argument)

    assert process.wait(PATIENCE) == 2
    (line,) = (tmp_path / f"{node}.log").read_text().strip().splitlines()
    assert line.startswith(f"error: {reason}")
    assert not (tmp_path / "bag").exists()


def test_recorder_refuses_a_folder_that_exists(start: Start, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    process = start("recorder", "-p", f"directory:={tmp_path / 'bag'}")
    assert process.wait(PATIENCE) == 2
    assert str(tmp_path / "bag") in (tmp_path / "recorder.log").read_text()


def test_simulator_publishes_odometry_in_its_namespace_and_remapped(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text(
        "/uav1/simulator:\n  ros__parameters:\n"
        "    initial_position: [1, 2, 3]\n    odom_rate: 100\n    frame_id: map\n"
    )
    received: list[Odometry] = []
    peer.node.create_subscription(
        Odometry, "/uav1/truth", received.append, qos_profile_sensor_data
    )

    start("simulator", "--params-file", str(parameters), "-r", "__ns:=/uav1", "-r", "odom:=truth")

    assert peer.wait(lambda: len(received) > 20)
    assert received[0].header.frame_id == "map"
    assert received[0].pose.pose.position.x == 1.0
    stamps = np.array([conversions.nanoseconds(m.header.stamp) for m in received])
    assert np.median(np.diff(stamps)) == pytest.approx(10e6, rel=0.3)


def test_simulator_flies_the_command(start: Start, peer: Any) -> None:
    """Full throttle climbs; nose down, a positive rate about y, then accelerates forward."""
    received: list[Odometry] = []
    peer.node.create_subscription(Odometry, "odom", received.append, qos_profile_sensor_data)
    publisher = peer.node.create_publisher(TwistStamped, "command", qos_profile_sensor_data)
    start("simulator")
    assert peer.wait(lambda: received and publisher.get_subscription_count())
    assert received[-1].pose.pose.position.z == 0.0

    command = TwistStamped()
    command.twist.linear.z, command.twist.angular.y = 1.0, 1.0
    for _ in range(20):
        publisher.publish(command)
        peer.spin(0.02)

    assert received[-1].pose.pose.position.z > 0.5
    assert received[-1].pose.pose.position.x > 0.05
    assert abs(received[-1].pose.pose.position.y) < 1e-9


def test_reference_publishes_alone_and_latches_its_path(start: Start, peer: Any) -> None:
    windows: list[MultiDOFJointTrajectory] = []
    paths: list[PathMessage] = []
    start("reference", "-p", "side:=3")
    assert peer.wait(lambda: "reference" in peer.node.get_node_names())
    peer.spin(0.5)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(MultiDOFJointTrajectory, "reference", windows.append, 10)
    peer.node.create_subscription(PathMessage, "reference/path", paths.append, latched)

    assert peer.wait(lambda: len(windows) > 5 and paths)
    translation = windows[-1].points[0].transforms[0].translation
    assert (translation.x, translation.y, translation.z) == (0.0, 0.0, 2.0)
    corners = {(p.pose.position.x, p.pose.position.y) for p in paths[0].poses}
    assert corners == {(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)}


class Stack:
    """A stand-in for a drone stack around the MPC node: odometry and reference out."""

    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self.commands: list[TwistStamped] = []
        self.stats: list[dict[str, str]] = []
        node = peer.node
        node.create_subscription(
            TwistStamped, "command", self.commands.append, qos_profile_sensor_data
        )
        node.create_subscription(
            DiagnosticArray,
            "mpc/stats",
            lambda m: self.stats.append(diagnostics.stats_from_message(m)),
            10,
        )
        self._odometry = node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self._reference = node.create_publisher(MultiDOFJointTrajectory, "reference", 10)

    def await_node(self) -> None:
        assert self._peer.wait(
            lambda: (
                self._odometry.get_subscription_count()
                and self._reference.get_subscription_count()
                and self._peer.node.count_publishers("command")
            )
        )
        self._peer.spin(0.3)

    def fly(self) -> None:
        """Tick until the MPC has commanded some times."""

        def flies() -> bool:
            self.tick()
            return len(self.commands) >= 5 and bool(self.stats)

        assert self._peer.wait(flies)

    def tick(self, **changes: Any) -> None:
        """Send a reference at 2 m and an odometry hovering at the origin, with changes."""
        stamp_ns = int(self._peer.node.get_clock().now().nanoseconds)
        held = np.array([[0.0, 0.0, 2.0]] * 2)
        window = ReferenceWindow(
            stamp_ns=stamp_ns,
            offset_ns=np.array([0, 10**9]),
            p_WB=held,
            q_WB_xyzw=np.array([[0.0, 0.0, 0.0, 1.0]] * 2),
            v_WB_W=0.0 * held,
            a_WB_W=0.0 * held,
            w_WB_W=0.0 * held,
        )
        self._reference.publish(cdr.written_reference(window, child_frame_id="b"))
        values = {
            "stamp_ns": stamp_ns,
            "p_WB": np.zeros(3),
            "q_WB_xyzw": np.array([0.0, 0.0, 0.0, 1.0]),
            "v_WB_B": np.zeros(3),
            "w_WB_B": np.zeros(3),
            **changes,
        }
        odometry = Odometry()
        conversions.fill_odometry(odometry, OdometrySample(**values))
        self._peer.spin(0.005)
        self._odometry.publish(odometry)
        self._peer.spin(0.02)


def test_mpc_climbs_towards_a_reference_above(start: Start, peer: Any) -> None:
    stack = Stack(peer)
    start("mpc")
    stack.await_node()
    stack.fly()
    for _ in range(20):
        stack.tick()
    last = stack.commands[-1].twist
    assert last.linear.z > 0.6
    assert max(abs(last.angular.x), abs(last.angular.y), abs(last.angular.z)) < 0.1
    assert stack.stats[-1]["source"] == "mpc"
    assert stack.stats[-1]["solver_status"] == "solved"


@pytest.mark.parametrize("field", ["p_WB", "q_WB_xyzw"])
def test_nan_odometry_never_reaches_the_solver(field: str, start: Start, peer: Any) -> None:
    stack = Stack(peer)
    # Odometry that rests contradicts the thrust that it is given.
    start("mpc", "-p", "consistency.action:=warn")
    stack.await_node()
    stack.fly()
    solved = int(stack.stats[-1]["commands"])
    size = 4 if field == "q_WB_xyzw" else 3
    for _ in range(30):
        stack.tick(**{field: np.full(size, np.nan)})
    assert peer.wait(lambda: int(stack.stats[-1]["rejected_inputs"]) >= 10)
    assert peer.wait(lambda: any(each["source"] == "blind" for each in stack.stats))
    assert not [each for each in stack.stats if "not finite" in each["solver_status"]]
    for _ in range(20):
        stack.tick()
    assert peer.wait(lambda: stack.stats[-1]["source"] == "mpc"), "did not recover"
    assert int(stack.stats[-1]["commands"]) > solved
    values = [
        (c.twist.linear.z, c.twist.angular.x, c.twist.angular.y, c.twist.angular.z)
        for c in stack.commands
    ]
    assert np.isfinite(values).all()


def test_mpc_falls_silent_after_the_blind_time(start: Start, peer: Any) -> None:
    stack = Stack(peer)
    start("mpc", "-p", "blind_time:=0.3")
    stack.await_node()
    stack.fly()
    assert peer.wait(lambda: stack.stats[-1]["source"] == "silent")
    assert [s["source"] for s in stack.stats if s["source"] == "blind"]
    count = len(stack.commands)
    peer.spin(0.5)
    assert len(stack.commands) == count


def test_weights_change_in_flight_and_structure_does_not(start: Start, peer: Any) -> None:
    stack = Stack(peer)
    start("mpc")
    stack.await_node()
    stack.fly()
    client = peer.node.create_client(SetParameters, "mpc/set_parameters")

    def set_parameter(name: str, value: Any) -> Any:
        request = SetParameters.Request()
        request.parameters = [Parameter(name, value=value).to_parameter_msg()]
        return peer.call(client, request).results[0]

    assert set_parameter("throttle_max", 0.6).successful
    refused = set_parameter("R", [0.0, 1.0, 1.0, -1.0])
    assert not refused.successful
    assert "mpc.R" in refused.reason
    assert not set_parameter("horizon_steps", 20).successful

    for _ in range(10):
        stack.tick()
    assert stack.commands[-1].twist.linear.z == pytest.approx(0.6, abs=0.01)
    assert stack.stats[-1]["source"] == "mpc"


def test_bounds_that_only_fit_together_change_together(start: Start, peer: Any) -> None:
    start("mpc")
    client = peer.node.create_client(SetParametersAtomically, "mpc/set_parameters_atomically")
    request = SetParametersAtomically.Request()
    request.parameters = [
        Parameter("throttle_min", value=0.1).to_parameter_msg(),
        Parameter("throttle_max", value=0.2).to_parameter_msg(),
    ]
    result = peer.call(client, request).result
    assert not result.successful
    assert "hover throttle" in result.reason


def test_reports_incompatible_publisher(start: Start, peer: Any, tmp_path: Path) -> None:
    """The reference needs a reliable publisher, the odometry does not."""
    peer.node.create_publisher(MultiDOFJointTrajectory, "reference", qos_profile_sensor_data)
    reliable = peer.node.create_publisher(Odometry, "odom", 10)
    start("mpc")
    log = tmp_path / "mpc.log"
    assert peer.wait(lambda: "quality of service" in log.read_text())
    assert peer.wait(reliable.get_subscription_count)
    lines = [line for line in log.read_text().splitlines() if "quality of service" in line]
    assert len(lines) == 1
    assert "reference: " in lines[0]


def test_recorder_subscribes_before_a_topic_has_a_publisher(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    start("recorder", "-p", f"directory:={tmp_path / 'bag'}", "-p", "topics:=[odom, imu]")
    expected = "/odom", "/imu"
    assert peer.wait(lambda: all(map(peer.node.count_subscribers, expected)))
    assert not any(map(peer.node.count_publishers, expected))


def test_recorder_records_what_appears_later(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    process = start("recorder", "-p", f"directory:={bag}", "-p", "topics:=[odom, /other/odom]")
    recorder = managed("recorder")
    assert recorder.reports("active", "no publisher yet")
    publisher = peer.node.create_publisher(Odometry, "odom", 100)
    # A publisher matches a subscription before the subscription matches the publisher.
    assert peer.wait(lambda: recorder.health.get("peers./odom") == "1")
    for second in range(1, 31):
        message = Odometry()
        message.header.stamp.sec = second
        publisher.publish(message)
    peer.deliver(publisher)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 0

    with AnyReader([bag]) as reader:
        stamps = [
            reader.deserialize(data, connection.msgtype).header.stamp.sec
            for connection, _, data in reader.messages()
        ]
    assert stamps == list(range(1, 31))


def test_a_lockstep_flight_waits_for_a_stopped_recorder(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    flown: list[Odometry] = []
    peer.node.create_subscription(Odometry, "odom", flown.append, qos_profile_sensor_data)
    follows = ("-p", "lockstep:=true", "-p", "use_sim_time:=true")
    bag, log = tmp_path / "bag", tmp_path / "simulator.log"
    recorder = start("recorder", "-p", f"directory:={bag}", "-p", "use_sim_time:=true")
    start("mpc", *follows)
    start("reference", *follows)
    ends = ("-p", "duration:=8.0", "-p", "imu_rate:=200.0", "-p", "autostart:=false")
    simulator = start("simulator", "-p", "lockstep:=true", *ends)
    begin = peer.node.create_client(Trigger, "simulator/start")
    topics = ("odom", "imu", "reference", "command", "mpc/stats")
    matched = {f"peers./{topic}": "1" for topic in topics}
    reports: list[dict[str, str]] = [{}]
    peer.node.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda m: reports.extend(
            {each.key: each.value for each in status.values}
            for status in m.status
            if status.name == "/recorder"
        ),
        10,
    )
    assert peer.wait(lambda: matched.items() <= reports[-1].items())
    assert peer.call(begin, Trigger.Request()).success
    assert peer.wait(lambda: len(flown) > 50)

    recorder.send_signal(signal.SIGSTOP)
    assert peer.wait(
        lambda: "a subscriber of /odom" in log.read_text() or simulator.poll() is not None
    )
    recorder.send_signal(signal.SIGCONT)
    assert peer.wait(lambda: simulator.poll() == 0)
    # It ends with the last command, after which the MPC publishes its statistics.
    reports.clear()
    assert peer.wait(lambda: len(reports) > 2)
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(PATIENCE) == 0

    with AnyReader([bag]) as reader:  # an odometry is repeated if it is not answered in a second
        recorded = {(each.topic, data) for each, _, data in reader.messages()}
    counts = Counter(topic.removeprefix("/") for topic, _ in recorded)
    assert [counts[topic] for topic in topics] == [400, 4 * 399, 400, 400, 400]


def test_lockstep_without_a_controller_fails_loudly(start: Start, tmp_path: Path) -> None:
    process = start("simulator", "-p", "lockstep:=true", "-p", "advanced.lockstep_timeout:=1.0")
    assert process.wait(PATIENCE) == 1
    log = (tmp_path / "simulator.log").read_text()
    assert "no command for the odometry" in log
    assert "lockstep_timeout" in log


def test_lockstep_waits_for_compiling_node(start: Start, peer: Any, tmp_path: Path) -> None:
    compiling = rclpy.create_node("mpc")
    process = start("simulator", "-p", "lockstep:=true", "-p", "advanced.lockstep_timeout:=3.0")

    def log() -> str:
        return (tmp_path / "simulator.log").read_text()

    # It logs that every 5 s, which is longer than the timeout.
    assert peer.wait(lambda: log().count("waiting for mpc") == 2)
    assert process.poll() is None
    compiling.destroy_node()
    assert process.wait(PATIENCE) == 1
    assert "lockstep_timeout" in log()
