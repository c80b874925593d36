# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The table of ``quad_mpc watch`` with received, missing and old values."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.watched_vehicles import NodeStatus, WatchedVehicle, status_text
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.topics import ODOMETRY, REFERENCE

STAMP = 1_700_000_000 * 10**9
FIGURES = {"source": "mpc", "commands": "100", "thrust_scale": "1.0123456789"}


def status(level: str, text: str, **values: str) -> NodeStatus:
    return NodeStatus(seconds=0.0, level=level, text=text, values=values)


def place(vehicle: WatchedVehicle, x: float) -> None:
    odometry = OdometrySample(
        stamp_ns=STAMP,
        p_WB=np.array([x, 0.0, 1.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.array([0.5, 0.0, 0.0]),
        w_WB_B=np.zeros(3),
    )
    vehicle.messages[ODOMETRY.name] = cdr.written_odometry(odometry)


def reference_at(vehicle: WatchedVehicle, x: float) -> None:
    held = np.array([[x, 0.0, 1.0]] * 2)
    window = ReferenceWindow(
        stamp_ns=STAMP,
        offset_ns=np.array([0, 10**9]),
        p_WB=held,
        q_WB_xyzw=np.array([[0.0, 0.0, 0.0, 1.0]] * 2),
        v_WB_W=0.0 * held,
        a_WB_W=0.0 * held,
        w_WB_W=0.0 * held,
    )
    data = cdr.written_reference(window, child_frame_id="base_link")
    vehicle.messages[REFERENCE.name] = data


def test_rejects_an_invalid_namespace(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--namespace", "two words"]) == 2
    assert "--namespace: given 'two words', expected" in capsys.readouterr().err


def test_shows_values_never_received_as_missing() -> None:
    assert set(WatchedVehicle().cells(3.0).values()) == {"-"}


def test_shows_a_flight_with_its_error_and_figures() -> None:
    vehicle = WatchedVehicle({"mpc": status("OK", "flying", **FIGURES)})
    place(vehicle, 1.99)
    reference_at(vehicle, 2.0)
    cells = vehicle.cells(0.5)
    assert cells["source"] == "mpc"
    assert cells["commands"] == "100"
    assert cells["thrust_scale"] == "1.012"
    assert cells["position"] == "1.99 0.00 1.00 m"
    assert cells["error"] == "0.010 m"
    assert cells["mode"] == "-"  # no reference node reports


def test_shows_messages_that_cannot_be_read_as_missing() -> None:
    vehicle = WatchedVehicle(messages={ODOMETRY.name: b"\x00\x01\x00\x00"})
    assert vehicle.cells(0.0)["position"] == "-"


def test_lists_nodes_with_warnings_below_a_column_for_each_vehicle() -> None:
    first, second = WatchedVehicle(), WatchedVehicle()
    first.nodes["reference"] = status("OK", "flying", mode="hold", request="goal refused: far")
    second.nodes["mpc"] = status("ERROR", "odometry is late", source="hover", engaged="false")
    lines = status_text({"uav2": second, "uav1": first}, 9.0).splitlines()
    assert lines[0].split() == ["vehicle", "/uav1", "/uav2"]
    (mode,) = [line for line in lines if line.startswith("mode")]
    assert mode.split() == ["mode", "hold", "-"]
    assert any(line.startswith("node reference") and "OK (9 s old)" in line for line in lines)
    assert lines[-1] == "ERROR /uav2/mpc: odometry is late"
