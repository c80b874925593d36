"""What the panel says of a vehicle: of what came, of what is missing, and of what is old."""

from __future__ import annotations

import dataclasses
import io
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from quad_mpc_ros.commands.watch.screen import drawn as table
from quad_mpc_ros.commands.watch.vehicle import Vehicle, Vehicles
from quad_mpc_ros.commands.watch.view import Entry, Mark, VehicleView, viewed
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import cdr
from quad_mpc_ros.messages.topics import (
    COMMAND,
    ENGAGED,
    ODOMETRY,
    REFERENCE,
    STATS,
    Topic,
)
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
    ground="flying",
    thrust_scale=1.1,
    estimate="learn",
    odom_age_ms=4.0,
    reference_age_ms=10.0,
    commands=100,
    fallbacks=0,
    solver_failures=0,
    rejected_inputs=0,
)


def no_decoding() -> Any:
    raise AssertionError("decoded what nobody looks at")


def figures(**changes: Any) -> Any:
    """Return ``mpc/stats`` as a decoded message."""
    items = dataclasses.replace(FIGURES, **changes).items()
    values = [SimpleNamespace(key=key, value=value) for key, value in items]
    return SimpleNamespace(status=[SimpleNamespace(values=values)])


def tell(vehicle: Vehicle, topic: Topic, message: Any, *, at: float) -> None:
    vehicle.topics[topic.name].take(lambda: message, seconds=at)


def place(vehicle: Vehicle, x: float, *, at: float) -> None:
    odometry = OdometrySample(
        stamp_ns=STAMP,
        p_WB=np.array([x, 0.0, 1.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.array([0.5, 0.0, 0.0]),
        w_WB_B=np.zeros(3),
    )
    data = cdr.written_odometry(odometry)
    vehicle.topics[ODOMETRY.name].take(partial(message_in, ODOMETRY, data), seconds=at)


def reference_at(vehicle: Vehicle, x: float, *, at: float) -> None:
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
    vehicle.topics[REFERENCE.name].take(partial(message_in, REFERENCE, data), seconds=at)


def health_of(name: str, level: int | bytes, text: str, **values: str) -> Any:
    pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
    status = SimpleNamespace(name=name, level=level, message=text, values=pairs)
    return SimpleNamespace(status=[status])


def seen(vehicle: Vehicle, now: float) -> VehicleView:
    vehicle.look(now)
    return viewed(vehicle, now)


def drawn(views: list[VehicleView], *, width: int = 120, colour: bool = False) -> str:
    console = Console(file=io.StringIO(), width=width, force_terminal=colour or None)
    console.print(table(views, title="now"))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_what_never_came_is_missing() -> None:
    view = seen(Vehicle("uav1"), 3.0)
    assert {entry.mark for entry in view.entries.values()} == {Mark.MISSING}
    assert view.log == ()
    assert "no mpc/stats yet" in drawn([view])


def test_a_flight_is_shown_with_its_error_and_rates() -> None:
    vehicle = Vehicle("")
    for k in range(200):
        place(vehicle, 0.01 * k, at=0.02 * k)
        tell(vehicle, STATS, figures(commands=k), at=0.02 * k)
        vehicle.topics[COMMAND.name].take(no_decoding, seconds=0.02 * k)
        if k % 50 == 49:
            reference_at(vehicle, 2.0, at=0.02 * k)
            vehicle.look(0.02 * k)
    view = viewed(vehicle, 3.99)
    assert view.entries["commands"].text == "mpc"
    assert view.entries["commands"].mark is Mark.GOOD
    assert view.entries["error"].text == "0.010 m"
    assert view.entries["position"].text == "1.99 0.00 1.00 m"
    assert view.entries["odom"].text == "50 Hz, 0.01 s ago"
    assert view.entries["mode"].text == "-"  # no reference node reports
    assert "1 Hz" in view.entries["reference"].text
    assert view.entries["command"].text.startswith("50 Hz")
    assert view.entries["commands sent"].text == "199"


def test_what_is_old_says_how_old_it_is() -> None:
    vehicle = Vehicle("")
    place(vehicle, 0.0, at=0.0)
    tell(vehicle, STATS, figures(), at=0.0)
    assert seen(vehicle, 0.9).entries["commands"].mark is Mark.GOOD
    view = seen(vehicle, 7.4)
    assert view.entries["commands"].text == "mpc (old: 7 s)"
    assert view.entries["commands"].mark is Mark.OLD
    assert view.entries["position"].text.endswith("(old: 7 s)")
    assert view.entries["odom"].mark is Mark.OLD
    assert view.entries["odom"].text == "0 Hz, 7.40 s ago"
    assert view.entries["thrust scale"].mark is Mark.OLD


@pytest.mark.parametrize(
    ("source", "reason", "mark"),
    [
        ("plan", "solver: max iterations", Mark.WARN),
        ("hover", "outside the fence", Mark.BAD),
        ("silent", "odometry is 2.00 s old", Mark.BAD),
    ],
)
def test_a_rung_below_the_mpc_is_marked_with_its_reason(
    source: str, reason: str, mark: Mark
) -> None:
    vehicle = Vehicle("")
    tell(vehicle, STATS, figures(source=source, reason=reason), at=0.0)
    entry = seen(vehicle, 0.0).entries["commands"]
    assert (entry.text, entry.mark) == (f"{source}: {reason}", mark)


def test_a_counter_that_rises_is_marked_until_it_has_stood_still() -> None:
    vehicle = Vehicle("")
    marks = []
    for k in range(30):
        tell(vehicle, STATS, figures(fallbacks=3 + (k >= 10)), at=float(k))
        marks.append(seen(vehicle, float(k)).entries["fallbacks"].mark)
    assert marks == [Mark.PLAIN] * 10 + [Mark.WARN] * 10 + [Mark.PLAIN] * 10


def test_a_vehicle_that_does_not_act_and_a_refusal_are_marked() -> None:
    vehicles = Vehicles(None)
    vehicle = vehicles.of("/uav1/")
    assert vehicle is not None
    tell(vehicle, ENGAGED, SimpleNamespace(data=False), at=0.0)
    vehicles.take_diagnostics(
        health_of("/uav1/reference", b"\x00", "flying", mode="hold", request="goal refused: far"),
        seconds=0.0,
    )
    vehicles.take_diagnostics(health_of("/uav2/mpc", 1, "late"), seconds=0.0)  # not watched
    vehicles.take_diagnostics(health_of("/uav1/mpc", 2, "hover"), seconds=0.0)  # as in a bag
    view = seen(vehicle, 0.5)
    assert (view.entries["engaged"].text, view.entries["engaged"].mark) == ("no", Mark.WARN)
    assert view.entries["mode"].text == "hold"
    assert view.entries["request"].mark is Mark.WARN
    assert view.entries["node mpc"] == Entry("ERROR hover", Mark.BAD)
    assert view.entries["node reference"] == Entry("OK flying", Mark.GOOD)
    assert seen(vehicle, 9.0).entries["node mpc"].mark is Mark.OLD


def test_lines_of_the_log_are_those_of_the_vehicles_nodes() -> None:
    vehicles = Vehicles(None)
    vehicle = vehicles.of("uav1")
    assert vehicle is not None
    vehicles.take_diagnostics(health_of("/uav1/mpc", 0, "flying"), seconds=0.0)
    for name, level, text in (
        ("uav1.mpc", 30, "[late]"),
        ("uav2.mpc", 20, "no"),
        ("uav1.camera", 20, "no"),
    ):
        vehicles.take_log(SimpleNamespace(name=name, level=level, msg=text))
    view = seen(vehicle, 0.0)
    assert view.log == (("mpc", Entry("[late]", Mark.WARN)),)
    assert "[late]" in drawn([view])  # brackets are no markup


def test_messages_that_cannot_be_read_count_as_missing() -> None:
    vehicle = Vehicle("")
    tell(vehicle, STATS, SimpleNamespace(status=[]), at=0.0)
    place(vehicle, float("nan"), at=0.0)
    view = seen(vehicle, 0.0)
    assert view.entries["commands"].mark is Mark.MISSING
    assert view.entries["position"].mark is Mark.MISSING


def test_each_vehicle_has_a_column() -> None:
    vehicles = Vehicles(None)
    for name, source in (("uav1", "mpc"), ("uav2", "hover")):
        vehicle = vehicles.of(name)
        assert vehicle is not None
        tell(vehicle, STATS, figures(source=source), at=0.0)
        vehicle.look(0.0)
    lines = drawn([viewed(vehicle, 0.0) for vehicle in vehicles]).splitlines()
    assert ["vehicle", "uav1", "uav2"] in [line.split() for line in lines]
    assert ["commands", "mpc", "hover"] in [line.split() for line in lines]


def test_only_the_named_vehicles_are_watched() -> None:
    vehicles = Vehicles(["/uav2", "/"])
    assert vehicles.of("uav1") is None
    assert [vehicle.namespace for vehicle in vehicles] == ["", "uav2"]


@pytest.mark.parametrize("width", [40, 80, 120, 200])
def test_the_table_fits_any_width_and_keeps_every_entry(width: int) -> None:
    vehicle = Vehicle("uav1")
    tell(vehicle, STATS, figures(), at=0.0)
    view = seen(vehicle, 0.0)
    lines = drawn([view], width=width).splitlines()
    assert max(map(len, lines)) <= width
    text = " ".join(lines)
    assert all(label in text for label in view.entries)


def test_colours_are_for_terminals_only() -> None:
    view = seen(Vehicle("uav1"), 0.0)
    assert "\x1b[" not in drawn([view])
    assert "\x1b[" in drawn([view], colour=True)
