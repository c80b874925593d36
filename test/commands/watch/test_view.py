"""What the panel says of a vehicle: of what came, of what is missing, and of what is old."""

from __future__ import annotations

import dataclasses
import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from quad_mpc_ros.commands.watch.panel import pictured, trail_lines
from quad_mpc_ros.commands.watch.vehicle import Arrival, Vehicle, Vehicles
from quad_mpc_ros.commands.watch.view import Mark, VehicleView, viewed
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
    vehicle.take(topic, Arrival(seconds=at, data=b"", decode=lambda: message))


def place(vehicle: Vehicle, x: float, *, at: float) -> None:
    odometry = OdometrySample(
        stamp_ns=STAMP,
        p_WB=np.array([x, 0.0, 1.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.array([0.5, 0.0, 0.0]),
        w_WB_B=np.zeros(3),
    )
    data = cdr.written_odometry(odometry)
    vehicle.take(ODOMETRY, Arrival(seconds=at, data=data, decode=no_decoding))


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
    vehicle.take(REFERENCE, Arrival(seconds=at, data=data, decode=no_decoding))


def health_of(name: str, level: int | bytes, text: str, **values: str) -> Any:
    pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
    status = SimpleNamespace(name=name, level=level, message=text, values=pairs)
    return SimpleNamespace(status=[status])


def seen(vehicle: Vehicle, now: float) -> VehicleView:
    vehicle.look(now)
    return viewed(vehicle, now)


def drawn(views: list[VehicleView], *, width: int = 120, colour: bool = False) -> str:
    console = Console(file=io.StringIO(), width=width, force_terminal=colour or None)
    console.print(pictured(views, title="now"))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_what_never_came_is_missing() -> None:
    view = seen(Vehicle("uav1"), 3.0)
    assert view.rung.mark is Mark.MISSING
    groups = (view.flight, view.motion, view.learned, view.timing, view.counters)
    assert {entry.mark for group in groups for entry in group} == {Mark.MISSING}
    assert view.nodes == view.log == ()
    assert "no mpc/stats yet" in drawn([view])


def test_a_flight_is_shown_with_its_error_and_rates() -> None:
    vehicle = Vehicle("")
    for k in range(200):
        place(vehicle, 0.01 * k, at=0.02 * k)
        tell(vehicle, STATS, figures(commands=k), at=0.02 * k)
        vehicle.take(COMMAND, Arrival(seconds=0.02 * k, data=b"", decode=no_decoding))
        if k % 50 == 49:
            reference_at(vehicle, 2.0, at=0.02 * k)
            vehicle.look(0.02 * k)
    view = viewed(vehicle, 3.99)
    assert view.rung.text == "mpc"
    assert view.rung.mark is Mark.GOOD
    assert view.entry("error").text == "0.010 m (most 1.510)"
    assert view.entry("position").text == "1.99 0.00 1.00 m"
    assert view.entry("odom").text == "50 Hz, 0.01 s ago"
    assert view.entry("reference").text.startswith("-")  # of no node; its rate is below
    assert "1 Hz" in next(e.text for e in view.timing if e.label == "reference")
    assert view.entry("command").text.startswith("50 Hz")
    assert view.entry("commands sent").text == "199"


def test_what_is_old_says_how_old_it_is() -> None:
    vehicle = Vehicle("")
    place(vehicle, 0.0, at=0.0)
    tell(vehicle, STATS, figures(), at=0.0)
    assert seen(vehicle, 0.9).rung.mark is Mark.GOOD
    view = seen(vehicle, 7.4)
    assert view.rung.text == "mpc (old: 7 s)"
    assert view.rung.mark is Mark.OLD
    assert view.entry("position").text.endswith("(old: 7 s)")
    assert view.entry("odom").mark is Mark.OLD
    assert view.entry("odom").text == "0 Hz, 7.40 s ago"
    assert view.entry("thrust scale").mark is Mark.OLD


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
    rung = seen(vehicle, 0.0).rung
    assert (rung.text, rung.mark) == (f"{source}: {reason}", mark)


def test_a_counter_that_rises_is_marked_until_it_has_stood_still() -> None:
    vehicle = Vehicle("")
    marks = []
    for k in range(30):
        tell(vehicle, STATS, figures(fallbacks=3 + (k >= 10)), at=float(k))
        marks.append(seen(vehicle, float(k)).entry("fallbacks").mark)
    assert marks == [Mark.PLAIN] * 10 + [Mark.WARN] * 10 + [Mark.PLAIN] * 10


def test_learned_values_come_with_what_they_were_lately() -> None:
    vehicle = Vehicle("")
    for k, scale in enumerate((0.9, 1.2, 1.1)):
        tell(vehicle, STATS, figures(thrust_scale=scale, disturbance_x=-1e-9), at=float(k))
        vehicle.look(float(k))
    view = viewed(vehicle, 2.0)
    assert view.entry("thrust scale").text == "1.100 [0.900, 1.200]"
    assert view.entry("disturbance x").text == "0.00 [0.00, 0.00] m/s²"


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
    assert (view.entry("engaged").text, view.entry("engaged").mark) == ("no", Mark.WARN)
    assert view.entry("reference").text == "hold"
    assert view.entry("request").mark is Mark.WARN
    assert [(node.text, node.mark) for node in view.nodes] == [
        ("ERROR hover", Mark.BAD),
        ("OK flying", Mark.GOOD),
    ]
    assert seen(vehicle, 9.0).nodes[0].mark is Mark.OLD


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
    assert [(line.label, line.text, line.mark) for line in view.log] == [
        ("mpc", "[late]", Mark.WARN)
    ]
    assert "[late]" in drawn([view])  # brackets are no markup


def test_messages_that_cannot_be_read_count_as_missing() -> None:
    vehicle = Vehicle("")
    tell(vehicle, STATS, SimpleNamespace(status=[]), at=0.0)
    place(vehicle, float("nan"), at=0.0)
    view = seen(vehicle, 0.0)
    assert view.rung.mark is Mark.MISSING
    assert view.entry("position").mark is Mark.MISSING


def test_several_vehicles_are_rows_and_one_is_a_panel() -> None:
    vehicles = Vehicles(None)
    for name, source in (("uav1", "mpc"), ("uav2", "hover")):
        vehicle = vehicles.of(name)
        assert vehicle is not None
        tell(vehicle, STATS, figures(source=source), at=0.0)
        vehicle.look(0.0)
    views = [viewed(vehicle, 0.0) for vehicle in vehicles]
    lines = drawn(views, width=160).splitlines()
    (one,) = (line for line in lines if "uav1" in line)
    (other,) = (line for line in lines if "uav2" in line)
    assert "mpc" in one
    assert "hover" in other
    assert "disturbance x" in drawn(views[:1])


def test_only_the_named_vehicles_are_watched() -> None:
    vehicles = Vehicles(["/uav2", "/"])
    assert vehicles.of("uav1") is None
    assert [vehicle.namespace for vehicle in vehicles] == ["", "uav2"]


@pytest.mark.parametrize("width", [40, 80, 120, 200])
def test_the_panel_fits_any_width_and_keeps_every_entry(width: int) -> None:
    vehicle = Vehicle("uav1")
    tell(vehicle, STATS, figures(), at=0.0)
    view = seen(vehicle, 0.0)
    lines = drawn([view], width=width).splitlines()
    assert max(map(len, lines)) <= width
    text = " ".join(lines)
    for group in (view.flight, view.motion, view.learned, view.timing, view.counters):
        for entry in group:
            assert entry.label in text


def test_colours_are_for_terminals_only() -> None:
    view = seen(Vehicle("uav1"), 0.0)
    assert "\x1b[" not in drawn([view])
    assert "\x1b[" in drawn([view], colour=True)


def test_a_trail_is_drawn_to_scale_with_its_end_marked() -> None:
    square = np.array([[0.0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1], [0, 0, 1]])
    lines = trail_lines(square, width=20, height=10)  # as many dots either way
    inked = [[cell != "\u2800" for cell in line] for line in lines]
    assert len(lines) == 10
    assert {len(line) for line in lines} == {20}
    assert all(inked[0])
    assert all(inked[-1])
    assert all(row[0] and row[-1] for row in inked)
    assert not any(any(row[1:-1]) for row in inked[1:-1])
    assert lines[-1][0] == "●"
    flat = trail_lines(np.array([[0.0, 0, 0], [5.0, 0, 0]]), width=20, height=10)
    assert sum(any(cell != "\u2800" for cell in line) for line in flat) == 1


def test_a_trail_of_nothing_or_of_one_place() -> None:
    assert set("".join(trail_lines(np.zeros((0, 3)), width=4, height=2))) == {"\u2800"}
    assert "●" in "".join(trail_lines(np.ones((1, 3)), width=4, height=2))
