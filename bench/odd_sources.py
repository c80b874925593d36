# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly vehicles and odometries beyond the variations of the shipped campaigns.

python -P bench/odd_sources.py                                   # all, 60 flights each
python -P bench/odd_sources.py --only configured --flights 20    # those with this text in the name

Each source is flown on vehicles of the campaign ``hover`` or ``lemniscate``, with one thing odd
about all of them; the load on a cable on the plant ``mujoco``. The vehicles with a wrong
mass and thrust curve in the parameters of mpc fly with the plant ``rotors``, in wind of 4.5 m/s
and gusts of 1.5 m/s. Late odometries are delayed by the magnitude of a draw from N(0, 30 ms), in
order, and one of twenty is lost.

For each source a line: flights, crashed, and of the others, by the true state once settled, the
mean error in p50, p95 and at most, the largest error [cm], the largest tilt of all flights from
the start on [degrees], and how many flights the MPC left to its fallback for a while. A flight
that loses mass counts as settled from the moment on at which it does.
docs/measurements/robustness.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quad_mpc_ros import load_config
from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.campaigns.campaign import Campaign, FlightPlan
from quad_mpc_ros.extras.campaigns.campaign_file import (
    campaign_from,
    located_campaign,
    read_content,
)
from quad_mpc_ros.extras.campaigns.flight import figures_of
from quad_mpc_ros.recordings.evaluation.crash import crash_of
from quad_mpc_ros.recordings.evaluation.percentiles import percentiles
from quad_mpc_ros.recordings.evaluation.simulated import FlightLog
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.internal_plant import InternalPlant, constants

LOST_MASS, LOST_AT = 0.3, 5.0  # share, s
DROPOUT, JITTER = 0.05, 0.03  # share, s
LOAD = 0.2  # share of the vehicle's mass
WIND, GUSTS = 4.5, 1.5  # m/s
RECOVERED = 1.0  # m, largest settled error after tumbling
_LOOKS = 1000  # per second, that an odometry may arrive
FALLBACKS = ("hover", "blind", "silent")  # rungs of the ladder without a plan of the MPC
WAYS = ("as_planned", "lightened", "late_stamped_on_arrival", "late", "tumbling")
_OWN = ("rate_time_constant", "thrust_time_constant", "drag")  # of a plant of rotors


@dataclass(frozen=True, kw_only=True)
class Source:
    """A deviation of vehicles or odometry.

    Attributes:
        name: Its name.
        campaign: The shipped campaign that it changes.
        config: The parameter files of all flights.
        changes: Fixed parameters that replace variations of the campaign.
        vary: Variations in addition to those of the campaign.
        way: How it is flown, one of ``WAYS``.
    """

    name: str
    campaign: str
    config: tuple[str, ...] = ("default",)
    changes: Mapping[str, Any] = field(default_factory=dict)
    vary: Mapping[str, Any] = field(default_factory=dict)
    way: str = "as_planned"

    def content(self) -> dict[str, Any]:
        """Return a campaign file's content."""
        content: dict[str, Any] = dict(
            read_content(located_campaign(Path(self.campaign)), "campaign")
        )
        changes = dict(self.changes)
        content["reference"] = changes.pop("reference", content["reference"])
        fixed = {*self.changes}
        shared = {name: value for name, value in content["set"].items() if name not in self.vary}
        if len(self.config) > 1:  # a vehicle of rotors
            fixed |= {f"simulator.{name}" for name in _OWN}
        kept = {name: how for name, how in content["vary"].items() if name not in fixed}
        content |= {
            "config": [*self.config],
            "set": {**shared, **changes},
            "vary": {**kept, **self.vary},
        }
        return content | ({"settle_time": LOST_AT} if self.way == "lightened" else {})


class Lightened(InternalPlant):
    """A vehicle that loses a share of its mass in flight."""

    def __init__(self, config: SimulatorConfig) -> None:
        super().__init__(config)
        self._lost_ns = round(1e9 * LOST_AT)
        left = 1.0 - LOST_MASS
        lighter = dataclasses.replace(
            self._vehicle,
            mass=left * self._vehicle.mass,
            drag=tuple(drag / left for drag in per_axis(self._vehicle.drag)),
        )
        self._lighter = constants(config, lighter)

    def advance_to(self, time_ns: int) -> None:
        """Move to a time, and become lighter on the way."""
        if self.time_ns < self._lost_ns <= time_ns:
            super().advance_to(self._lost_ns)
            self._constants = self._lighter
        super().advance_to(time_ns)


@dataclass(frozen=True, kw_only=True, eq=False)
class Letter:
    """An odometry on its way, and the window that was current when it was measured."""

    arrives_ns: int
    odometry: OdometrySample
    window: ReferenceWindow


class Late:
    """An MPC whose odometries come late, in order, and not all of them.

    It is shown the vehicle ``_LOOKS`` times a second and measures it ``rate`` times. Of what
    arrives at once it sees the newest. An odometry is stamped with the time of its
    arrival, so that it looks fresh, or with the time of its measurement.
    """

    def __init__(
        self, mpc: MpcConfig, *, rate: float, seed: int, stamped_on_arrival: bool
    ) -> None:
        self._controller = warmed_up(dataclasses.replace(mpc, lockstep=False))
        self._looks_per_odometry = round(_LOOKS / rate)
        self._looks_per_watch = round(_LOOKS / mpc.control_rate)
        self._random = np.random.default_rng(seed)
        self._stamped_on_arrival = stamped_on_arrival
        self._under_way: deque[Letter] = deque()
        self._looks, self._latest_ns = 0, 0
        self._tick: Tick | None = None

    def take(self) -> Tick | None:
        """Return the controller's tick since the last call."""
        tick, self._tick = self._tick, None
        return tick

    def __call__(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command to send now, if any."""
        now_ns = odometry.stamp_ns
        if self._looks % self._looks_per_odometry == 0:
            self._send(odometry, window)
        self._looks += 1
        arrived = None
        while self._under_way and self._under_way[0].arrives_ns <= now_ns:
            arrived = self._under_way.popleft()
        if arrived is not None:
            self._tick = self._answered(arrived, odometry_now=odometry, window_now=window)
        elif self._looks % self._looks_per_watch == 0:
            self._tick = self._controller.watch(now_ns=now_ns)
        return None if self._tick is None else self._tick.command

    def _send(self, odometry: OdometrySample, window: ReferenceWindow) -> None:
        late, lost = abs(JITTER * self._random.standard_normal()), self._random.random() < DROPOUT
        if self._looks == 0:  # the first starts the flight
            late, lost = 0.0, False
        if not lost:
            self._latest_ns = max(self._latest_ns, odometry.stamp_ns + round(1e9 * late))
            letter = Letter(arrives_ns=self._latest_ns, odometry=odometry, window=window)
            self._under_way.append(letter)

    def _answered(
        self, letter: Letter, *, odometry_now: OdometrySample, window_now: ReferenceWindow
    ) -> Tick | None:
        now_ns, odometry, window = odometry_now.stamp_ns, letter.odometry, letter.window
        if self._stamped_on_arrival:
            odometry, window = dataclasses.replace(odometry, stamp_ns=now_ns), window_now
        self._controller.receive_reference(window, now_ns=now_ns)
        return self._controller.receive_odometry(odometry, now_ns=now_ns)


def steps(plan: FlightPlan, way: str) -> Iterator[LoopStep]:
    """Fly one flight."""
    if way.startswith("late"):
        yield from _late_steps(plan, stamped_on_arrival=way == "late_stamped_on_arrival")
        return
    mpc, simulator, reference = plan.config
    plant = Lightened(simulator) if way == "lightened" else None
    yield from fly(
        mpc=mpc, simulator=simulator, reference=reference, trajectory=plan.trajectory, plant=plant
    )


def _late_steps(plan: FlightPlan, *, stamped_on_arrival: bool) -> Iterator[LoopStep]:
    mpc, simulator, reference = plan.config
    late = Late(
        mpc,
        rate=simulator.odom_rate,
        seed=simulator.seed,
        stamped_on_arrival=stamped_on_arrival,
    )
    looking = dataclasses.replace(simulator, odom_rate=float(_LOOKS))
    for step in fly(
        simulator=looking, reference=reference, trajectory=plan.trajectory, controller=late
    ):
        yield dataclasses.replace(step, tick=late.take())


@functools.cache
def _campaign(name: str) -> Campaign:
    return campaign_from(SOURCES[name].content())


class Figures(NamedTuple):
    """Figures of a flight: mean and largest settled error [m], largest tilt [rad]."""

    mean: float
    largest: float
    tilt: float
    crashed: bool
    left: bool


def flown(name: str, number: int) -> Figures:
    """Fly a flight of a source."""
    campaign, left = _campaign(name), False
    plan = campaign.plan(number)
    log = FlightLog(plan.config.mpc)
    for step in steps(plan, SOURCES[name].way):
        log.take(step)
        left |= step.tick is not None and step.tick.stats.source in FALLBACKS
    truth = log.with_truth(log.flight(plan.config))
    found = figures_of(truth, settle_time=campaign.settle_time)
    mean, largest, tilt = (
        math.nan if (value := found[key]) is None else value
        for key in ("settled_error_mean_m", "settled_error_max_m", "tilt_max_rad")
    )
    crashed = crash_of(truth) is not None
    if SOURCES[name].way == "tumbling":  # it begins upside down and falls at first
        crashed = not largest < RECOVERED
    return Figures(mean, largest, tilt, crashed=crashed, left=left)


def line(name: str, flights: Sequence[Figures]) -> str:
    """Return the line of a source."""
    held = [flight for flight in flights if not flight.crashed]
    begin = f"{name:48} {len(flights):4d} {len(flights) - len(held):4d}"
    if not held:
        return begin
    means = 100.0 * np.array([flight.mean for flight in held])
    cells = " ".join(f"{value:7.1f}" for value in percentiles(means, 50, 95).values())
    largest = 100.0 * max(flight.largest for flight in held)
    tilt = math.degrees(max(flight.tilt for flight in held))
    left = sum(flight.left for flight in held)
    return f"{begin} {cells} {largest:7.1f} {tilt:6.0f} {left:5d}"


def configured(vehicle: str, *, mass: float, thrust: float) -> Source:
    """Return a vehicle of rotors with mass and thrust of mpc scaled by these factors."""
    own = load_config(f"vehicles/{vehicle}").mpc
    return Source(
        name=f"{vehicle} configured mass x {mass}, thrust x {thrust}",
        campaign="lemniscate",
        config=("default", f"vehicles/{vehicle}"),
        changes={
            "mpc.mass": mass * own.mass,
            "mpc.thrust_curve": [thrust * each for each in own.thrust_curve],
            "simulator.gust_intensity": GUSTS,
            "simulator.command_delay": 0.0,
            "simulator.thrust_scale": 1.0,
            "simulator.odom_rate": 50.0,
        },
        vary={
            "simulator.wind": {
                "choice": [[WIND, 0, 0], [0, WIND, 0], [-WIND, 0, 0], [0, -WIND, 0]]
            }
        },
    )


def loaded(campaign: str) -> Source:
    """Return a vehicle that carries a weight on a cable of half a metre; its lags are guessed."""
    own, guessed = load_config("vehicles/paper").mpc, MpcConfig()
    return Source(
        name=f"{campaign}, a weight on a cable",
        campaign=campaign,
        config=("default", "vehicles/paper"),
        changes={
            "mpc.rate_time_constant": guessed.rate_time_constant,
            "mpc.thrust_time_constant": guessed.thrust_time_constant,
            "mpc.input_delay": guessed.input_delay,
            "simulator.plant": "mujoco",
            "simulator.mujoco.payload.mass": LOAD * own.mass,
        },
    )


RATE_LOOPS: Mapping[str, Mapping[str, Any]] = {
    "tuned": {
        "simulator.torque_time_constant": {"log_uniform": [0.0247, 0.0639]},
        "simulator.rate_time_constant": {"same_as": "simulator.torque_time_constant", "times": 2},
    },
    "ringing": {},
    "slow": {
        "simulator.rate_time_constant": {"same_as": "simulator.torque_time_constant", "times": 2},
    },
}
_LEMNISCATE: Mapping[str, Any] = {
    "reference": "lemniscate",
    "reference.amplitude_x": 2.0,
    "reference.amplitude_y": 1.0,
}
TASKS: Mapping[str, Mapping[str, Any]] = {
    "hover": {},
    "tumbling": {
        "reference.height": 20.0,
        "simulator.initial_position": [0.0, 0.0, 20.0],
    },
    "1.0 rad/s": {**_LEMNISCATE, "reference.angular_frequency": 1.0},
    "1.5 rad/s": {**_LEMNISCATE, "reference.angular_frequency": 1.5},
}
UPSIDE_DOWN: Mapping[str, Any] = {
    "simulator.initial_attitude": {"attitude": [math.pi, math.pi]},
    "simulator.initial_body_rates": {"uniform": [[-6.0, -6.0, -3.0], [6.0, 6.0, 3.0]]},
}


def rate_loops() -> Iterator[Source]:
    """Yield the vehicles of the campaign ``rate_loops`` with each loop, task and delay.

    A loop that is tuned has the damping 0.7: the lags of RAPTOR's vehicles under a proportional
    gain of 25/s and a gain on the acceleration. One that is slow has a gain of half of one over
    the rotors' lag.
    """
    for loop, lags in RATE_LOOPS.items():
        for task, changes in TASKS.items():
            for delay in (0.0, 0.02, 0.04):
                yield Source(
                    name=f"rate loop {loop}, {task}, {1e3 * delay:.0f} ms late",
                    campaign="rate_loops",
                    changes={**changes, "simulator.command_delay": delay},
                    vary={**lags, **(UPSIDE_DOWN if task == "tumbling" else {})},
                    way="tumbling" if task == "tumbling" else "as_planned",
                )


def sources() -> Iterator[Source]:
    """Yield all sources."""
    yield from rate_loops()
    for campaign in ("hover", "lemniscate"):
        for name, changes in (
            ("velocity noise 0.3 m/s", {"simulator.velocity_noise": 0.3}),
            ("position noise 0.1 m", {"simulator.position_noise": 0.1}),
            ("attitude noise 0.03 rad", {"simulator.attitude_noise": 0.03}),
            ("thrust x 0.5", {"simulator.thrust_scale": 0.5}),
            ("thrust x 1.6", {"simulator.thrust_scale": 1.6}),
            ("drag 1.0 1/s", {"simulator.drag": 1.0}),
        ):
            yield Source(name=f"{campaign}, {name}", campaign=campaign, changes=changes)
        for name, way in (
            ("late, stamps of arrival", "late_stamped_on_arrival"),
            ("late, true stamps", "late"),
            ("loses 30 % of its mass", "lightened"),
        ):
            yield Source(name=f"{campaign}, {name}", campaign=campaign, way=way)
        yield loaded(campaign)
    for vehicle in ("racer", "hummingbird", "crazyflie"):
        yield configured(vehicle, mass=1.0, thrust=1.0)
        yield configured(vehicle, mass=1.2, thrust=0.8)
        yield configured(vehicle, mass=0.8, thrust=1.2)


SOURCES = {source.name: source for source in sources()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--only", default="", metavar="TEXT", help="sources whose name has it")
    parser.add_argument("--flights", type=int, default=60, help="of each source")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    print(f"{'source':48}  all lost     p50     p95     max largest   tilt  left")
    with ProcessPoolExecutor(options.workers) as pool:
        for name in (each for each in SOURCES if options.only in each):
            numbers, flights = range(options.flights), []
            for flight in pool.map(flown, [name] * options.flights, numbers):
                flights.append(flight)
                print(f"{name}: {len(flights)}", file=sys.stderr, end="\r", flush=True)
            print(line(name, flights), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
