# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the MPC and the other controllers side by side, and write docs/measurements/controllers.md.

    python bench/controllers.py --flights 500

All controllers of a row fly the same vehicles, odometry, delays, limits and failsafe.
``--flights`` is the number of flights of the campaigns ``hover`` and ``lemniscate``; the other
numbers are fixed. RAPTOR flies only on plants with rotors. It needs ``quad_mpc_ros[raptor]``,
acados ``quad_mpc_ros[bench]``, AdaptiveQuadBench rotorpy, and the vehicles of l2f the package l2f
(see bench/l2f_vehicles.py). With ``--cells FILE`` an interrupted run continues. The times are
those of the first flight of each row, flown alone after all others. ``--page`` is where the
page goes; without it the table is printed.
"""

from __future__ import annotations

import argparse
import datetime
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import adaptive_quad_bench
import l2f_vehicles
import numpy as np
import sun_2022
from markdown_table import markdown_table

from quad_mpc_ros import simulate, summarise
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.campaign_file import (
    Overrides,
    campaign_from,
    located_campaign,
    read_campaign,
)
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched

ACADOS = "peers.acados:AcadosController"
CONTROLLERS = {
    "mpc": "MPC",
    "geometric": "geometric",
    "px4": "PX4",
    "lqr": "LQR",
    ACADOS: "acados",
    "raptor": "RAPTOR",
}
GAINS = {
    "mpc": ("preset `default`", "lags, delay; estimates thrust, wind and lags"),
    "geometric": ("rotorpy's, for Lee, Leok and McClamroch 2010", "rigid body"),
    "px4": ("defaults of PX4's position and attitude controllers", "none; has an integral"),
    "lqr": ("`Q` and `R` of the MPC", "lag of the body rates"),
    ACADOS: ("`Q`, `R`, limits and horizon of the MPC", "rigid body with drag"),
    "raptor": ("learned; checkpoint of `foundation-policy` 1.0.2", "learned in flight"),
}
_VEHICLE: dict[str, Any] = {
    # As configured in the MPC, with the noise of the large campaigns.
    "simulator.rate_time_constant": {"same_as": "mpc.rate_time_constant"},
    "simulator.torque_time_constant": {"same_as": "mpc.torque_time_constant"},
    "simulator.thrust_time_constant": {"same_as": "mpc.thrust_time_constant"},
    "simulator.command_delay": {"same_as": "mpc.input_delay"},
    "simulator.seed": {"integers": [0, 1000000]},
}
_NOISE = {
    "simulator.position_noise": 0.003,
    "simulator.attitude_noise": 0.003,
    "simulator.velocity_noise": 0.02,
    "simulator.rate_noise": 0.02,
}
# Otherwise the failsafe would end flights with a constant error or an oscillation.
_WARN_ONLY = ("mpc.consistency.action=warn", "mpc.advanced.oscillation.action=warn")
_SMALL, _DELAYED = 10, 16  # flights of the rows with one vehicle
_LOOPS, _DRIFTS, _L2F_VEHICLES = 64, 16, 24
_EVERY, _TRIALS = 3, 20  # of Sun et al.'s 14 x 76 flights; all trials of each family
_SPEED = float(np.hypot(3.0, 3.0))  # m/s of the lemniscate at 1 rad/s, at its centre


Results = list[tuple[bool, float | None]]
"""Of each flight whether it crashed, and its error [m]."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row: a campaign, the column of its table that is the error, and why it is as it is."""

    name: str
    content: Mapping[str, Any] | str
    why: str
    error: str = "settled_error_mean_m"
    flights: int = 0  # of a campaign file, 0 for those of the command line

    def campaign(self, controller: str, flights: int) -> Campaign:
        """Return the campaign, flown by a controller; ``flights`` for those of a file."""
        assignments = [f"mpc.controller={controller}", *_WARN_ONLY]
        if isinstance(self.content, str):
            overrides = Overrides(
                config=[], assignments=assignments, flights=min(self.flights or flights, flights)
            )
            return read_campaign(located_campaign(Path(self.content)), overrides)
        return campaign_from(self.content, Overrides(config=[], assignments=assignments))

    def flies(self, controller: str) -> bool:
        """Whether a controller flies this row, whose vehicles have no rotors."""
        return controller != "raptor"

    def fly(self, controller: str, flights: int, engine: LocalWorkers) -> Results:
        """Return for each flight whether it crashed, and its error [m]."""
        campaign = self.campaign(controller, flights)
        batches = engine.fly(campaign, batched(range(campaign.flights), workers=engine.workers))
        rows = [flight.row for flown in batches for flight in flown]
        failed = [row["error"] for row in rows if row.get("error")]
        if failed:
            raise UserError(f"{len(failed)} flights ended with an error: {failed[0]}")
        return [(bool(row["crashed"]), row[self.error]) for row in rows]


@dataclass(frozen=True, kw_only=True)
class BenchRow:
    """A row of another benchmark: its flights with a controller, and how they end."""

    name: str
    jobs: Callable[[tuple[str, ...]], Sequence[Any]]
    flown: Callable[[Any], Any]
    result: Callable[[Any], tuple[bool, float]]
    why: str
    has_rotors: bool = True

    def flies(self, controller: str) -> bool:
        """Whether a controller flies this row."""
        return self.has_rotors or controller != "raptor"

    def jobs_of(self, controller: str) -> Sequence[Any]:
        """Return the flights of a controller."""
        rates = ("mpc.control_rate=100", "simulator.odom_rate=100")
        assignments = (f"mpc.controller={controller}", *_WARN_ONLY)
        return self.jobs(assignments + rates if controller == "raptor" else assignments)

    def fly(self, controller: str, flights: int, engine: LocalWorkers) -> Results:
        """Return for each flight whether it crashed, and its error [m]."""
        with ProcessPoolExecutor(engine.workers) as pool:
            flown = pool.map(self.flown, self.jobs_of(controller))
            return [self.result(each) for each in flown]


def _l2f_jobs(given: tuple[str, ...], *, task: str, delay: float) -> list[l2f_vehicles.Flight]:
    set_ = (*given, f"simulator.command_delay={delay}")
    return [
        l2f_vehicles.Flight(vehicle=i, loop="tuned", task=task, assignments=set_)
        for i in range(_L2F_VEHICLES)
    ]


def _sun_jobs(given: tuple[str, ...]) -> list[sun_2022.Job]:
    jobs = sun_2022.jobs(sun_2022.parsed(["--rows", "on", "--set", *given]))
    return [*jobs][::_EVERY]


def _aqb_jobs(given: tuple[str, ...]) -> list[adaptive_quad_bench.Job]:
    options = ["--rows", "on", "--trials", str(_TRIALS), "--set", *given]
    return [*adaptive_quad_bench.jobs(adaptive_quad_bench.parsed(options))]


def _one_vehicle(reference: str, duration: float, **changes: float) -> dict[str, Any]:
    return {
        "flights": _SMALL,
        "seed": 1,
        "reference": reference,
        "duration": duration,
        "settle_time": 4.0,
        "set": {**_NOISE, **{f"reference.{name}": value for name, value in changes.items()}},
        "vary": _VEHICLE,
    }


def _late(by_ms: int) -> dict[str, Any]:
    delay = {"same_as": "mpc.input_delay", "plus": 1e-3 * by_ms}
    position = {"uniform": [[-0.4, -0.4, 1.6], [0.4, 0.4, 2.4]]}
    return {
        "flights": _DELAYED,
        "seed": 1,
        "reference": "hover",
        "duration": 10.0,
        "settle_time": 5.0,
        "start": "reference",
        "set": _NOISE,
        "vary": {
            **_VEHICLE,
            "simulator.initial_position": position,
            "simulator.command_delay": delay,
        },
    }


ROWS = (
    Row(
        name="square, error at the corners",
        content=_one_vehicle("square", 12.0),
        error="waypoint_error_max_m",
        why="the MPC settles within the 2 s at a corner. The other controllers approach more "
        "slowly, the LQR because its position error is bounded.",
    ),
    Row(
        name="lemniscate, 2 m/s",
        content=_one_vehicle("lemniscate", 14.0, angular_frequency=2.0 / _SPEED),
        why="acados is closest. The disturbance that the MPC estimates follows the noise: without "
        "estimation the MPC is 0.3 cm off, and wind displaces it. The other controllers fall "
        "behind by the lags, PX4 most, because it has no setpoint for roll and pitch rates.",
    ),
    Row(
        name="lemniscate, 8 m/s",
        content=_one_vehicle("lemniscate", 14.0, angular_frequency=8.0 / _SPEED),
        why="the reference tilts by up to 65°, and PX4 limits the tilt to 45°. The attitude "
        "loop of the geometric controller lags. The LQR and acados model neither delay nor "
        "thrust lag and turn over.",
    ),
    Row(
        name="campaign `hover`",
        content="hover",
        why="the MPC estimates thrust and wind. The geometric controller has no integral, and "
        "the integral of PX4 is slow. The LQR and acados turn over where lags and delay are long.",
    ),
    Row(
        name="campaign `lemniscate`",
        content="lemniscate",
        why="the causes are those of the hover. PX4 also lacks a setpoint for roll and pitch "
        "rates.",
    ),
    Row(
        name="hover, modelled delay",
        content=_late(0),
        why="with the modelled delay all controllers hover. The LQR is close to instability.",
    ),
    Row(
        name="hover, 20 ms more delay",
        content=_late(20),
        why="20 ms make the LQR and acados unstable: their models have no delay, and `Q` and "
        "`R` demand high gains.",
    ),
    Row(
        name="hover, 40 ms more delay",
        content=_late(40),
        why="the MPC, the geometric controller and PX4 tolerate 40 ms.",
    ),
    Row(
        name="hover, 80 ms more delay",
        content=_late(80),
        why="the geometric controller oscillates. The weights of the MPC were chosen for this "
        "delay, and the gains of PX4 are low.",
    ),
    Row(
        name="hover, velocity errors of 0.2 m/s over 1 s",
        content={
            **_late(0),
            "flights": _DRIFTS,
            "set": {**_NOISE, "simulator.velocity_drift": 0.2},
        },
        why="the MPC estimates correlated errors of the velocity. The other controllers follow "
        "the measured velocity.",
    ),
    Row(
        name="campaign `rate_loops`",
        content="rate_loops",
        flights=_LOOPS,
        why="the rate loops ring with lags of 30 to 200 ms. The MPC estimates the lags. The other "
        "controllers do not, and the LQR and acados, with the highest gains, turn over.",
    ),
    BenchRow(
        name="Sun et al., 14 conditions",
        jobs=_sun_jobs,
        flown=sun_2022.flown,
        result=lambda flown: (flown.crashed, flown.rmse),
        why="the references accelerate with up to 40 m/s². PX4 limits the tilt to 45°. RAPTOR has "
        "no setpoint for acceleration and was trained at up to 1 m/s. The geometric controller "
        "has no integral. The LQR and acados crash with 50 ms of latency, pushes, or a mass or "
        "thrust 30 % off.",
    ),
    BenchRow(
        name="AdaptiveQuadBench, 7 families",
        jobs=_aqb_jobs,
        flown=adaptive_quad_bench.flown,
        result=lambda flown: (not flown.rmse <= adaptive_quad_bench.FAILED, flown.rmse),
        has_rotors=False,
        why="the MPC estimates the disturbance of each family within the 5 s of a flight; on this "
        "vehicle without lags and delay the high gains of the LQR are stable.",
    ),
    *(
        BenchRow(
            name=f"l2f, {task}{late}",
            jobs=partial(_l2f_jobs, task=task, delay=delay),
            flown=l2f_vehicles.result_of,
            result=lambda flown: (flown.crashed, flown.mean),
            why=why,
        )
        for task in ("hover", "lemniscate 1.0 rad/s")
        for delay, late, why in (
            (
                0.0,
                "",
                "RAPTOR receives neither mass nor thrust, and has a constant error and no "
                "setpoint for acceleration. The other controllers command a rate loop with the "
                "true inertia.",
            ),
            (
                0.02,
                ", commands 20 ms late",
                "RAPTOR was trained without delay. The MPC models the delay, and the low gains "
                "of PX4 tolerate the delay.",
            ),
        )
    ),
)

_PAGE = """\
# Controllers

The [controllers](../tutorials/your_controller.md) of this package in simulation, {date};
`python bench/controllers.py --flights {flights} --controllers {names}
--page docs/measurements/controllers.md` writes this page. All controllers get the same odometry,
reference, mass and thrust curve, and fly the same vehicles with the same limits. The failsafe of
the MPC only warns of oscillations and
contradictions, so that no failsafe ends a flight before the controller does. In the large
campaigns only the mass is configured ([ranges](robustness.md#random-vehicles)). In the other rows
the lags and the delay of the vehicle are those that the MPC models, plus the stated delay, with
the same noise.

{controllers}

*Mean*, *p95*: mean distance to the reference after settling, its mean and 95th percentile over
the completed flights. *Time*: median of a step of the controller alone, for the MPC including its
estimator. All are in Python, but the solvers and the functions of the MPC are compiled. *Crashed*
follows the [crash criteria](../howto/campaigns.md#crash-criteria). The gains of the other
controllers were not tuned for these vehicles.

RAPTOR commands rotors, so it flies only in l2f and in the conditions of Sun et al. In the example
of its authors (`python -P bench/raptor_example.py`) it hovers from 64 of 64 starts, 5.3 cm off.
Sun et al.: the baseline and 13 deviations, every third of 76 references. AdaptiveQuadBench: all 20
trials of each family. Both count the RMSE, and have their own criteria for crashes. In l2f, {l2f}
[vehicles](robustness.md#rate-loops-in-l2f) have the tuned rate loop. acados has neither lags,
delay nor a disturbance in its model: the difference shows their benefit for an MPC.

{table}

{why}
"""


def main() -> None:
    """Fly all rows with all controllers, and write or print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--controllers", nargs="*", choices=[*CONTROLLERS], default=[*CONTROLLERS])
    parser.add_argument("--page", type=Path)
    parser.add_argument("--cells", type=Path, help="file of finished cells, to continue a run")
    options = parser.parse_args()
    finished = Finished(options.cells)
    engine = LocalWorkers(options.workers)
    lines = []
    chosen = [each for each in product(ROWS, options.controllers) if each[0].flies(each[1])]
    for row, name in chosen:
        flown = partial(cells, row, name, options.flights, engine)
        found = finished.get(f"{row.name}, {name}, {options.flights} flights", flown)
        lines.append([row.name, CONTROLLERS[name], *found])
        print("  ".join(lines[-1]), file=sys.stderr, flush=True)
    # Last, when nothing else of this program runs.
    for line, (row, name) in zip(lines, chosen, strict=True):
        timed = partial(step_time, row, name)
        line += finished.get(f"{row.name}, {name}, time", timed)
    header = ["flights", "controller", "crashed", "mean [cm]", "p95 [cm]", "time [ms]"]
    table = markdown_table(header, lines, align="llrrrr")
    if options.page is None:
        print(table)
        return
    why = "\n".join(f"- *{row.name}*: {row.why}" for row in ROWS)
    date = datetime.date.today().isoformat()
    gains = [[CONTROLLERS[name], *GAINS[name]] for name in options.controllers]
    page = _PAGE.format(
        date=date,
        flights=options.flights,
        names=" ".join(options.controllers),
        controllers=markdown_table(["controller", "gains", "model"], gains),
        table=table,
        l2f=_L2F_VEHICLES,
        why=why,
    )
    options.page.write_text(page, encoding="utf-8")


def cells(row: Row | BenchRow, controller: str, flights: int, engine: LocalWorkers) -> list[str]:
    """Fly a row; return the crashes, and mean and p95 of the errors."""
    results = row.fly(controller, flights, engine)
    crashes = sum(crashed for crashed, _ in results)
    errors = [float(error) for crashed, error in results if not crashed and error is not None]
    return [f"{crashes} of {len(results)}", *_centimetres(errors)]


def _centimetres(errors: Sequence[float]) -> tuple[str, str]:
    if not errors:
        return "-", "-"
    p95 = float(np.percentile(errors, 95, method="inverted_cdf"))
    return f"{100 * np.mean(errors):.1f}", f"{100 * p95:.1f}"


class Finished:
    """Cells by their name, kept in a JSON file if there is one."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        exists = path is not None and path.is_file()
        self._cells: dict[str, list[str]] = json.loads(path.read_text()) if exists else {}

    def get(self, name: str, measure: Callable[[], list[str]]) -> list[str]:
        """Return the cells of a name, measured now if they are not there."""
        if name not in self._cells:
            self._cells[name] = measure()
            if self._path is not None:
                self._path.write_text(json.dumps(self._cells, indent=1))
        return self._cells[name]


def step_time(row: Row | BenchRow, controller: str) -> list[str]:
    """Fly the first flight alone; return the median time of a controller's step [ms]."""
    if isinstance(row, BenchRow):
        taken = row.flown(row.jobs_of(controller)[0]).step_us
    else:
        plan = row.campaign(controller, 1).plan(0)
        summary = summarise(simulate(*plan.config, trajectory=plan.trajectory))
        own = plan.config.mpc.controller != "mpc"
        taken = summary["solve_time_us" if own else "step_time_us"]["p50"]
    return [f"{1e-3 * taken:.2f}"]


if __name__ == "__main__":
    main()
