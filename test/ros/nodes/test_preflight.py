# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc preflight`` beside running vehicles: one that is fit, and one with every fault."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.campaigns import wait_until
from fixtures.processes import end
from nav_msgs.msg import Odometry
from wrong_odometry import CONVENTIONS

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.observer import subscribe
from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.topics import ODOMETRY
from quad_mpc_ros.ros.messages import odometry_in, qos_of
from quad_mpc_ros.simulation.config import SimulatorConfig

Start = Callable[..., "subprocess.Popen[bytes]"]

WALLS = "{fence: {minimum: [-5.0, -5.0, -1.0], maximum: [5.0, 5.0, 5.0]}}"
VEHICLE = f"""
/**:
  ros__parameters: {{mass: 0.5, thrust_curve: [2.0, 3.0, 0.0]}}
/**/mpc:
  ros__parameters: {WALLS}
"""
# Another publisher of commands, and a subscriber with an incompatible QoS.
INTRUDER = textwrap.dedent("""
    import contextlib
    import rclpy
    from geometry_msgs.msg import TwistStamped
    from nav_msgs.msg import Odometry
    from rclpy.qos import qos_profile_sensor_data
    rclpy.init()
    node = rclpy.create_node("intruder", namespace="unfit")
    node.create_publisher(TwistStamped, "command", qos_profile_sensor_data)
    node.create_subscription(Odometry, "odom", lambda _: None, 10)  # reliable
    print("there", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(node)
""")


@pytest.fixture
def intruder() -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", INTRUDER], stdout=subprocess.PIPE)
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == b"there\n"
        yield
        end(process)


def preflight(
    capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[int, dict[str, list[tuple[str, str]]]]:
    """Return the exit code, and level and text of the lines of each check."""
    capsys.readouterr()
    code = main(["preflight", *arguments, "--timeout", "30"])
    found: dict[str, list[tuple[str, str]]] = {}
    for line in capsys.readouterr().out.splitlines():
        level, check, text = re.split(r"\s+", line, maxsplit=2)
        found.setdefault(check, []).append((level, text))
    return code, found


def errors(found: dict[str, list[tuple[str, str]]]) -> dict[str, str]:
    return {
        check: "; ".join(text for level, text in lines if level == "error")
        for check, lines in found.items()
        if any(level == "error" for level, _ in lines)
    }


def test_odometry_in_ned_is_an_error_in_log_diagnostics_and_preflight(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    odometry = peer.node.create_publisher(Odometry, "odom", qos_of(ODOMETRY))

    def relay(data: bytes) -> None:
        sample = CONVENTIONS["twist in FRD"](CONVENTIONS["position in NED"](odometry_in(data)))
        odometry.publish(cdr.written_odometry(sample))

    subscribe(peer.node, dataclasses.replace(ODOMETRY, name="true/odom"), relay, raw=True)
    hover = f"initial_throttle:={SimulatorConfig().vehicle().hover_throttle}"
    place = "initial_position:=[0.0, 0.0, 60.0]"
    start("reference", "-p", "trajectory:=hover")
    start("mpc")
    mpc, log = managed("mpc"), tmp_path / "mpc.log"
    assert mpc.reports("inactive", "no odometry yet")
    # Beside hovering exactly it does nothing until the first command.
    start("simulator", "-r", "odom:=true/odom", "-p", place, "-p", hover)

    cause = "odometry and commands disagree: "
    assert peer.wait(lambda: mpc.health.get("text", "").startswith(cause)), log.read_text()
    assert "NED" in mpc.health["text"]
    assert mpc.level == DiagnosticStatus.ERROR
    assert re.search(rf"\[ERROR\] .*blind takes over: {cause}.*NED", log.read_text())

    command = [sys.executable, "-P", "-m", "quad_mpc_ros.cli", "preflight", "--timeout", "30"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as flight_check:
        assert peer.wait(lambda: flight_check.poll() is not None)
        assert flight_check.stdout is not None
        lines = flight_check.stdout.read().splitlines()
    assert flight_check.returncode == 1
    assert [line for line in lines if line.startswith("error") and cause in line and "NED" in line]


def test_distinguishes_a_ready_vehicle_from_a_faulty_one(
    start: Start,
    intruder: None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text(VEHICLE)
    # As before a take-off: it stands on the ground.
    hover = ("-p", "trajectory:=hover", "-p", "height:=1.5", "-p", "mode:=on_request")
    fit = ("--params-file", str(file), "-r", "__ns:=/fit")
    start("simulator", *fit)
    start("reference", *fit, *hover)
    start("mpc", *fit)
    start("recorder", *fit, "-p", f"directory:={tmp_path / 'bag'}")
    unfit = ("--params-file", str(file), "-r", "__ns:=/unfit")
    start("simulator", *unfit, "-p", "frame_id:=map")
    start("reference", *unfit, *hover, "-p", "mass:=0.75", "-p", "height:=6.0")
    start("mpc", *unfit)

    # On a busy machine nodes start and find each other later.
    wait_until(
        lambda: not {"nodes", "topics"} & errors(preflight(capsys, "--namespace", "fit")[1]).keys()
    )
    code, found = preflight(capsys, "--namespace", "fit", "--config", str(file))
    late = errors(found).keys()  # odometry that arrives late on a busy machine
    assert late <= {"rate"}, found
    assert code == bool(late)
    for check in ("vehicles", "file", "throttle", "limits", "fence", "topics", "clock"):
        assert [level for level, _ in found[check]] == ["ok"], found[check]

    code, found = preflight(capsys, "--namespace", "/unfit", "--config", str(file))
    assert code == 1
    wrong = errors(found)
    # The MPC rejects odometry in another frame and stays inactive.
    assert "mpc is not active" in wrong.pop("nodes")
    assert wrong.pop("vehicles") == (
        "vehicles differ: mass 0.5 of mpc, 0.75 of reference; give every node the same vehicle "
        "file"
    )
    assert "reference has mass 0.75, the file 0.5" in wrong.pop("file")
    assert "z is 6.00 m, limits -1 to 5" in wrong.pop("fence")
    assert "2 publishers on command of simulator, expected one" in wrong.pop("topics")
    assert "odometries: odometry is in frame 'map', expected 'odom'" in wrong.pop("motion")
    assert wrong.keys() <= {"rate"}
    (simulator,) = (text for _, text in found["nodes"] if text.startswith("simulator"))
    assert "2 publishers on command, expected one" in simulator
    assert "odom: quality of service of /unfit/intruder" in simulator
