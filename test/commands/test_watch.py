"""What the table of ``quad_mpc watch`` says: of what came, what is missing, and what is old."""

from __future__ import annotations

import dataclasses
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.watched_vehicles import NodeStatus, WatchedVehicle, status_text
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.topics import COMMAND, ENGAGED, ODOMETRY, REFERENCE, STATS
from quad_mpc_ros.ros.messages import message_in

STAMP = 1_700_000_000 * 10**9
FIGURES = TickStats(
    stamp_ns=STAMP,
    source="mpc",
    reason="",
    solver_status="solved",
    iterations=10,
    primal_residual=0.0,
    dual_residual=0.0,
    solve_time_us=200.0,
    step_time_us=600.0,
    odom_age_ms=4.0,
    reference_age_ms=10.0,
    commands=100,
    fallbacks=0,
    solver_failures=0,
    rejected_inputs=0,
)


def no_decoding() -> Any:
    raise AssertionError("decoded what nobody looks at")


def tick(vehicle: WatchedVehicle, *, at: float, **changes: Any) -> None:
    items = dataclasses.replace(FIGURES, **changes).items()
    values = [SimpleNamespace(key=key, value=value) for key, value in items]
    message = SimpleNamespace(status=[SimpleNamespace(values=values)])
    vehicle.take(STATS, lambda: message, seconds=at)


def place(vehicle: WatchedVehicle, x: float, *, at: float) -> None:
    odometry = OdometrySample(
        stamp_ns=STAMP,
        p_WB=np.array([x, 0.0, 1.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.array([0.5, 0.0, 0.0]),
        w_WB_B=np.zeros(3),
    )
    decode = partial(message_in, ODOMETRY, cdr.written_odometry(odometry))
    vehicle.take(ODOMETRY, decode, seconds=at)


def reference_at(vehicle: WatchedVehicle, x: float, *, at: float) -> None:
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
    vehicle.take(REFERENCE, partial(message_in, REFERENCE, data), seconds=at)


def test_refuses_a_name_that_is_no_namespace(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--namespace", "two words"]) == 2
    assert "--namespace: given 'two words', expected" in capsys.readouterr().err


def test_shows_what_was_never_received_as_missing() -> None:
    assert set(WatchedVehicle().cells(3.0).values()) == {"-"}


def test_shows_a_flight_with_its_error_and_rates() -> None:
    vehicle = WatchedVehicle()
    for k in range(200):
        place(vehicle, 0.01 * k, at=0.02 * k)
        tick(vehicle, commands=k, at=0.02 * k)
        vehicle.take(COMMAND, no_decoding, seconds=0.02 * k)
        if k % 50 == 49:
            reference_at(vehicle, 2.0, at=0.02 * k)
    cells = vehicle.cells(3.99)
    assert cells["commands"] == "mpc"
    assert cells["error"] == "0.010 m"
    assert cells["position"] == "1.99 0.00 1.00 m"
    assert cells["odom"] == "50 Hz, 0.01 s ago"
    assert cells["reference"].startswith("1 Hz")
    assert cells["command"].startswith("50 Hz")
    assert cells["commands sent"] == "199"
    assert cells["mode"] == "-"  # no reference node reports


def test_states_the_age_of_old_values() -> None:
    vehicle = WatchedVehicle()
    place(vehicle, 0.0, at=0.0)
    tick(vehicle, at=0.0)
    assert vehicle.cells(0.9)["commands"] == "mpc"
    cells = vehicle.cells(7.4)
    assert cells["commands"] == "mpc (7 s old)"
    assert cells["position"].endswith("(7 s old)")
    assert cells["odom"] == "0 Hz, 7.40 s ago"


def test_shows_messages_that_cannot_be_read_as_missing() -> None:
    vehicle = WatchedVehicle()
    vehicle.take(STATS, lambda: SimpleNamespace(status=[]), seconds=0.0)
    assert vehicle.cells(0.0)["commands"] == "-"


def test_lists_nodes_with_warnings_below_a_column_for_each_vehicle() -> None:
    first, second = WatchedVehicle(), WatchedVehicle()
    tick(first, at=0.0)
    tick(second, source="hover", at=0.0)
    second.take(ENGAGED, lambda: SimpleNamespace(data=False), seconds=0.0)
    values = {"mode": "hold", "request": "goal refused: far"}
    flying = NodeStatus(seconds=0.0, level="OK", text="flying", values=values)
    first.nodes["reference"] = flying
    late = NodeStatus(seconds=0.0, level="ERROR", text="odometry is late", values={})
    second.nodes["mpc"] = late
    lines = status_text({"uav2": second, "uav1": first}, 9.0).splitlines()
    words = [line.split() for line in lines]
    assert words[0] == ["vehicle", "/uav1", "/uav2"]
    assert ["engaged", "-", "no"] in words
    assert ["mode", "hold", "-"] in words
    assert any(line.startswith("node reference") and "OK (9 s old)" in line for line in lines)
    assert lines[-1] == "ERROR /uav2/mpc: odometry is late"
