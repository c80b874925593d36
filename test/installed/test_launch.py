# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The launch files with the real ``ros2 launch``: start and shutdown."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
import rclpy
from fixtures.installed_ros import Running, importable, running, wait_for
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from rcl_interfaces.srv import GetParameters
from rosbags.highlevel import AnyReader

pytestmark = pytest.mark.timeout(400)  # of a busy machine

# Bridge and a message or service that it needs; Betaflight's wants a serial port.
BRIDGES = {
    "rates": "geometry_msgs.msg.TwistStamped",
    "px4": "px4_msgs.msg.VehicleOdometry",
    "mavros": "mavros_msgs.msg.AttitudeTarget",
    "rosflight": "roscopter_msgs.msg.State",
    "aerostack2": "as2_msgs.msg.Thrust",
    "crazyswarm2": "crazyflie_interfaces.srv.NotifySetpointsStop",
}
FLOWN = ("odom", "command")
ENOUGH = 20  # of each in a bag


@pytest.fixture
def nodes() -> Iterator[rclpy.node.Node]:
    """Yield a node that sees which others there are."""
    rclpy.init()
    node = rclpy.create_node("watcher")
    yield node
    node.destroy_node()
    rclpy.shutdown()


def names(node: rclpy.node.Node) -> set[str]:
    return {f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()}


def is_spinning(node: rclpy.node.Node, name: str) -> bool:
    """Whether another node answers; it is discovered earlier, while it still starts."""
    client = node.create_client(GetParameters, f"{name}/get_parameters")
    try:
        if not client.wait_for_service(0.1):
            return False
        future = client.call_async(GetParameters.Request())
        rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
        return future.done()
    finally:
        node.destroy_client(client)


def bags(folder: Path) -> list[Path]:
    return sorted(path.parent for path in folder.glob("rosbag2_*/*.mcap"))


def is_recording(folder: Path, count: int) -> bool:
    """Whether that many bags have enough messages, read while they are written."""
    written = [least_recorded(path) for path in folder.glob("rosbag2_*/*.mcap")]
    return len(written) == count and min(written) > ENOUGH


def least_recorded(unfinished: Path) -> int:
    """Return how many messages are there of that topic of FLOWN that has the fewest."""
    topics: dict[int, str] = {}
    found = dict.fromkeys(FLOWN, 0)
    with unfinished.open("rb") as stream, suppress(McapError):  # at its present end
        for record in StreamReader(stream).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic.rpartition("/")[2]
            elif isinstance(record, Message) and topics[record.channel_id] in FLOWN:
                found[topics[record.channel_id]] += 1
    return min(found.values())


def assert_all_ended_whole(launched: Running) -> None:
    """Every process has ended by itself, none with an error."""
    pids, text = launched.pids, launched.text
    assert pids
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert text.count("process has finished cleanly") == len(pids), text
    assert "Traceback" not in text, text
    assert "SIGKILL" not in text, text


def recorded_topics(bag: Path) -> dict[str, int]:
    """Return the number of messages by topic, as another reader finds them."""
    assert (bag / "metadata.yaml").is_file()
    with AnyReader([bag]) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count
        return {topic: info.msgcount for topic, info in reader.topics.items()}


def test_the_square_in_lockstep_ends_with_its_simulator(tmp_path: Path) -> None:
    arguments = ("lockstep:=true", "duration:=2.0", "record:=false", "visualise:=true")
    with running("launch", "quad_mpc_ros", "square.launch.py", *arguments, folder=tmp_path) as run:
        assert run.ends() == 0, run.text
        assert len(run.pids) == 4
        assert_all_ended_whole(run)
        assert "the MPC flies" in run.text


def test_one_interrupt_ends_the_square_with_a_complete_bag(tmp_path: Path) -> None:
    arguments = ("square.launch.py", "namespace:=uav1")
    with running("launch", "quad_mpc_ros", *arguments, folder=tmp_path) as run:
        wait_for(lambda: is_recording(tmp_path, 1), what="recorded", while_running=run)
        run.interrupt()
        run.ends()
        assert_all_ended_whole(run)
    (bag,) = bags(tmp_path)
    topics = recorded_topics(bag)
    assert topics["/uav1/command"] > 10
    assert topics["/uav1/odom"] > 10


def test_two_interrupts_end_two_vehicles_with_complete_bags(tmp_path: Path) -> None:
    arguments = ("fleet.launch.py", "vehicles:=2", "record:=true")
    with running("launch", "quad_mpc_ros", *arguments, folder=tmp_path) as run:
        wait_for(lambda: is_recording(tmp_path, 2), what="recorded", while_running=run)
        run.interrupt_all()
        time.sleep(0.1)
        run.interrupt_all()
        run.ends()
        assert len(run.pids) == 6  # simulator, recorder, and mpc with reference
        assert_all_ended_whole(run)
    found = {"uav1": 0, "uav2": 0}
    for bag in bags(tmp_path):
        topics = recorded_topics(bag)
        (vehicle,) = (name for name in found if f"/{name}/command" in topics)
        found[vehicle] = topics[f"/{vehicle}/command"]
        others = found.keys() - {vehicle}
        assert not any(topic.startswith(f"/{other}/") for topic in topics for other in others)
    assert min(found.values()) > 10


def test_controller_and_bridges_start_in_namespaces_and_end(
    tmp_path: Path, nodes: rclpy.node.Node
) -> None:
    """Every launch file for a stack, at once: ``mpc.launch.py`` and each bridge that can be."""
    starting = {"alone": ("mpc.launch.py", "odom:=/elsewhere")}
    for bridge, needed in BRIDGES.items():
        if importable(needed):
            starting[bridge] = ("bridge.launch.py", f"bridge:={bridge}", "with_reference:=false")
    with ExitStack() as stack:
        launched = {}
        for space, arguments in starting.items():
            command = ("launch", "quad_mpc_ros", *arguments, f"namespace:={space}")
            log = f"{space}.log"
            launched[space] = stack.enter_context(running(*command, folder=tmp_path, log=log))
        for space, run in launched.items():
            beside = "reference" if space == "alone" else f"{space}_bridge"
            expected = {f"/{space}/mpc", f"/{space}/{beside}"}
            wait_for(
                lambda expected=expected: (
                    expected <= names(nodes) and all(is_spinning(nodes, name) for name in expected)
                ),
                what=f"spinning: {expected}",
                while_running=run,
            )
            assert len(run.pids) == (2 if space == "alone" else 1)
        wait_for(
            lambda: nodes.count_subscribers("/elsewhere") == 2,
            what="subscribed to: /elsewhere, by two",
            while_running=launched["alone"],
        )
        for run in launched.values():
            run.interrupt()
        for run in launched.values():
            run.ends()
            assert_all_ended_whole(run)


@pytest.mark.parametrize("file", ["square", "fleet", "mpc", "stack", "bridge"])
def test_missing_parameter_file_starts_no_node(file: str, tmp_path: Path) -> None:
    (tmp_path / "my_vehicle.yaml").write_text("/**: {ros__parameters: {mass: 0.5}}\n")
    bridge = ("bridge:=rates",) if file == "bridge" else ()
    arguments = (f"{file}.launch.py", "config:=my_vehcle.yaml", *bridge)
    with running("launch", "quad_mpc_ros", *arguments, folder=tmp_path) as run:
        assert run.ends() == 1
        assert not run.pids
        message = (
            "config: given 'my_vehcle.yaml', which does not exist, expected the path of a ROS "
        )
        assert f"{message}parameter file (did you mean my_vehicle.yaml?)" in run.text
