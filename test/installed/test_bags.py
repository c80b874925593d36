"""Bags between this package and the real rosbag2: played, recorded, resolved bit for bit."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from fixtures.installed_ros import running, wait_for
from fixtures.setup_py import executable
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.soak.relay import PREFIX, Relay, odometry_relay, reference_relay
from quad_mpc_ros.faults import distortions
from quad_mpc_ros.messages.topics import ODOMETRY, REFERENCE
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.recordings.run import TopicNames
from quad_mpc_ros.recordings.writer import BagWriter

MANY = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def commands_in(bag: Path, topic: str = "/command") -> list[bytes]:
    with AnyReader([bag]) as reader:
        connections = [each for each in reader.connections if each.topic == topic]
        return [bytes(data) for _, _, data in reader.messages(connections)]


class Flight:
    """A node of the test's, and nodes of the package as processes that end with the test."""

    def __init__(self, folder: Path) -> None:
        rclpy.init()
        self.node = rclpy.create_node("flight")
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []

    def start(self, name: str, *arguments: str) -> None:
        command = [*executable(name), "--ros-args", *arguments]
        with (self._folder / f"{name}.log").open("wb") as log:
            self._processes.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT))

    def spin(self, seconds: float, *, each: Callable[[], None] = lambda: None) -> None:
        self.wait(lambda: False, seconds=seconds, each=each)

    def wait(
        self,
        condition: Callable[[], Any],
        *,
        seconds: float = 60.0,
        each: Callable[[], None] = lambda: None,
    ) -> bool:
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.005)
            each()
        return True

    def end(self) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.node.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Flight]:
    made = Flight(tmp_path)
    yield made
    made.end()


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("flown") / "run"
    given = ("--reference", "lemniscate", "--start", "reference", "--duration", "3")
    assert main(["simulate", *given, "--out", str(out)]) == 0
    return out / "bag"


@pytest.fixture(scope="module")
def flown_in_order(flown: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag with each reference 10 ms before its odometry, as a flight would have it."""
    bag = tmp_path_factory.mktemp("in_order") / "bag"
    with BagWriter(bag) as writer:
        for topic in (ODOMETRY, REFERENCE):
            writer.add_topic(f"/{topic.name}", topic.type_name)
        messages = [
            (each.log_time_ns - 10_000_000 * (each.topic == "/reference"), each.topic, each.data)
            for each in BagReader(flown).messages(["/odom", "/reference"])
        ]
        for time_ns, topic, data in sorted(messages, key=lambda each: each[0]):
            writer.write(topic, data, log_time_ns=time_ns, publish_time_ns=time_ns)
    return bag


@pytest.mark.parametrize(
    ("lockstep", "bag"), [("true", "flown"), ("false", "flown_in_order")], ids=["lockstep", "not"]
)
def test_a_bag_of_ours_that_is_played_is_answered_as_it_was(
    lockstep: str, bag: str, request: pytest.FixtureRequest, flight: Flight, tmp_path: Path
) -> None:
    """In lockstep by the stamps; in real time by what came when, on the clock of the player.

    Played slowly: of best-effort messages a busy node keeps only the newest.
    """
    expected = commands_in(request.getfixturevalue("flown"))
    answers: list[bytes] = []
    flight.node.create_subscription(TwistStamped, "command", answers.append, MANY, raw=True)
    flight.start("mpc_node", "-p", "use_sim_time:=true", "-p", f"lockstep:={lockstep}")
    assert flight.wait(lambda: flight.node.count_publishers("command"))
    clock = ("--clock", "500", "--rate", "0.3", "--delay", "3")
    command = ("bag", "play", str(request.getfixturevalue(bag)), *clock)
    with running(*command, "--topics", "/odom", "/reference", folder=tmp_path) as player:
        flight.wait(lambda: player.process.poll() is not None)
        flight.wait(lambda: len(answers) >= len(expected), seconds=2.0)
    assert len(answers) == len(expected) == 150
    assert [k for k, answer in enumerate(answers) if answer != expected[k]] == []


FLIGHT = {
    "reference": {"trajectory": "lemniscate", "angular_frequency": 0.6},
    "mpc": {"realtime.keep_awake": False},
    "simulator": {"duration": 0.0, "mass_scale": 1.1},
}
"""Of the nodes, by parameter."""


def test_what_ros2_bag_record_took_of_a_flight_with_faults_is_resolved_bit_for_bit(
    flight: Flight, tmp_path: Path
) -> None:
    """Refused and missing odometries, a missing reference, and parameters set in flight."""
    config = tmp_path / "flight.yaml"
    config.write_text(
        yaml.safe_dump({f"/**/{n}": {"ros__parameters": p} for n, p in FLIGHT.items()})
    )
    given = ("--params-file", str(config))
    odometry, reference = odometry_relay(flight.node), reference_relay(flight.node)
    relayed = ("-r", f"odom:=/{PREFIX}odom", "-r", f"reference:=/{PREFIX}reference")
    flight.start("mpc_node", *given, *relayed)
    topics = (f"/{PREFIX}odom", f"/{PREFIX}reference", "/command", "/mpc/stats")
    bag = tmp_path / "bag"
    command = ("bag", "record", "--output", str(bag), "--topics", *topics, "/parameter_events")
    with running(*command, folder=tmp_path) as recorder:
        wait_for(
            lambda: all(f"Subscribed to topic '{topic}'" in recorder.text for topic in topics),
            what="recording",
            while_running=recorder,
        )
        flight.start("reference_node", *given)
        flight.start("simulator_node", *given)
        assert flight.wait(lambda: len(odometry.passed) > 50)
        fly_with_faults(flight, odometry, reference)
        recorder.interrupt_all()
        recorder.ends()

    out = tmp_path / "resolved"
    named = ("--odom-topic", topics[0], "--reference-topic", topics[1])
    assert main(["resolve", str(bag), "--config", str(config), *named, "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["compared"] > 250
    assert summary["equal"] == summary["compared"], summary["difference"]
    assert summary["only_recorded"] == 0
    figures = Recording(bag).run(TopicNames(odometry=topics[0], reference=topics[1])).stats
    assert figures[-1].rejected_inputs > 20
    assert {each.source for each in figures} >= {"mpc", "plan", "blind"}


def fly_with_faults(flight: Flight, odometry: Relay[Any], reference: Relay[Any]) -> None:
    client = flight.node.create_client(SetParametersAtomically, "mpc/set_parameters_atomically")
    assert flight.wait(client.service_is_ready)

    def set_parameters(**values: object) -> None:
        request = SetParametersAtomically.Request()
        request.parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        answer = client.call_async(request)
        assert flight.wait(answer.done, each=odometry.release)
        assert answer.result().result.successful

    faults = (
        (odometry, distortions.changed(p_WB=distortions.not_a_number), 0.3),
        (odometry, distortions.shifted_in_time(5.0), 0.5),
        (odometry, distortions.dropping(0.3), 1.0),
        (reference, distortions.lost, 0.7),
        (odometry, distortions.lost, 0.5),
    )
    for number, (relay, fault, seconds) in enumerate(faults):
        relay.begin(fault)
        flight.spin(seconds)
        relay.end()
        set_parameters(R=[0.0, *[0.05 * (number + 1)] * 3], throttle_max=0.9 - 0.01 * number)
        flight.spin(0.5)
