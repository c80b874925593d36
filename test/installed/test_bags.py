# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Play and record bags with the real rosbag2, and resolve them bit for bit."""

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
from fixtures.bag_payloads import payloads
from fixtures.faults import distortions
from fixtures.installed_ros import environment, running, wait_for
from fixtures.relay import PREFIX, Relay, odometry_relay, reference_relay
from fixtures.setup_py import executable
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

from quad_mpc_ros.cli import main
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.messages.cdr import header_stamp_ns as stamp_of
from quad_mpc_ros.messages.topics import COMMAND, ODOMETRY, REFERENCE
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.recordings.run import RecordedRun
from quad_mpc_ros.recordings.writer import BagWriter
from quad_mpc_ros.ros.messages import message_class, qos_of

pytestmark = pytest.mark.timeout(400)  # of a busy machine

TRIALS = 5
ENOUGH = 0.5 * MpcConfig().deadline_seconds  # s
STEPPER = Path(__file__).parents[1] / "fixtures" / "step_player.py"
PLAYED = ("/odom", "/reference")
RELAYED = (f"/{PREFIX}odom", f"/{PREFIX}reference")


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

    def spin(self, seconds: float) -> None:
        self.wait(lambda: False, seconds=seconds)

    def wait(
        self,
        condition: Callable[[], Any],
        *,
        seconds: float = 60.0,
    ) -> bool:
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.005)
        return True

    def end_nodes(self) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes.clear()

    def end(self) -> None:
        self.end_nodes()
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
    given = ("--reference", "lemniscate", "--start", "reference", "--duration", "2")
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
    ("lockstep", "bag"),
    [("true", "flown"), ("false", "flown_in_order")],
    ids=["lockstep", "real_time"],
)
def test_the_mpc_answers_a_played_bag_with_the_recorded_commands(
    lockstep: str, bag: str, request: pytest.FixtureRequest, flight: Flight, tmp_path: Path
) -> None:
    """Lockstep pairs by stamps, real time by arrival on the clock of the player.

    Played message by message: of best-effort messages a busy node keeps only the newest.
    """
    played = request.getfixturevalue(bag)
    flight.start("mpc_node", "-p", "use_sim_time:=true", "-p", f"lockstep:={lockstep}")
    options = ("--start-paused", "--disable-keyboard-controls", "--clock-topics-all")
    command = ("bag", "play", str(played), *options, "--topics", *PLAYED)
    count = sum(1 for _ in BagReader(played).messages(PLAYED))
    with running(*command, folder=tmp_path):
        answers = [bytes.fromhex(line) for line in stepped(count)]
    expected = payloads(request.getfixturevalue("flown"))
    assert len(expected) == 100
    assert [stamp_of(each) for each in answers] == [stamp_of(each) for each in expected]
    assert answers == expected


def stepped(count: int) -> list[str]:
    """Step the player, and return the commands that the MPC answered, a line each."""
    env = environment()
    path = ":".join(filter(None, [str(STEPPER.parents[1]), env.get("PYTHONPATH", "")]))
    completed = subprocess.run(
        ["python3", "-P", str(STEPPER), str(count)],
        env={**env, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=300,
    )
    return completed.stdout.split()


FLIGHT = {
    "reference": {"trajectory": "lemniscate", "angular_frequency": 0.6},
    "mpc": {"estimate_disturbance": True},
    "simulator": {"duration": 0.0, "mass_scale": 1.1},
}
"""Of the nodes, by parameter."""


def test_resolves_recordings_of_ros2_bag_with_faults_bit_for_bit(
    flight: Flight, tmp_path: Path
) -> None:
    """Refused and missing odometries, a missing reference, and parameters set in flight."""
    config = tmp_path / "flight.yaml"
    config.write_text(
        yaml.safe_dump({f"/**/{n}": {"ros__parameters": p} for n, p in FLIGHT.items()})
    )
    relays = odometry_relay(flight.node), reference_relay(flight.node)
    for trial in range(TRIALS):
        bag = tmp_path / f"bag_{trial}"
        record_flight(flight, relays, config=config, bag=bag)
        run = Recording(bag).run({ODOMETRY: RELAYED[0], REFERENCE: RELAYED[1]})
        if is_whole(run) and not is_hurried(run):
            break
    assert is_whole(run)
    if is_hurried(run):
        pytest.skip("this machine is too busy: it cut a plan short in every flight")
    assert run.stats[-1].value.rejected_inputs > 20
    assert {each.value.source for each in run.stats} >= {"mpc", "plan", "blind"}
    assert len(run.changes) == 5

    out = tmp_path / "resolved"
    named = ("--odom-topic", RELAYED[0], "--reference-topic", RELAYED[1])
    assert main(["resolve", str(bag), "--config", str(config), *named, "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["compared"] > 200
    assert summary["equal"] == summary["compared"], summary["difference"]
    assert summary["only_recorded"] == summary["only_resolved"] == 0


def is_whole(run: RecordedRun) -> bool:
    """Whether the recorder lost none of the commands, nor of the odometries answered by a plan."""
    odometries = {each.value.stamp_ns for each in run.odometries}
    # Of what was seen: what is foreseen gives a reason.
    stats = [each.value for each in run.stats]
    planned = {s.stamp_ns for s in stats if s.source == "mpc" and not s.reason}
    return len(run.commands) == run.stats[-1].value.commands and planned <= odometries


def is_hurried(run: RecordedRun) -> bool:
    """Whether a plan took so long that the solver stopped early."""
    return any(each.value.step_time_us > 1e6 * ENOUGH for each in run.stats)


def record_flight(
    flight: Flight, relays: tuple[Relay[Any], Relay[Any]], *, config: Path, bag: Path
) -> None:
    given = ("--params-file", str(config))
    odometry, reference = relays
    answered: set[int] = set()
    subscription = flight.node.create_subscription(
        message_class(COMMAND.type_name),
        COMMAND.name,
        lambda command: answered.add(stamp_of(command)),
        qos_of(COMMAND),
        raw=True,
    )
    relayed = ("-r", f"odom:={RELAYED[0]}", "-r", f"reference:={RELAYED[1]}")
    flight.start("mpc_node", *given, *relayed)
    topics = (*RELAYED, "/command", "/mpc/stats", "/parameter_events")
    command = ("bag", "record", "--output", str(bag), "--topics", *topics)
    with running(*command, folder=bag.parent) as recorder:
        wait_for(
            lambda: all(f"Subscribed to topic '{topic}'" in recorder.text for topic in topics),
            what="recording",
            while_running=recorder,
        )
        flight.spin(0.5)  # until the publishers know of it as well
        flight.start("reference_node", *given)
        flight.start("simulator_node", *given)
        # Flying by what it sees; what it commands blindly has other stamps.
        assert flight.wait(lambda: len(answered & odometry.passed_ns) > 50)
        fly_with_faults(flight, odometry, reference)
        recorder.interrupt_all()
        recorder.ends()
    flight.end_nodes()
    flight.node.destroy_subscription(subscription)


def fly_with_faults(flight: Flight, odometry: Relay[Any], reference: Relay[Any]) -> None:
    client = flight.node.create_client(SetParametersAtomically, "mpc/set_parameters_atomically")
    assert flight.wait(client.service_is_ready)

    def set_parameters(**values: object) -> None:
        request = SetParametersAtomically.Request()
        request.parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        answer = client.call_async(request)
        assert flight.wait(answer.done)
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
