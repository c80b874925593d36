"""``quad_mpc watch`` beside vehicles that fly over DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

Start = Callable[..., "subprocess.Popen[bytes]"]
WATCH = [sys.executable, "-m", "quad_mpc_ros.cli", "watch"]


def watched(*options: str) -> str:
    done = subprocess.run([*WATCH, *options], capture_output=True, timeout=60, check=True)
    return done.stdout.decode()


def rows(shown: str, vehicle: str) -> list[str]:
    return [line for line in shown.splitlines() if f" {vehicle} " in line]


def test_two_vehicles_in_a_table_and_one_on_a_panel(
    start: Start, peer: Any, tmp_path: Path
) -> None:
    ticks: dict[str, list[DiagnosticArray]] = {"uav1": [], "uav2": []}
    for name, heard in ticks.items():
        peer.node.create_subscription(DiagnosticArray, f"{name}/mpc/stats", heard.append, 10)
        for node in ("stack", "simulator"):
            start(node, "-r", f"__ns:=/{name}")
    assert peer.wait(lambda: all(len(heard) > 50 for heard in ticks.values()), timeout=100.0)

    # Without a terminal a picture each interval, until interrupted.
    shown = tmp_path / "shown.txt"
    with shown.open("wb") as output:
        process = subprocess.Popen(
            [*WATCH, "--interval", "0.5"], stdout=output, stderr=subprocess.PIPE
        )

    def pictures() -> list[str]:
        return shown.read_text().split(" vehicle ")[1:]

    def flies(picture: str) -> bool:
        return all(" mpc " in "".join(rows(picture, name)) for name in ticks)

    assert peer.wait(lambda: len(pictures()) > 3 and flies(pictures()[-2]), timeout=60.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0
    assert errors == b""
    assert all(len(rows(pictures()[-1], name)) == 1 for name in ticks)

    # Of one by name a panel, once.
    panel = watched("--once", "--namespace", "uav1")
    assert "uav2" not in panel
    assert "commands  mpc" in panel
    assert "tracking" in panel  # of the reference
    assert "OK running" in panel, panel  # of the simulator
    assert " Hz, 0." in panel


def test_where_nobody_flies_it_says_so() -> None:
    done = subprocess.run([*WATCH, "--once"], capture_output=True, timeout=60)
    assert done.returncode == 1
    assert b"nobody publishes mpc/stats" in done.stdout
