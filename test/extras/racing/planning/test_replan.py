"""Replan a part of a race in flight: boundary states, dynamics and files."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros import load_config
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.extras.racing.gate_passages import passages
from quad_mpc_ros.extras.racing.gates import course_from
from quad_mpc_ros.extras.racing.live_race import LiveRace, ReplanRequest
from quad_mpc_ros.extras.racing.planning.race_plan import RacePlan, plan_race
from quad_mpc_ros.extras.racing.planning.replan import planned_part
from quad_mpc_ros.extras.racing.planning.settings import PlanSettings
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.references.course import Course
from quad_mpc_ros.references.motion_table import MotionTable, PlannedMotion

pytest.importorskip("casadi")

OPENING = {"width": 1.6, "height": 1.6}
COURSE: dict[str, Any] = {
    "start": [0.0, 0.0, 1.5],
    "gates": [
        {"position": [5.0, 0.0, 2.0], "yaw": 0.0, **OPENING},
        {"position": [10.0, 1.0, 2.0], "yaw": 0.4, **OPENING},
        {"position": [14.0, 5.0, 2.5], "yaw": 1.2, **OPENING},
        {"position": [13.0, 10.0, 2.0], "yaw": 2.2, **OPENING},
        {"position": [8.0, 13.0, 2.0], "yaw": 3.0, **OPENING},
        {"position": [3.0, 12.0, 2.0], "tolerance": 0.4},
    ],
    "end": [0.0, 8.0, 1.5],
}
MOVED = 3  # the gate
SHIFTS = {MOVED: (1.5, 0.0, 0.3), 6: (0.0, 1.5, 0.3)}  # across the way


@functools.cache
def vehicle() -> FlightConfig:
    return load_config("vehicles/cpc", assignments=["reference.limit_margin=0.05"])


@functools.cache
def planned(model: str) -> RacePlan:
    return plan_race(
        course_from(COURSE), *vehicle(), model=model, gate_margin=0.1, radius=0.2, step=0.06
    )


def moved(number: int) -> tuple[Array, Array]:
    gates = course_from(COURSE).gates
    p_WG = np.array([gate.p_WG for gate in gates])
    p_WG[number - 1] += SHIFTS[number]
    axes = np.array([np.eye(3) if gate.R_WG is None else gate.R_WG for gate in gates])
    return p_WG, so3.quaternion_xyzw_from_rotation(axes)


@functools.cache
def flown(model: str) -> PlannedMotion:
    return planned(model).trajectory()


@functools.cache
def asked(model: str, number: int = MOVED) -> ReplanRequest:
    """Return what is asked for where a gate has moved, received in time."""
    race = LiveRace(planned(model).course, flown(model), planner=True)
    race.move(*moved(number))
    found = race.replan_request(flown(model), 0.2)
    assert found is not None and found.planned
    return found


@functools.cache
def part(model: str, number: int = MOVED) -> MotionTable:
    return planned_part(asked(model, number))


def missed(course: Course, motion: PlannedMotion) -> int:
    times = list(range(0, motion.period_ns, 5_000_000))
    return passages(course, seconds=1e-9 * np.array(times), p_WB=motion.at(times).p_WB).missed


@pytest.mark.parametrize("number", [MOVED, 6])
@pytest.mark.parametrize("model", ["rates", "rotors"])
def test_it_begins_and_ends_as_the_present_plan_is_there(model: str, number: int) -> None:
    """In the model ``rotors`` the thrust, and so the acceleration, changes at once."""
    table, detour = part(model, number), asked(model, number)
    rows = {0: detour.leave, -1: detour.rejoin}
    assert (detour.rejoin is None) == (number == 6)  # there are no two gates behind it
    for place, row in rows.items():
        if row is None:
            continue
        for name in ("p_WB", "v_WB_W", "w_WB_B"):
            wanted = getattr(detour.motion, name)[row]
            assert_allclose(getattr(table, name)[place], wanted, atol=1e-6)
        alike = np.abs(table.q_WB_xyzw[place] @ detour.motion.q_WB_xyzw[row])
        assert alike == pytest.approx(1.0, abs=1e-9)
        if model == "rates":
            assert_allclose(table.a_WB_W[place], detour.motion.a_WB_W[row], atol=1e-4)


@pytest.mark.parametrize("number", [MOVED, 6])
@pytest.mark.parametrize("model", ["rates", "rotors"])
def test_it_passes_where_the_gate_is_and_the_present_plan_does_not(
    model: str, number: int
) -> None:
    there = planned(model).course.moved(*moved(number))
    way = asked(model, number).with_part(part(model, number), vehicle().reference)
    assert isinstance(way.trajectory, PlannedMotion)
    assert missed(there, flown(model)) == 1
    assert missed(there, way.trajectory) == 0
    assert way.lap < planned(model).race_time + 1.0
    for time, gate in zip(way.times, there.gates, strict=True):
        offset = way.trajectory.at([round(1e9 * time)]).p_WB - gate.p_WG
        room = gate.room(offset if gate.R_WG is None else offset @ gate.R_WG)[0]
        assert room > (0.1 if gate.R_WG is None else 0.3) - 0.01


def test_newton_and_eulers_equations_hold_and_no_rotor_is_beyond_its_limits() -> None:
    """Differences of rows are compared with means: rotors at their places, forces in the body."""
    table, config = part("rates"), vehicle()
    rotors, body = config.simulator.rotors, config.simulator.airframe
    inertia = np.diag(body.inertia[:3])
    places = np.column_stack((rotors.x, rotors.y, rotors.z))
    axis = np.array([0.0, 0.0, 1.0])
    ratio = rotors.torque_coefficient / rotors.thrust_coefficient
    torques = np.cross(places, axis) - ratio * np.array(rotors.spin)[:, None] * axis
    mixer = np.vstack((np.ones(4), torques.T))
    step = np.diff(table.seconds)[:, None]
    w, R = table.w_WB_B, so3.rotation_from_quaternion_xyzw(table.q_WB_xyzw)
    force = table.a_WB_W + config.mpc.gravity * axis
    thrust = np.einsum("ni,ni->n", force, R[:, :, 2])
    assert_allclose(force, thrust[:, None] * R[:, :, 2], atol=1e-3)
    assert_allclose(
        np.diff(table.p_WB, axis=0),
        step * (table.v_WB_W[:-1] + table.v_WB_W[1:]) / 2.0
        - step**2 * np.diff(table.a_WB_W, axis=0) / 12.0,
        atol=1e-4,
    )
    turned = so3.log(np.swapaxes(R[:-1], -1, -2) @ R[1:])
    assert_allclose(turned, step * (w[:-1] + w[1:]) / 2.0, atol=2e-3)
    middle = (w[:-1] + w[1:]) / 2.0
    torque = np.diff(w, axis=0) / step @ inertia + np.cross(middle, middle @ inertia)
    mean = config.mpc.mass * (thrust[:-1] + thrust[1:]) / 2.0
    each = np.linalg.solve(mixer, np.column_stack((mean, torque)).T)
    greatest = rotors.thrust_coefficient * rotors.speed_max**2
    assert each.max() < greatest
    assert each.min() > 0.0
    assert (np.abs(w) <= np.array(config.mpc.omega_max)).all()


def test_what_a_plan_was_made_with_is_in_its_file(tmp_path: Any) -> None:
    from quad_mpc_ros.references.point_table import read_csv

    planned("rates").write(tmp_path / "race.csv")
    found = read_csv(tmp_path / "race.csv")
    assert isinstance(found, MotionTable)
    settings = PlanSettings.of(found.planned_with)
    assert settings.model == "rates" and settings.gate_margin == 0.1
    assert settings.vehicle.rotors is not None
    assert_allclose(settings.vehicle.omega_max, planned("rates").vehicle.omega_max)


@pytest.mark.parametrize("text", ["", "{", "{}", '{"model": "rates", "vehicle": {}}'])
def test_refuses_invalid_settings_in_one_sentence(text: str) -> None:
    with pytest.raises(UserError, match=r"cannot be read .*: plan it again"):
        PlanSettings.of(text)


def test_a_gate_that_cannot_be_reached_is_refused_in_a_sentence() -> None:
    detour = asked("rates")
    narrow = tuple(dataclasses.replace(gate, half_width=0.2) for gate in detour.part.gates)
    part = dataclasses.replace(detour.part, gates=narrow)
    with pytest.raises(UserError, match=r"unreachable: half of its opening is 0\.2 m"):
        planned_part(dataclasses.replace(detour, part=part))
