# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identify vehicles of a campaign from their own flights, and fly the same flights again.

python bench/identified_unknown.py lemniscate --seed 5 --flights 21

Each vehicle is flown as the campaign says, in the same wind, gusts and noise: as unknown, then
with what ``identify`` finds in that first flight, then with the true parameters, which is the
floor; with the weights of the default and of ``agile``. For each a line: RMSE of the true
position [cm] over the flight and from the campaign's ``settle_time`` on, ``lost`` if it crashed;
with ``--found`` also the identified and the true parameters. The last lines count the flights
within 2 cm. ``--without`` leaves gusts or wind out of the flights with identified and with true
parameters. docs/measurements/robustness.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from identified import identified

from quad_mpc_ros import load_config
from quad_mpc_ros.analysis.identification.report import parameter_file
from quad_mpc_ros.analysis.identification.result import Identification
from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.model.vehicle import LATENCY_UNCERTAINTY
from quad_mpc_ros.extras.campaigns.campaign_file import located_campaign, read_campaign
from quad_mpc_ros.recordings.evaluation.crash import crash_of
from quad_mpc_ros.recordings.evaluation.metrics import position_errors
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, FlightLog
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

GOOD = 2.0  # cm
CALM: Mapping[str, Any] = {"gusts": ("gust_intensity", 0.0), "wind": ("wind", (0.0, 0.0, 0.0))}
FLIGHTS = ("unknown", "found", "truth", "agile, found", "agile, truth")
_WEIGHTS = ("horizon_steps", "horizon_step", "Q", "R", "terminal_weight", "limits.tilt_max")

VehicleParameters = Mapping[str, Mapping[str, Any]]
"""Parameters of the vehicle by node, mpc and reference."""


def rmse(config: FlightConfig, *, settle_time: float) -> tuple[float, float]:
    """Return the RMSE of the true position over a flight, and settled [cm]; NaN if it crashed."""
    log = FlightLog(config.mpc)
    for step in fly(mpc=config.mpc, simulator=config.simulator, reference=config.reference):
        log.take(step)
    truth = log.with_truth(log.flight(config))
    error = position_errors(truth)
    if crash_of(truth):
        return math.nan, math.nan
    parts = error, error[truth.time >= settle_time]
    whole, settled = (100.0 * math.sqrt(np.mean(part**2)) for part in parts)
    return whole, settled


def truth_of(simulator: SimulatorConfig) -> VehicleParameters:
    """Return the true parameters of the plant ``internal``, as in a vehicle file."""
    air = {name: getattr(simulator, name) for name in ("drag", "rotor_drag", "translational_lift")}
    vehicle = simulator.vehicle()
    known = {
        **air,
        "mass": vehicle.mass,
        "thrust_curve": vehicle.thrust_curve,
        "rate_time_constant": simulator.rate_time_constant,
        "torque_time_constant": simulator.torque_time_constant,
        "rate_gain": simulator.rate_gain,
        "thrust_time_constant": simulator.thrust_time_constant,
        "input_delay": simulator.command_delay + simulator.odom_delay,
        "latency_uncertainty": LATENCY_UNCERTAINTY[0],
    }
    return {"mpc": known, "reference": {**air, "thrust_curve": vehicle.thrust_curve}}


def identified_parameters(found: Identification, config: FlightConfig) -> VehicleParameters:
    """Return the parameters in the vehicle file that ``identify`` writes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "found.yaml"
        file.write_text(parameter_file(found, config.mpc, bag=Path("flight"), keep="mass"))
        loaded = load_config(str(file))
    names = truth_of(config.simulator)
    return {
        node: {name: getattr(getattr(loaded, node), name) for name in names[node]}
        for node in ("mpc", "reference")
    }


def configured(
    config: FlightConfig, parameters: VehicleParameters, *, agile: bool
) -> FlightConfig:
    """Return a flight with these parameters of the vehicle in mpc and reference."""
    given = load_config("agile").mpc.flattened() if agile else {}
    weights = {name: given[name] for name in _WEIGHTS if name in given}
    return config._replace(
        mpc=config.mpc.updated({**weights, **parameters["mpc"]}),
        reference=config.reference.updated(parameters["reference"]),
    )


def flights(
    config: FlightConfig, calmed: Mapping[str, Any]
) -> tuple[list[FlightConfig], VehicleParameters]:
    """Return all :data:`FLIGHTS` of a vehicle, and what was found in the first."""
    begun = config._replace(mpc=dataclasses.replace(config.mpc, lockstep=True))
    found, true = identified_parameters(identified(begun), config), truth_of(config.simulator)
    calm = config._replace(simulator=config.simulator.updated(calmed))
    weights = itertools.product((False, True), (found, true))
    others = (configured(calm, parameters, agile=agile) for agile, parameters in weights)
    return [config, *others], found


def compared(found: VehicleParameters, simulator: SimulatorConfig) -> Iterator[str]:
    """Yield what was found over the truth: lags and delay [ms], thrust, drag [1/s]."""
    one, true = found["mpc"], truth_of(simulator)["mpc"]
    for name, unit in (
        ("rate_time_constant", 1e3),
        ("thrust_time_constant", 1e3),
        ("input_delay", 1e3),
        ("latency_uncertainty", 1e3),
        ("drag", 1.0),
    ):
        values = ", ".join(f"{unit * value:.3g}" for value in dict.fromkeys(per_axis(one[name])))
        yield f"{name} {values} / {unit * per_axis(true[name])[0]:.3g}"
    yield f"thrust {one['thrust_curve'][0] / true['thrust_curve'][0]:.3f}"
    yield f"gusts {simulator.gust_intensity:.2f} m/s at {simulator.odom_rate:.0f} Hz"


def cell(whole: float, settled: float) -> str:
    """Return two RMSE [cm] as text."""
    return f"{'lost':>14}" if math.isnan(whole) else f"{whole:8.2f} {settled:5.2f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("campaign", help="name of a shipped campaign, or a file")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--flights", type=int, default=21)
    parser.add_argument("--found", action="store_true", help="print what was found, too")
    parser.add_argument("--without", nargs="+", default=[], choices=CALM)
    options = parser.parse_args(arguments)
    campaign = read_campaign(located_campaign(Path(options.campaign)))
    campaign = dataclasses.replace(campaign, seed=options.seed, flights=options.flights)
    calmed = dict(CALM[name] for name in options.without)
    print("      ", *(f"{name:>14}" for name in FLIGHTS))
    every = []
    for number in range(options.flights):
        config = campaign.plan(number).config
        flown, found = flights(config, calmed)
        row = [rmse(each, settle_time=campaign.settle_time) for each in flown]
        every.append(row)
        print(f"{number:6d}", *(cell(*each) for each in row), flush=True)
        if options.found:
            print("       ", "; ".join(compared(found, config.simulator)), flush=True)
    table = np.array(every)
    within, worst = np.sum(table <= GOOD, axis=0), np.nanmax(table, axis=0)
    print("within", *(f"{whole:8d} {settled:5d}" for whole, settled in within))
    print("worst ", *(cell(*each) for each in worst))
    return 0


if __name__ == "__main__":
    sys.exit(main())
