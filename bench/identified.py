# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identify vehicles of the plant rotors from noisy flights, and fly the identified models.

python bench/identified.py sun_2022 paper --seeds 20

Every flight begins by the defaults' lags, delay and drag: 20 s of ``excitation`` with noise of
1 cm, 0.5 degrees and 0.05 m/s. Of each number it prints the truth, the mean found, the largest
error, the mean half width, and how many intervals held the truth of how many claimed. Drag, lift
and thrust are held against the plant's own; of body and rotors their sum, the drag in hover. Its
rate loop is of second order: no lag of its is the model's. Lags, gains and delay are held against
their mean (~), and a lag and the delay together against the mean time by which a small step is
answered, without an integral and air. Last, for each seed, the RMSE of the lemniscate at
2.0 rad/s, or the fastest that can be flown, by ``agile`` without noise. ``--wide`` takes the
flight that is proposed for drag and lift. docs/howto/identify.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros import load_config, simulate
from quad_mpc_ros.analysis.identification.fit import fit
from quad_mpc_ros.analysis.identification.measurements import measurements_of
from quad_mpc_ros.analysis.identification.report import parameter_file
from quad_mpc_ros.analysis.identification.result import Identification, ParameterEstimate
from quad_mpc_ros.configuration import ConfigurationError, per_axis
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.recordings.logs import Log, Received
from quad_mpc_ros.recordings.run import RecordedRun
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant

VEHICLES = ("crazyflie", "hummingbird", "paper", "racer", "sun_2022")
GUESS = (
    *("mpc.rate_time_constant=0.07", "mpc.thrust_time_constant=0.04", "mpc.input_delay=0.02"),
    *(f"{node}.drag=0.2" for node in ("mpc", "reference")),
    *(f"{node}.rotor_drag=0.0" for node in ("mpc", "reference")),
    *(f"{node}.translational_lift=0.0" for node in ("mpc", "reference")),
)
NOISE = (
    "simulator.position_noise=0.01",
    f"simulator.attitude_noise={math.radians(0.5)}",
    "simulator.velocity_noise=0.05",
)
WIDE = (
    "reference.excitation_reach=[6.0,6.0,2.0]",
    "reference.excitation_speed=8.0",
    "reference.excitation_tilt=0.8",
)
DURATION = 20.0  # s
FASTEST = (2.0, 1.9, 1.8, 1.7, 1.6, 1.5, 1.4, 1.3, 1.2, 1.1, 1.0)  # rad/s

_STILL: dict[str, Any] = {
    "airframe.drag_linear": (0.0, 0.0, 0.0),
    "airframe.drag_quadratic": (0.0, 0.0, 0.0),
    "airframe.translational_lift": 0.0,
    "rotors.inflow_loss": 0.0,
    "rotors.drag": 0.0,
    "rate_loop.i": (0.0, 0.0, 0.0),
    "initial_position": (0.0, 0.0, 50.0),
}
_STEPS = {"x": 0.2, "y": 0.2, "z": 0.05, "thrust": 0.02}  # rad/s, and of hover's throttle
_MILLISECOND = 1_000_000


def excited(vehicle: str, extra: Sequence[str]) -> FlightConfig:
    """Return the flight that is identified: by the defaults' guesses."""
    course = ("reference.trajectory=excitation", f"reference.excitation_duration={DURATION}")
    config = load_config("default", f"vehicles/{vehicle}", assignments=(*GUESS, *course, *extra))
    return config._replace(
        mpc=dataclasses.replace(config.mpc, lockstep=True),
        simulator=dataclasses.replace(config.simulator, duration=DURATION + 0.5),
    )


def recorded(config: FlightConfig) -> RecordedRun:
    """Return a flight as it is recorded."""
    odometries, commands = Log(OdometrySample), Log(CommandSample)
    for step in fly(mpc=config.mpc, simulator=config.simulator, reference=config.reference):
        times = {"log_time_ns": step.sent_ns, "publish_time_ns": step.sent_ns}
        odometries.append(Received(value=step.odometry, **times))
        if step.command is not None:
            commands.append(Received(value=step.command, **times))
    return RecordedRun(
        bag=Path("excited"),
        odometries=odometries,
        windows=[],
        commands=commands,
        stats=[],
        parameters={},
    )


def identified(config: FlightConfig) -> Identification:
    """Return the identification of a flight."""
    mpc = config.mpc
    data = measurements_of(
        recorded(config), vehicle=mpc.vehicle(), twist_frame=mpc.odometry.twist_frame
    )
    return fit(data, given=mpc)


def estimates(found: Identification) -> Iterator[tuple[str, ParameterEstimate]]:
    """Yield the identified values by name; the drag is the drag in hover."""
    rates = found.rate_time_constant
    yield from ((f"rates' lag {axis}", one) for axis, one in zip("xyz", rates, strict=True))
    yield "thrust's lag", found.thrust_time_constant
    yield "delay", found.input_delay
    for axis, one in zip("xyz", rates, strict=True):
        yield f"rates' lag {axis} + delay", both(one, found.input_delay)
    yield "thrust's lag + delay", both(found.thrust_time_constant, found.input_delay)
    yield from ((f"gain {axis}", one) for axis, one in zip("xyz", found.rate_gain, strict=True))
    yield "thrust per mass", found.thrust_scale
    for axis, body, rotors in zip("xyz", found.drag, found.rotor_drag, strict=True):
        if rotors.observable:
            # The one is known as well as the other leaves it, their sum as well as the lesser.
            yield f"rotor_drag {axis}", rotors
            yield f"drag {axis}", dataclasses.replace(both(body, rotors), half_width=math.nan)
        else:
            yield f"drag {axis}", body
    yield "lift", found.translational_lift


def both(one: ParameterEstimate, other: ParameterEstimate) -> ParameterEstimate:
    """Return the sum of two."""
    return dataclasses.replace(
        one,
        value=one.value + other.value,
        half_width=one.half_width + other.half_width,
        observable=one.observable and other.observable,
    )


def truth(vehicle: str) -> dict[str, float]:
    """Return the plant's own numbers: drag in hover [1/s], lift [1/m], thrust, answers [s]."""
    mpc = load_config(f"vehicles/{vehicle}").mpc
    own = {"thrust per mass": 1.0, "lift": mpc.translational_lift}
    for axis, body, rotors in zip(
        "xyz", per_axis(mpc.drag), per_axis(mpc.rotor_drag), strict=True
    ):
        own |= {f"drag {axis}": body + rotors, f"rotor_drag {axis}": rotors}
    for axis in "xyz":
        own[f"rates' lag {axis} + delay"] = answered(vehicle, axis)
    return own | {"thrust's lag + delay": answered(vehicle, "thrust")}


def answered(vehicle: str, channel: str) -> float:
    """Return the mean time by which a small step at hover is answered [s]."""
    config = load_config(f"vehicles/{vehicle}").simulator
    hover = config.vehicle().hover_throttle
    plant = RotorsPlant(config.updated({**_STILL, "initial_throttle": hover}))
    step, rates = _STEPS[channel], np.zeros(3)
    if channel != "thrust":
        rates["xyz".index(channel)] = step
    throttle = hover * (1.0 + step) if channel == "thrust" else hover
    plant.apply(CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=rates))
    seen, before = [], 0.0
    for k in range(1, 1000):
        plant.advance_to(k * _MILLISECOND)
        odometry = plant.odometry(0)
        if channel == "thrust":
            seen.append(float(odometry.v_WB_B[2]) - before)
            before = float(odometry.v_WB_B[2])
        else:
            seen.append(float(odometry.w_WB_B["xyz".index(channel)]))
    return float(np.sum(1.0 - np.array(seen) / seen[-1])) * 1e-3


def table(vehicle: str, found: Sequence[Identification]) -> Iterator[str]:
    """Yield the lines about a vehicle, one for each number that a flight claims."""
    own, every = truth(vehicle), [dict(estimates(each)) for each in found]
    yield f"{vehicle:26} {'truth':>8} {'mean':>8} {'off most':>8} {'+- 95 %':>8}  held  of"
    for name in dict.fromkeys(name for each in every for name in each):
        claims = [each[name] for each in every if name in each and each[name].observable]
        if not claims:
            continue
        values = np.array([claim.value for claim in claims])
        width = np.array([claim.half_width for claim in claims])
        true = own.get(name, float(values.mean()))
        off, known = np.abs(values - true), np.isfinite(width)
        held = f"{np.sum(off[known] <= width[known]):4d}  {known.sum():4d}" if known.any() else ""
        mean_width = f"{width[known].mean():8.4f}" if known.any() else f"{'-':>8}"
        mark = " " if name in own else "~"
        numbers = f"{mark}{true:8.4f} {values.mean():8.4f} {off.max():8.4f} {mean_width}"
        yield f"  {name:23} {numbers}  {held}"


def flown(vehicle: str, found: Identification, given: FlightConfig) -> tuple[str, float]:
    """Return the lemniscate that is flown with what was found, and its RMSE [m]."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "found.yaml"
        file.write_text(parameter_file(found, given.mpc, bag=Path("excited"), keep="mass"))
        for frequency in FASTEST:
            course = f"reference.angular_frequency={frequency}"
            config = load_config(
                *("agile", f"vehicles/{vehicle}", str(file)),
                assignments=("reference.trajectory=lemniscate", course),
            )
            try:
                flight = simulate(*config, duration=10.0, on_reference=True)
            except ConfigurationError:  # faster than its rates or its thrust
                continue
            error = np.linalg.norm(flight.p_WB - flight.reference.p_WB, axis=1)
            return f"lemniscate at {frequency} rad/s", math.sqrt(np.mean(error**2))
    return "no lemniscate", math.nan


def main(given: Sequence[str]) -> int:
    """Identify the vehicles that are named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("vehicles", nargs="*", default=VEHICLES, metavar="VEHICLE")
    parser.add_argument("--seeds", type=int, default=20, help="flights of each (default: 20)")
    parser.add_argument("--wide", action="store_true", help="in 12 m by 12 m by 4 m, to 8 m/s")
    parser.add_argument("--set", action="append", default=[], metavar="NODE.PARAMETER=VALUE")
    options = parser.parse_args(given)
    extra = (*(WIDE if options.wide else ()), *options.set)
    for vehicle in options.vehicles:
        noisy = [
            excited(vehicle, (*extra, *NOISE, f"simulator.seed={seed}"))
            for seed in range(options.seeds)
        ]
        found = [identified(config) for config in noisy]
        print("\n".join(table(vehicle, found)))
        flights = [flown(vehicle, *each) for each in zip(found, noisy, strict=True)]
        name, errors = flights[0][0], 100.0 * np.array([error for _, error in flights])
        print(f"  {name}: RMSE {errors.min():.2f} to {errors.max():.2f} cm\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
