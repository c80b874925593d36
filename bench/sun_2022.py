# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the table of Sun et al. (T-RO 2022) and write it beside their figures.

python bench/sun_2022.py --out runs/sun_2022

Each cell is the mean over 76 references of the position's RMSE by the truth, with what crashed
counted as 5 m: docs/measurements/published_tables.md. ``flights.csv`` has every flight,
``table.csv`` and ``table.md`` the table. ``--config`` and ``--set`` change the controller,
``--conditions`` and ``--rows`` choose part of it, ``--infeasible`` takes the 68 other references.
"""

from __future__ import annotations

import argparse
import functools
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import published_table
from step_times import median_step_us

from quad_mpc_ros import load_config
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.references.configured import judged_trajectory
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.simulation.closed_loop import fly, start_on
from quad_mpc_ros.simulation.config import SimulatorConfig

SETTINGS = Path(__file__).with_suffix(".yaml")
FARTHEST = 5.0  # m outside of the reference's bounds is a crash, and counted as this
PUSH_BEGINS, PUSH_LASTS = 2.0, 5.0  # s
DRAG = (0.26, 0.28, 0.42)  # kg/s
ARM_TENTH = 0.014  # m
# Of infeasible references: near free fall at such speeds drag that differs leaves no attitude.
DRAG_ALIKE = "reference.drag=0.36"

# (acceleration, speed, aspect) of the level references up to 40 m/s^2 that cannot be flown: the
# heading turns too fast. Above 40 m/s^2 none can, upright none above 30 m/s^2.
TOO_FAST_TURNS = {
    *((20, 5, 5), (30, 5, 2), (30, 5, 5), (30, 10, 5)),
    *((40, 5, 2), (40, 5, 5), (40, 10, 5), (40, 15, 5)),
}


@dataclass(frozen=True, order=True)
class Course:
    """A reference of theirs: r = V^2/a, k = a/V, [r sin kt, r/n cos kt]."""

    plane: str
    acceleration: float  # m/s^2
    speed: float  # m/s
    aspect: int

    @property
    def feasible(self) -> bool:
        """Whether it is one of their 76."""
        if self.plane == "vertical":
            return self.acceleration <= 30
        turn = (self.acceleration, self.speed, self.aspect)
        return self.acceleration <= 40 and turn not in TOO_FAST_TURNS

    def assignments(self) -> tuple[str, ...]:
        """Return the parameters of the reference."""
        radius = self.speed**2 / self.acceleration
        heading = "centre" if self.plane == "horizontal" else "fixed"
        return (
            f"reference.ellipse_semi_axes=[{radius:.9f}, {radius / self.aspect:.9f}]",
            f"reference.ellipse_frequency={self.acceleration / self.speed:.9f}",
            f"reference.ellipse_plane={self.plane}",
            f"reference.ellipse_heading={heading}",
        )


COURSES = [
    Course(plane, float(a), float(v), n)
    for plane, a, v, n in itertools.product(
        ("horizontal", "vertical"), range(10, 70, 10), (5, 10, 15, 20), (1, 2, 5)
    )
]


def _drag(factor: float) -> tuple[str, ...]:
    return (f"simulator.airframe.drag_linear={[round(factor * each, 6) for each in DRAG]}",)


def _push(force: float) -> tuple[str, ...]:
    return (
        f"simulator.push.force=[{force}, 0.0, 0.0]",
        f"simulator.push.begin={PUSH_BEGINS}",
        f"simulator.push.duration={PUSH_LASTS}",
    )


@dataclass(frozen=True)
class Condition:
    """Perturbations that are not configured, with the published RMSE [m] and crashes [%]."""

    name: str
    effects: tuple[str, ...] = ()
    latency: float = 0.0  # s, of the odometry
    nmpc: str = ""
    indi: str = ""
    dfbc: str = ""


CONDITIONS = [
    Condition("baseline", (), 0.0, "0.084", "0.082", "0.085"),
    Condition("drag +50 %", _drag(1.5), 0.0, "0.183", "0.184", "0.194"),
    Condition("drag +100 %", _drag(2.0), 0.0, "0.286", "0.288", "0.306"),
    Condition("mass -30 %", ("simulator.mass_scale=0.7",), 0.0, "0.320", "0.320", "0.477"),
    Condition(
        "mass +30 %", ("simulator.mass_scale=1.3",), 0.0, "0.809 (10.7)", "0.747 (9.3)", "0.686"
    ),
    Condition(
        "thrust -30 %",
        ("simulator.thrust_scale=0.7",),
        0.0,
        "0.939 (10.7)",
        "1.362 (18.7)",
        "1.004 (1.3)",
    ),
    Condition("thrust +30 %", ("simulator.thrust_scale=1.3",), 0.0, "0.245", "0.244", "0.359"),
    Condition(
        "centre of mass 10 % off",
        (f"simulator.airframe.center_of_mass=[{ARM_TENTH}, 0.0, 0.0]",),
        0.0,
        "0.264",
        "0.081",
        "0.099",
    ),
    Condition("push of 5 N", _push(5.0), 0.0, "0.252", "0.254", "0.302"),
    Condition("push of 10 N", _push(10.0), 0.0, "0.716 (5.3)", "0.725 (5.3)", "0.690 (1.3)"),
    Condition("push of 15 N", _push(15.0), 0.0, "1.870 (26.7)", "1.872 (26.7)", "1.393 (6.7)"),
    Condition("latency 10 ms", (), 0.01, "0.085", "0.087", "0.099"),
    Condition("latency 30 ms", (), 0.03, "0.158", "0.280 (2.7)", "0.265 (2.7)"),
    Condition("latency 50 ms", (), 0.05, "3.450 (66.7)", "3.480 (68)", "0.694 (6.7)"),
]

ROWS = {
    "off": "mpc.estimate_disturbance=false",
    "on": "mpc.estimate_disturbance=true",
    "declared": "mpc.estimate_disturbance=true",
}
"""Estimator off, on, and on with true stamps and the latency configured, if there is any."""


@dataclass(frozen=True)
class Job:
    """One flight and its cell in the table."""

    condition: str
    row: str
    course: Course
    sources: tuple[str, ...]
    assignments: tuple[str, ...]


@dataclass(frozen=True)
class Flown:
    """Result of a flight; ``rmse`` and ``largest`` [m] are of the true position.

    ``step_us`` is the median time of a step of the controller [us].
    """

    job: Job
    rmse: float
    largest: float
    crashed: bool
    fallbacks: int
    step_us: float

    @property
    def name(self) -> str:
        """Columns that identify the flight."""
        return f"{self.job.condition}, {self.job.row}: {self.job.course}"

    def cells(self) -> dict[str, Any]:
        """Return the result as a row of ``flights.csv``."""
        job, course = self.job, self.job.course
        return {
            "condition": job.condition,
            "row": job.row,
            "plane": course.plane,
            "acceleration": course.acceleration,
            "speed": course.speed,
            "aspect": course.aspect,
            "rmse_m": f"{self.rmse:.6f}",
            "largest_m": f"{self.largest:.6f}",
            "crashed": int(self.crashed),
            "fallbacks": self.fallbacks,
        }


def jobs(arguments: argparse.Namespace) -> Iterator[Job]:
    """Yield the flights that are asked for."""
    courses = [each for each in COURSES if each.feasible != arguments.infeasible]
    sources = ("vehicles/sun_2022", str(SETTINGS), *arguments.config)
    for condition in CONDITIONS:
        if arguments.conditions and condition.name not in arguments.conditions:
            continue
        for row, estimator in ROWS.items():
            if row not in arguments.rows or (row == "declared" and not condition.latency):
                continue
            for course in courses:
                yield Job(
                    condition.name,
                    row,
                    course,
                    sources,
                    (
                        f"simulator.duration={arguments.duration}",
                        *course.assignments(),
                        *condition.effects,
                        *_latency(condition.latency, sources, declared=row == "declared"),
                        estimator,
                        *([] if course.feasible else [DRAG_ALIKE]),
                        *arguments.set,
                    ),
                )


def _latency(latency: float, sources: tuple[str, ...], *, declared: bool) -> tuple[str, ...]:
    if not latency:
        return ()
    if not declared:
        return (f"simulator.odom_delay={latency}", "simulator.odom_stamp=sent")
    known = _loaded(sources, ()).mpc.input_delay + latency
    return (f"simulator.odom_delay={latency}", f"mpc.input_delay={known:.6f}")


@functools.lru_cache(maxsize=8)
def _loaded(sources: tuple[str, ...], assignments: tuple[str, ...]) -> FlightConfig:
    return load_config(*sources, assignments=assignments)


def flown(job: Job) -> Flown:
    """Fly, from a start on the reference."""
    mpc, simulator, reference = _loaded(job.sources, job.assignments)
    trajectory, _ = judged_trajectory(reference)  # also one that the vehicle cannot fly
    start = _start(trajectory, simulator)
    places, wanted, ticks, fallbacks = [], [], [], 0
    for step in fly(
        mpc=mpc,
        simulator=simulator.updated(start),
        reference=reference,
        trajectory=trajectory,
        controller=warmed_up(mpc),
    ):
        ticks.append(step.tick)
        places.append(step.truth.p_WB)
        wanted.append(step.window.p_WB[0])
        fallbacks += step.tick is None or step.tick.stats.source != "mpc"
    p, reference_p = np.array(places), np.array(wanted)
    round_once = trajectory.at(
        np.linspace(0, trajectory.period_ns, 1000).astype(int).tolist()
    ).p_WB
    outside = p - np.clip(p, round_once.min(axis=0), round_once.max(axis=0))
    crashed = bool(np.linalg.norm(outside, axis=1).max() > FARTHEST)
    error = np.linalg.norm(p - reference_p, axis=1)
    rmse = float(np.sqrt(np.mean(error**2)))
    return Flown(
        job,
        rmse=FARTHEST if crashed else rmse,
        largest=float(error.max()),
        crashed=crashed,
        fallbacks=fallbacks,
        step_us=median_step_us(ticks, mpc.controller),
    )


def _start(trajectory: Trajectory, simulator: SimulatorConfig) -> dict[str, Any]:
    """Return a start on the reference with the throttle of the vehicle that is expected.

    It is asked of one with thrust to spare, for the throttle is linear in the thrust.
    """
    spare = 4.0
    expected = simulator.updated({"mass_scale": 1.0, "thrust_scale": spare})
    start = start_on(trajectory, expected)
    start["initial_throttle"] = min(spare * start["initial_throttle"], 1.0)
    return start


def cell(flights: list[Flown]) -> str:
    """Return the mean RMSE of a cell, with the share of crashes if there are any."""
    if not flights:
        return ""
    mean = float(np.mean([each.rmse for each in flights]))
    crashes = 100.0 * float(np.mean([each.crashed for each in flights]))
    return f"{mean:.3f}" + (f" ({crashes:.1f})" if crashes else "")


def table(flights: list[Flown]) -> list[list[str]]:
    """Return header and rows of the table."""
    header = [
        "condition",
        "NMPC",
        "NMPC + INDI",
        "DFBC + INDI",
        "off",
        "on",
        "on, latency known",
    ]
    lines = [header]
    for condition in CONDITIONS:
        cells = [
            cell([f for f in flights if (f.job.condition, f.job.row) == (condition.name, row)])
            for row in ROWS
        ]
        if any(cells):
            lines.append([condition.name, condition.nmpc, condition.indi, condition.dfbc, *cells])
    return lines


def parsed(given: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the arguments of a command line."""
    parser = published_table.parser(__doc__, name="sun_2022", rows=ROWS)
    parser.add_argument("--duration", type=float, default=10.0, help="of a flight [s]")
    parser.add_argument("--conditions", nargs="*", choices=[c.name for c in CONDITIONS])
    parser.add_argument("--infeasible", action="store_true")
    return parser.parse_args(given)


def main() -> None:
    """Fly and write."""
    arguments = parsed()
    done = published_table.all_flown(flown, [*jobs(arguments)], arguments.workers)
    published_table.write(arguments.out, done, table(done))


if __name__ == "__main__":
    main()
