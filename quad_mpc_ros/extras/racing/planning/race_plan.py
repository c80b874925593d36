# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A time-optimal plan through the gates of a course for the configured vehicle."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.arguments import instance, number
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.extras.racing.gate_passages import Lap, passages
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.extras.racing.planning.first_guess import flown_by_a_point, with_attitudes
from quad_mpc_ros.extras.racing.planning.legs import CourseLeg, legs_of
from quad_mpc_ros.extras.racing.planning.limits import PlannedVehicle, planned_vehicle
from quad_mpc_ros.extras.racing.planning.model import P, Q, V, W, model_of
from quad_mpc_ros.extras.racing.planning.transcription import (
    Dynamics,
    Nodes,
    Solved,
    solve,
)
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.course import Course
from quad_mpc_ros.references.motion_table import MotionTable, PlannedMotion
from quad_mpc_ros.simulation.config import SimulatorConfig

_ROW_PERIOD = 0.01  # s, of the table
_MIN_HEIGHT = 0.5  # m: lowest height of a plan, unless gates are lower
_MAX_ITERATIONS = 600
_HEIGHT_RATIO = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class RacePlan:
    """A plan: its motion in rows, its nodes, and its gate passages.

    Attributes:
        course: The course.
        table: The motion, every 10 ms.
        nodes: The solution of the optimiser, with states and inputs of its model.
        vehicle: The limits of the vehicle.
        race_time: Time from the start to the end, or to the last gate [s].
        lap: The gate passages, evaluated as for a flight.
        iterations: Iterations of the optimiser.
    """

    course: Course
    table: MotionTable
    nodes: Nodes
    vehicle: PlannedVehicle
    race_time: float
    lap: Lap
    iterations: int

    def trajectory(self) -> PlannedMotion:
        """Return the plan as a reference: ``simulate(trajectory=plan.trajectory())``."""
        return PlannedMotion(self.table)

    def write(self, path: str | Path) -> None:
        """Write the plan as a file for ``reference.file``. Raises ``OSError``."""
        Path(path).write_text(self.table.text(), encoding="utf-8")


def plan_race(
    gates: str | Path | Course,
    mpc: MpcConfig | None = None,
    simulator: SimulatorConfig | None = None,
    reference: ReferenceConfig | None = None,
    *,
    gate_margin: float = 0.0,
    radius: float = 0.0,
    step: float = 0.05,
) -> RacePlan:
    """Return the time-optimal plan through gates, using CasADi (the extra ``plan``).

    Args:
        gates: A course file, its text, or a course.
        mpc: Parameters of the MPC: mass, thrust, drag, lags and bounds of the commands.
        simulator: With the plant ``rotors``, bounds of each rotor.
        reference: Further bounds, and their unused share (``limit_margin``).
        gate_margin: Distance to the edges of the gates [m].
        radius: Radius of the vehicle, additional distance to the frames of planar gates [m].
        step: Longest step between nodes [s].

    Returns:
        The plan, with ``race_time``, ``table``, ``trajectory()`` and ``write(path)``.

    Raises:
        UserError: The course is invalid, no plan was found, or CasADi is not installed.
        ArgumentError: An argument has another type.

    Example:
        >>> plan = plan_race("seven_gates", *load_config("vehicles/cpc"))
        >>> plan.lap.missed, plan.race_time < 7.2
        (0, True)
    """
    mpc = instance(MpcConfig() if mpc is None else mpc, "mpc", MpcConfig)
    simulator = SimulatorConfig() if simulator is None else simulator
    simulator = instance(simulator, "simulator", SimulatorConfig)
    reference = ReferenceConfig() if reference is None else reference
    reference = instance(reference, "reference", ReferenceConfig)
    gate_margin = number(gate_margin, "gate_margin", least=0.0, below=100.0)
    radius = number(radius, "radius", least=0.0, below=10.0)
    step = number(step, "step", above=0.004, below=0.5)
    course = gates if isinstance(gates, Course) else read_course(gates)
    vehicle = planned_vehicle(mpc, simulator, reference)
    legs = legs_of(course, margin=gate_margin, radius=radius)
    heights = [_HEIGHT_RATIO * place[2] for place in course.places()]
    lowest = float(min(_MIN_HEIGHT, course.start[2], *heights))
    model = model_of(vehicle, start=course.start, start_yaw=course.start_yaw, lowest=lowest)
    point = flown_by_a_point(course, legs, vehicle, lowest=lowest)
    guesses = (
        with_attitudes(point, vehicle, yaw=course.start_yaw, longest_step=longest_step)
        for longest_step in (step, 0.7 * step)
    )
    return _plan(course, legs, vehicle, model, _solved(course, legs, model, guesses))


def _solved(
    course: Course,
    legs: list[CourseLeg],
    model: Dynamics,
    guesses: Iterable[Nodes],
) -> Solved:
    """Return the solution from the first guess that leads to one."""
    for guess in guesses:
        solved = solve(legs, model, guess, name="vehicle", most_iterations=_MAX_ITERATIONS)
        if solved.optimal:
            return solved
    raise UserError(
        f"{course.source}: no plan found ({solved.status} after {solved.iterations} iterations): "
        "check that the gates are reachable in order, the openings are larger than the margin, "
        "and the limits are the vehicle's"
    )


def _plan(
    course: Course, legs: list[CourseLeg], vehicle: PlannedVehicle, model: Dynamics, solved: Solved
) -> RacePlan:
    nodes = solved.nodes
    table = _table(model, nodes, source=f"the plan of {course.source}")
    raced = sum(leg.goal is not None for leg in legs)
    return RacePlan(
        course=course,
        table=table,
        nodes=nodes,
        vehicle=vehicle,
        race_time=float(nodes.times[nodes.ends[raced - 1]]),
        lap=passages(course, seconds=table.seconds, p_WB=table.p_WB),
        iterations=solved.iterations,
    )


def _table(model: Dynamics, nodes: Nodes, *, source: str) -> MotionTable:
    """Return the motion, sampled between the nodes with the model of the plan."""
    counts = np.ceil(nodes.steps / _ROW_PERIOD - 1e-9).astype(int)
    owner = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    since = place * (nodes.steps / counts)[owner]
    begin, inputs = nodes.states[:-1][owner].T, nodes.inputs[owner].T
    x = np.array(model.step.map(len(owner))(begin, inputs, since[None])).T
    x, inputs = np.vstack((x, nodes.states[-1:])), np.column_stack((inputs, nodes.inputs[-1]))
    a = np.array(model.acceleration.map(len(x))(x.T, inputs)).T
    q_xyzw = np.roll(x[:, Q], -1, axis=1)
    return MotionTable(
        source=source,
        seconds=np.append(nodes.times[:-1][owner] + since, nodes.times[-1]),
        p_WB=x[:, P],
        v_WB_W=x[:, V],
        a_WB_W=a,
        q_WB_xyzw=q_xyzw / np.linalg.norm(q_xyzw, axis=1, keepdims=True),
        w_WB_B=x[:, W],
    )
