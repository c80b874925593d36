"""Gates that move during a race over DDS: the reference follows them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.processes import node_of, stopped
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion
from rclpy.qos import qos_profile_sensor_data
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quad_mpc_ros.extras.racing.gate_passages import passages
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.messages.cdr import header_stamp_ns
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory

GATES = [
    {"position": [4.0, 0.0, 1.5], "yaw": 0.0, "width": 1.2, "height": 1.2},
    {"position": [8.0, 1.0, 1.5], "yaw": 0.0, "width": 1.2, "height": 1.2},
    {"position": [12.0, 0.0, 1.5], "tolerance": 0.4},
]
COURSE = str({"start": [0.0, 0.0, 1.5], "gates": GATES, "end": [15.0, 0.0, 1.5]})
MOVED = np.array([[4.0, 0.0, 1.5], [8.0, 2.5, 1.5], [12.0, 0.0, 1.5]])
SPEED = 4.0  # m/s
MOVED_AT = 1.0  # s
MATCHING = 1.0  # s, for a reader to know the writer that knows it


def poses(p_WG: Any, *, frame_id: str = "odom") -> PoseArray:
    message = PoseArray()
    message.header.frame_id = frame_id
    level = Quaternion(w=1.0)
    message.poses = [
        Pose(position=Point(x=x, y=y, z=z), orientation=level) for x, y, z in np.array(p_WG)
    ]
    return message


def test_a_gate_moved_in_flight_is_passed_where_it_is(peer: Any, tmp_path: Path) -> None:
    """The gate moves by 1.5 m, with an opening of 1.2 m: the old plan misses it."""
    gates = peer.node.create_publisher(PoseArray, "gates", 10)
    stamps: list[int] = []
    reference = peer.node.create_subscription(
        MultiDOFJointTrajectory,
        "reference",
        lambda data: stamps.append(header_stamp_ns(data)),
        qos_profile_sensor_data,
        raw=True,
    )
    out, limits = tmp_path / "run", ("max_speed", "max_acceleration")
    given = [each for name in limits for each in ("--set", f"reference.{name}={SPEED}")]
    command = [sys.executable, "-m", "quad_mpc_ros.cli", "fly", "--lockstep", "--gates", COURSE]
    command += [*given, "--duration", "8", "--out", str(out)]

    def listeners() -> set[str]:
        return {each.node_name for each in peer.node.get_subscriptions_info_by_topic("gates")}

    with subprocess.Popen(command, cwd=tmp_path) as flight:
        # The flight takes a second: it stands still while its nodes and the test find each other.
        assert peer.wait(lambda: node_of(flight.pid, "simulator_node"))
        simulator = node_of(flight.pid, "simulator_node")
        assert simulator is not None
        with stopped(simulator):
            assert peer.wait(lambda: "reference" in listeners(), timeout=100.0)
            assert peer.wait(reference.get_publisher_count)
            peer.spin(MATCHING)
        assert peer.wait(lambda: stamps and stamps[-1] - stamps[0] > MOVED_AT * 1e9, timeout=100.0)
        with stopped(simulator):
            gates.publish(poses(MOVED))
            peer.deliver(gates)
        assert peer.wait(lambda: flight.poll() is not None, timeout=300.0)
    summary = json.loads((out / "summary.json").read_text())
    assert [gate["passed"] for gate in summary["gates"]] == [True, True, True]
    assert summary["gates"][1]["miss_m"] < 0.4
    log = (out / "log" / "reference.log").read_text()
    assert "race accepted: replanned: gate 2 moved 1.50 m, joins at " in log
    config = ReferenceConfig(
        trajectory="gates", gates=COURSE, max_speed=SPEED, max_acceleration=SPEED
    )
    trajectory = configured_trajectory(config)
    times = list(range(0, trajectory.period_ns, 5_000_000))
    there = read_course(COURSE).moved(MOVED, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))
    before = trajectory.at(times).p_WB
    assert passages(there, seconds=1e-9 * np.array(times), p_WB=before).missed == 1


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (poses(MOVED, frame_id="moon"), "gates are in frame 'moon', expected 'odom'"),
        (poses(MOVED), "given 3 poses, expected those of all 9 gates"),
        (poses(np.full((9, 3), np.nan)), "expected finite numbers and a unit quaternion"),
    ],
)
def test_refuses_invalid_gates_once(
    start: Callable[..., Any], peer: Any, tmp_path: Path, message: PoseArray, reason: str
) -> None:
    gates = peer.node.create_publisher(PoseArray, "gates", 10)
    start("reference", "-p", "trajectory:=gates", "-p", "gates:=seven_gates")
    log = tmp_path / "reference.log"

    def is_logged() -> bool:
        gates.publish(message)
        return reason in log.read_text()

    assert peer.wait(is_logged)
    peer.spin(0.5)
    assert log.read_text().count(reason) == 1
    assert "Traceback" not in log.read_text()
