# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gates held by half-spaces: none where a plan is inside, and flights through gates that moved."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from quad_mpc_ros import load_config
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.guide import Guided
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.guidance import guidance
from quad_mpc_ros.extras.racing.gate_passages import passages
from quad_mpc_ros.extras.racing.gates import course_from
from quad_mpc_ros.extras.racing.held_gates import HeldGates
from quad_mpc_ros.recordings.evaluation.simulated import simulate
from quad_mpc_ros.references.course import Course

RADIUS = 0.1
BALL = {"position": [5.0, 0.0, 2.0], "tolerance": 0.4}
DOOR = {"position": [5.0, 0.0, 2.0], "yaw": 0.0, "width": 1.0, "height": 0.8}
ROUND = {"position": [5.0, 0.0, 2.0], "yaw": 0.3, "tolerance": 0.5}
KEPT = {"ball": 0.05, "door": 0.15, "round": 0.15}
GATES = {"ball": BALL, "door": DOOR, "round": ROUND}


def course_of(gate: dict[str, object]) -> Course:
    last = {"position": [20.0, 0.0, 2.0], "tolerance": 0.5}
    return course_from({"start": [0.0, 0.0, 2.0], "gates": [gate, last]})


def straight(y: float, z: float, *, speed: float = 8.0, bend: float = 1.0) -> Plan:
    """Return a plan across the gate's plane at a place, bent on the way."""
    t = 0.08 * np.arange(13)
    x = speed * t + 1.0
    off = bend * ((x - 5.0) / 8.0) ** 2
    p_WB = np.column_stack((x, y + off, z - off))
    return Plan(10**9, 0.08, 0.02, np.zeros((48, 4)), p_WB, np.zeros((13, 3, 3)), np.ones(12))


def guided(gate: dict[str, object], plan: Plan) -> tuple[Guided, HeldGates]:
    held = HeldGates(course_of(gate), radius=RADIUS)
    window = ReferenceWindow.hover([0.0, 0.0, 2.0], stamp_ns=10**9)
    for stamp_ns in (10**9, 10**9 + 20_000_000):
        odometry = OdometrySample.at_rest([1.0, 0.0, 2.0], stamp_ns=stamp_ns)
        result = held.guide(odometry, window, plan)
    assert result.window is window
    return result, held


def outside(corridor: Corridor, p_W: Array, stage: int) -> float:
    """Return how far a position (3,) is outside the free region of a stage [m]."""
    over = corridor.normals[stage] @ p_W - corridor.offsets[stage]
    return max(0.0, float(over.max(initial=0.0)))


def crossing(plan: Plan) -> Array:
    """Return where a plan comes to x = 5, by another interpolation than the one under test."""
    polynomials = [np.polynomial.Polynomial.fit(plan.p_WB[:, 0], c, 2) for c in plan.p_WB.T[1:]]
    return np.array([polynomial(5.0) for polynomial in polynomials])


@pytest.mark.parametrize("kind", GATES)
@pytest.mark.parametrize("place", [(0.1, 2.05), (4.0, 2.0)], ids=["well inside", "elsewhere"])
def test_no_half_spaces_away_from_an_edge(kind: str, place: tuple[float, float]) -> None:
    assert guided(GATES[kind], straight(*place))[0].corridor is None


@pytest.mark.parametrize("kind", GATES)
@pytest.mark.parametrize("angle", np.linspace(0.0, 2.0 * math.pi, 9)[:-1])
def test_plan_on_the_half_spaces_passes_inside_the_opening(kind: str, angle: float) -> None:
    """Moved so that the farthest of its stages is just free, it keeps what is to be kept."""
    gate = course_of(GATES[kind]).gates[0]
    way = np.array([0.0, math.cos(angle), math.sin(angle)])
    plan = straight(0.7 * way[1], 2.0 + 0.7 * way[2])
    corridor = guided(GATES[kind], plan)[0].corridor
    assert corridor is not None
    held = np.flatnonzero(np.isfinite(corridor.offsets).any(axis=1))
    assert 1 <= len(held) <= 2
    # The corridor's stages end 20 ms after the plan's.
    times = 0.02 + 0.08 * (held + 1)
    at = np.column_stack([np.interp(times, 0.08 * np.arange(13), c) for c in plan.p_WB.T])
    beyond = max(outside(corridor, p, stage) for p, stage in zip(at, held.tolist(), strict=True))
    assert beyond > 0.05
    # Back along the same way, until no stage is beyond.
    for back in np.arange(0.0, 1.5, 0.005):
        if all(
            outside(corridor, p - back * way, int(s)) == 0.0 for p, s in zip(at, held, strict=True)
        ):
            break
    passed = passages(
        course_of(GATES[kind]),
        seconds=np.linspace(0.0, 0.96, 500),
        p_WB=np.column_stack(
            [np.interp(np.linspace(0, 12, 500), np.arange(13), c) for c in plan.p_WB.T]
        )
        - back * way,
    ).passages[0]
    least = min(gate.half_width, gate.half_height)
    assert passed.passed and passed.miss is not None
    if kind != "door":
        assert passed.miss <= least - KEPT[kind] + 0.02


def test_half_spaces_follow_the_order_of_the_gates() -> None:
    """The second one, at the same place, is not the first that is come by."""
    held = HeldGates(course_of(DOOR), radius=RADIUS)
    window = ReferenceWindow.hover([0.0, 0.0, 2.0])
    flown = np.linspace(4.0, 6.0, 11)
    for k, x in enumerate(flown):
        odometry = dataclasses.replace(
            OdometrySample.at_rest([x, 0.0, 2.0], stamp_ns=k * 20_000_000),
            v_WB_B=np.array([10.0, 0.0, 0.0]),
        )
        result = held.guide(odometry, window, straight(0.9, 2.0))
        assert (result.corridor is not None) == (k > 0 and x <= 4.9)


@pytest.mark.parametrize(
    ("p_WG", "q_WG", "said"),
    [
        ([[5.0, 0.0, 2.0]], [[0.0, 0.0, 0.0, 1.0]], "expected one per gate, 2"),
        ([[np.nan, 0.0, 2.0], [20.0, 0.0, 2.0]], [[0.0, 0.0, 0.0, 1.0]] * 2, "gate 1 at"),
        ([[5.0, 0.0, 2.0], [20.0, 0.0, 2.0]], [[0.0, 0.0, 0.0, 0.5]] * 2, "unit quaternion"),
    ],
)
def test_refuses_invalid_poses(p_WG: object, q_WG: object, said: str) -> None:
    held = HeldGates(course_of(DOOR), radius=RADIUS)
    with pytest.raises(UserError, match=said):
        held.move(np.array(p_WG), np.array(q_WG))


@pytest.mark.parametrize("shift", [(0.0, 0.7, 0.0), (0.0, -0.4, 0.4)])
def test_flies_through_a_gate_that_has_moved(shift: tuple[float, float, float]) -> None:
    """The reference passes the old place of the gate, the MPC the received one."""
    course = {
        "start": [0.0, 0.0, 2.0],
        "gates": [
            {"position": [4.0, 0.0, 2.0], "yaw": 0.0, "width": 0.8, "height": 0.8},
            {"position": [8.0, 1.0, 2.0], "yaw": 0.3, "width": 0.8, "height": 0.8},
            {"position": [12.0, 0.0, 2.0], "tolerance": 0.4},
        ],
    }
    given = load_config(assignments=["mpc.formulation=contouring", "simulator.duration=8.0"])
    config = given._replace(
        mpc=given.mpc.updated({"gates": str(course), "radius": 0.1, "lockstep": True}),
        reference=given.reference.updated(
            {"gates": str(course), "trajectory": "gates", "max_speed": 6.0}
        ),
    )
    course_now = course_from(course)
    moved = [gate.p_WG + np.array(shift) * (n == 1) for n, gate in enumerate(course_now.gates)]
    turned = np.array(
        [[0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)] for yaw in (0, 0.3, 0)]
    )
    gates = tuple(
        dataclasses.replace(gate, p_WG=p) for gate, p in zip(course_now.gates, moved, strict=True)
    )
    there = dataclasses.replace(course_now, gates=gates)

    def missed(*, is_received: bool) -> int:
        guided = guidance(config.mpc)
        assert guided.gates is not None
        if is_received:
            guided.gates.move(np.array(moved), turned)
        controller = warmed_up(config.mpc, guide=guided.guide)
        flight = simulate(*config, controller=controller, on_reference=True)
        assert (flight.stats["solver_status"] == "solved").all()
        return passages(there, seconds=flight.time, p_WB=flight.p_WB).missed

    assert missed(is_received=False) == 1
    assert missed(is_received=True) == 0
