# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the trials of AdaptiveQuadBench with rotorpy, and write the results.

python bench/adaptive_quad_bench.py --out runs/adaptive_quad_bench

D. Zhang, R. Tao, S. Cheng, N. Hovakimyan, M. W. Mueller, "A simulation evaluation suite for
robust adaptive quadcopter control", arXiv 2510.03471: seven families of perturbations, references
of 5 s drawn at random. docs/measurements/published_tables.md has the table, the differences, and
the sources of the other figures. ``flights.csv`` has every flight. ``--config`` and ``--set``
change the controller; ``--families``, ``--rows`` and ``--trials`` select flights. Needs rotorpy.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import published_table
from scipy import signal
from step_times import median_step_us

from quad_mpc_ros import load_config
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.rotors import rate_loop
from quad_mpc_ros.simulation.rotors.mixer import mixing

SETTINGS = Path(__file__).with_suffix(".yaml")
SEED, TRIALS = 42, 20  # those of the figures beside these
DURATION, PERIOD_NS = 5.0, 10_000_000
AHEAD = 2.0  # s that the reference goes on after it, for the horizon to see
HEIGHT = 20.0  # m; theirs begin at the origin, without a ground
FAILED = 1.0  # m of RMSE

FAMILIES = ("none", "wind", "force", "torque", "payload", "rotor efficiency", "uncertainty")
"""In each one kind of perturbation is on; their names are no, wind, ..., rotoreff, uncertainty."""
TOGGLED = ("force", "torque", "payload")
ROWS = {"off": "mpc.estimate_disturbance=false", "on": "mpc.estimate_disturbance=true"}

ARM, MASS, INERTIA = 0.166, 0.826, (0.0047, 0.005, 0.0074)
THRUST, TORQUE_RATIO, MOTOR_LAG, NOISE = 7.64e-6, 0.014, 0.005, 50.0
GRAVITY = 9.81
VEHICLE = {
    "mass": MASS,
    **dict(zip(("Ixx", "Iyy", "Izz"), INERTIA, strict=True)),
    **dict.fromkeys(("Ixy", "Ixz", "Iyz"), 0.0),
    "num_rotors": 4,
    "rotor_pos": {
        name: ARM * math.sqrt(0.5) * np.array([x, y, 0.0])
        for name, x, y in (("r1", 1, 1), ("r2", 1, -1), ("r3", -1, -1), ("r4", -1, 1))
    },
    "rotor_directions": np.array([1, -1, 1, -1]),
    "rotor_speed_min": 0.0,
    "rotor_speed_max": 1000.0,
    "k_eta": THRUST,
    "k_m": THRUST * TORQUE_RATIO,
    "k_d": 1.19e-4,
    "k_z": 2.32e-4,
    "tau_m": MOTOR_LAG,
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A trial: the flight and its perturbations, which are not configured.

    ``goal`` (3, 3) are position [m], velocity and acceleration after 5 s; ``force`` [N] in the
    world, ``torque`` [N m] in the body and the payload come and go at ``toggles`` [s];
    ``assumed`` are factors on the vehicle's parameters as the controller has them.
    """

    goal: Array
    wind: Array = dataclasses.field(default_factory=lambda: np.zeros((1, 3)))
    force: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    torque: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    payload: float = 0.0
    payload_at: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    toggles: tuple[float, ...] = ()
    efficiency: Array = dataclasses.field(default_factory=lambda: np.ones(4))
    assumed: dict[str, float] = dataclasses.field(default_factory=dict)
    noise_seed: int = 0


def trials(family: str, count: int = TRIALS, seed: int = SEED) -> list[Trial]:
    """Draw the trials of a family in the order in which the suite draws them."""
    random = np.random.RandomState(seed)
    goals = random.uniform(-2.0, 2.0, (count, 3, 3))
    drawn: list[dict[str, Any]] = [{} for _ in range(count)]
    if family == "wind":
        drawn = [_steady_wind(random) for _ in range(count)]
        drawn = [{"wind": _gusty(seed=100000 + i, **each)} for i, each in enumerate(drawn)]
    elif family in ("force", "torque"):
        most = 1.0 if family == "force" else 0.1
        drawn = [{family: each} for each in random.uniform(0.0, most, (count, 3))]
    elif family == "payload":
        drawn = [
            {
                "payload": MASS * random.uniform(0.0, 0.5),
                "payload_at": ARM * random.uniform(-0.2, 0.2, 3),
            }
            for _ in range(count)
        ]
    elif family == "rotor efficiency":
        drawn = [{"efficiency": 1.0 + each} for each in random.uniform(-0.3, 0.3, (count, 4))]
    elif family == "uncertainty":
        drawn = [{"assumed": _assumed(random)} for _ in range(count)]
    if family in TOGGLED:
        drawn = [{**each, "toggles": _toggles(random)} for each in drawn]
    return [
        Trial(goal=goal, noise_seed=i, **each)
        for i, (goal, each) in enumerate(zip(goals, drawn, strict=True))
    ]


def _steady_wind(random: np.random.RandomState) -> dict[str, Any]:
    speed, direction = random.uniform(0.0, 3.0), random.uniform(-1.0, 1.0, 3)
    steady = speed * direction / np.linalg.norm(direction)
    return {"steady": steady, "intensity": random.uniform(30.0, 60.0, 3)}


def _gusty(*, seed: int, steady: Array, intensity: Array) -> Array:
    """Return the wind (n, 3) [m/s] of every 10 ms: rotorpy's Dryden filter, at 2 m height, 1 m/s.

    Its own cannot be imported without torch. The noise that it filters is uniform in -1 to 1, so
    an intensity of 45 makes gusts of 0.7 to 1.3 m/s.
    """
    feet = 3.281
    across = 2.0 * feet / (0.177 + 0.000823 * 2.0 * feet) ** 1.2 / feet
    noise = np.random.RandomState(seed).uniform(
        -1.0, 1.0, (round((DURATION + 1.0) * 1e9 / PERIOD_NS), 3)
    )
    gusts = np.empty_like(noise)
    for axis, length in enumerate((across, across, 2.0)):
        gain, lag = intensity[axis] * math.sqrt(2.0 * length / math.pi), 2.0 * length
        numerator, denominator = signal.bilinear(
            [gain * 2.0 * math.sqrt(3.0) * length, gain],
            [lag**2, 2.0 * lag, 1.0],
            fs=1e9 / PERIOD_NS,
        )
        gusts[:, axis] = signal.lfilter(numerator, denominator, noise[:, axis])
    return np.asarray(steady + gusts)


def _assumed(random: np.random.RandomState) -> dict[str, float]:
    names = ("mass", "Ixx", "Iyy", "Izz", "arm", "-", "-", "-", "thrust", "torque", "k_d", "k_z")
    drawn = 1.0 + random.uniform(-0.1, 0.1, 15)  # the last three do nothing here
    return {name: float(each) for name, each in zip(names, drawn[:12], strict=True)}


def _toggles(random: np.random.RandomState) -> tuple[float, ...]:
    """Return one to four times [s], half a second apart, in the middle of the flight."""
    times: list[float] = []
    for _ in range(random.randint(1, 5)):
        for _ in range(100):
            time = random.uniform(0.5, DURATION - 0.5)
            if all(abs(time - other) >= 0.5 for other in times):
                times.append(time)
                break
    return tuple(sorted(times))


class Primitive:
    """The polynomial of degree five from rest to a goal, after 5 s: the least jerk squared."""

    periodic = False
    duration = DURATION + AHEAD

    def __init__(self, goal: Array) -> None:
        """``goal`` (3, 3) are position, velocity, acceleration."""
        powers = np.arange(3, 6)
        slopes = np.array([DURATION**powers, powers * DURATION ** (powers - 1)])
        curvature = powers * (powers - 1) * DURATION ** (powers - 2)
        self._coefficients = np.zeros((6, 3))
        self._coefficients[3:] = np.linalg.solve(np.vstack((slopes, curvature)), goal)
        self._coefficients[0, 2] = HEIGHT

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]."""
        found = [
            np.polynomial.polynomial.polyval(
                seconds, np.polynomial.polynomial.polyder(self._coefficients, order)
            ).T
            for order in range(4)
        ]
        return PathSamples(p_WB=found[0], v_WB_W=found[1], a_WB_W=found[2], j_WB_W=found[3])


class Craft:
    """rotorpy's multirotor under an autopilot: rate loop and mixer of the plant ``rotors``.

    The wind changes, and the noise of the motors is added, every 10 ms as in the suite.
    """

    def __init__(self, assumed: SimulatorConfig, trial: Trial) -> None:
        """``assumed`` is the vehicle as the autopilot has it."""
        self._trial = trial
        self._loop, self._mix = rate_loop.loop_of(assumed), mixing(assumed.rotors)
        self._memory = rate_loop.begun(np.zeros(3), self._loop)
        self._throttle, self._rates, self._speeds = 0.0, np.zeros(3), np.zeros(4)
        self._turn_ns = round(1e9 / assumed.rate_loop.rate)
        self._random = np.random.RandomState(trial.noise_seed)
        self._body = multirotor(trial.efficiency)
        self._time_ns = 0
        self._on = False
        self._state = {
            "x": np.array([0.0, 0.0, HEIGHT]),
            "v": np.zeros(3),
            "q": np.array([0.0, 0.0, 0.0, 1.0]),
            "w": np.zeros(3),
            "wind": np.zeros(3),
            "rotor_speeds": np.zeros(4),
        }

    @property
    def rotor_speeds(self) -> Array:
        """True speeds of the rotors (4,) [rad/s]."""
        return np.asarray(self._state["rotor_speeds"])

    def apply(self, command: CommandSample) -> None:
        """Take a command that acts now."""
        self._throttle, self._rates = float(command.throttle), command.w_WB_B.copy()

    def advance_to(self, time_ns: int) -> None:
        """Move to a time in turns of the rate loop."""
        while self._time_ns < time_ns:
            if self._time_ns % PERIOD_NS == 0:
                self._disturb()
            rate_loop.run(
                self._memory,
                w_WB_B=self._state["w"],
                throttle=self._throttle,
                rates=self._rates,
                on_ground=False,
                loop=self._loop,
                mix=self._mix,
                out=self._speeds,
            )
            control = {"cmd_motor_speeds": self._speeds}
            self._state = self._body.step(self._state, control, 1e-9 * self._turn_ns)
            self._time_ns += self._turn_ns

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry under a stamp."""
        state = self._state
        R_WB = so3.rotation_from_quaternion_xyzw(state["q"])
        return OdometrySample(
            stamp_ns=stamp_ns,
            p_WB=state["x"].copy(),
            q_WB_xyzw=state["q"].copy(),
            v_WB_B=R_WB.T @ state["v"],
            w_WB_B=state["w"].copy(),
        )

    def _disturb(self) -> None:
        """Set wind, forces, payload and rotors for the next 10 ms."""
        trial, index = self._trial, self._time_ns // PERIOD_NS
        self._state["wind"] = trial.wind[min(index + 1, len(trial.wind) - 1)]
        if index > 0:
            noisy = self._state["rotor_speeds"] + self._random.normal(scale=NOISE, size=4)
            self._state["rotor_speeds"] = np.clip(noisy, 0.0, VEHICLE["rotor_speed_max"])
        on = bool(sum(1e-9 * self._time_ns + 0.01 >= each for each in trial.toggles) % 2)
        if on != self._on:
            self._on = on
            self._body.disturb(trial if on else Trial(goal=trial.goal))


def multirotor(efficiency: Array) -> Any:
    """Return rotorpy's vehicle with rotors of these efficiencies (4,), undisturbed."""
    rotorpy = importlib.import_module("rotorpy.vehicles.multirotor")

    class Disturbed(rotorpy.Multirotor):  # type: ignore[misc, name-defined]
        """A multirotor that is pushed, turned and loaded, with rotors that differ."""

        torque_B = np.zeros(3)

        def disturb(self, trial: Trial) -> None:
            """Apply the perturbations of a trial; a payload acts on inertia and torque.

            The suite moves the centre of mass and adds the payload's torque about it: twice.
            """
            center = trial.payload * trial.payload_at / (MASS + trial.payload)
            self.mass = MASS + trial.payload
            self.inertia = (
                np.diag(INERTIA)
                + MASS * _steiner(center)
                + trial.payload * _steiner(trial.payload_at - center)
            )
            self.inv_inertia = np.linalg.inv(self.inertia)
            self.rotor_geometry = np.array([*VEHICLE["rotor_pos"].values()]) - center
            self.weight = np.array([0.0, 0.0, -self.mass * GRAVITY]) + trial.force
            hanging = np.array([0.0, 0.0, -trial.payload * GRAVITY])
            self.torque_B = trial.torque + np.cross(trial.payload_at - center, hanging)

        def compute_body_wrench(
            self, body_rates: Array, rotor_speeds: Array, body_airspeed_vector: Array
        ) -> tuple[Array, Array]:
            """Return force [N] and torque [N m] in the body."""
            force, torque = super().compute_body_wrench(
                body_rates, rotor_speeds, body_airspeed_vector
            )
            more = (efficiency - 1.0) * THRUST * rotor_speeds**2
            x, y, _ = self.rotor_geometry.T
            turn = VEHICLE["rotor_directions"] * TORQUE_RATIO
            turned = np.array([y @ more, -x @ more, turn @ more])
            return force + np.array([0.0, 0.0, more.sum()]), torque + turned + self.torque_B

    # Within 3 um of the default at three quarters of its time.
    quick = {"method": "RK23", "first_step": 0.002}
    return Disturbed(VEHICLE, control_abstraction="cmd_motor_speeds", integrator_kwargs=quick)


def _steiner(offset: Array) -> Array:
    """Return the inertia (3, 3) of one kilogram at an offset (3,) [m]."""
    return np.asarray(offset @ offset * np.eye(3) - np.outer(offset, offset))


@dataclass(frozen=True)
class Job:
    """One flight of the table."""

    family: str
    row: str
    trial: int
    sources: tuple[str, ...]
    assignments: tuple[str, ...]


@dataclass(frozen=True)
class Flown:
    """Result of a flight: errors of the true position [m], and of the heading [degrees].

    ``step_us`` is the median time of a step of the controller [us].
    """

    job: Job
    rmse: float
    largest: float
    heading: float
    step_us: float

    @property
    def name(self) -> str:
        """Columns that identify the flight."""
        return f"{self.job.family}, {self.job.row}, trial {self.job.trial}"

    def cells(self) -> dict[str, Any]:
        """Return the result as a row of ``flights.csv``."""
        return {
            "family": self.job.family,
            "row": self.job.row,
            "trial": self.job.trial,
            "rmse_m": f"{self.rmse:.6f}",
            "largest_m": f"{self.largest:.6f}",
            "heading_deg": f"{self.heading:.4f}",
        }


def jobs(arguments: argparse.Namespace) -> Iterator[Job]:
    """Yield the flights that are asked for."""
    for family in arguments.families:
        for row in arguments.rows:
            for trial in range(arguments.trials):
                assignments = (*arguments.set, ROWS[row])
                yield Job(family, row, trial, (str(SETTINGS), *arguments.config), assignments)


def flown(job: Job) -> Flown:
    """Fly it, from rest at the start of the reference with rotors that stand still."""
    trial = trials(job.family)[job.trial]
    config = misjudged(load_config(*job.sources, assignments=job.assignments), trial.assumed)
    reference = config.reference
    errors, headings, ticks = [], [], []
    for step in fly(
        mpc=config.mpc,
        simulator=config.simulator,
        reference=reference,
        plant=Craft(config.simulator, trial),
        trajectory=FlatTrajectory(Primitive(trial.goal), reference),
        controller=warmed_up(config.mpc),
    ):
        ticks.append(step.tick)
        errors.append(float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0])))
        R_WB = so3.rotation_from_quaternion_xyzw(step.truth.q_WB_xyzw)
        headings.append(abs(math.degrees(math.atan2(R_WB[1, 0], R_WB[0, 0]))))
    rmse = math.sqrt(np.mean(np.square(errors)))
    return Flown(
        job,
        rmse=rmse,
        largest=max(errors),
        heading=float(np.mean(headings)),
        step_us=median_step_us(ticks, config.mpc.controller),
    )


def misjudged(config: FlightConfig, assumed: dict[str, float]) -> FlightConfig:
    """Return the configuration of a controller and an autopilot with other parameters."""
    if not assumed:
        return config
    mpc, simulator, reference = config
    sideways, along = assumed["k_d"], assumed["k_z"]
    rotor_drag = np.multiply(mpc.rotor_drag, (sideways, sideways, along)) / assumed["mass"]
    vehicle = {
        "mass": assumed["mass"] * mpc.mass,
        "thrust_curve": [assumed["thrust"] * each for each in mpc.thrust_curve],
        "rotor_drag": rotor_drag.tolist(),
    }
    rotors = simulator.rotors
    inertia = np.multiply(
        simulator.airframe.inertia[:3], [assumed[name] for name in ("Ixx", "Iyy", "Izz")]
    )
    autopilot = {
        "rotors.x": [assumed["arm"] * each for each in rotors.x],
        "rotors.y": [assumed["arm"] * each for each in rotors.y],
        "rotors.thrust_coefficient": assumed["thrust"] * rotors.thrust_coefficient,
        "rotors.torque_coefficient": assumed["torque"] * rotors.torque_coefficient,
        "airframe.inertia": [*inertia.tolist(), 0.0, 0.0, 0.0],
    }
    return FlightConfig(
        mpc.updated(vehicle),
        simulator.updated({**vehicle, **autopilot}),
        reference.updated(vehicle),
    )


def table(flights: Sequence[Flown]) -> list[list[str]]:
    """Return header and rows: median, mean and largest RMSE [m], heading [degrees], failures."""
    lines = [["family", "estimator", "median", "mean", "largest", "heading", "failed"]]
    rows = [row for row in ROWS if any(flight.job.row == row for flight in flights)]
    for row in rows:
        own = [flight for flight in flights if flight.job.row == row]
        for family in (*FAMILIES, "all"):
            some = [flight for flight in own if family in (flight.job.family, "all")]
            if not some:
                continue
            rmse = [flight.rmse for flight in some]
            figures = np.median(rmse), np.mean(rmse), np.max(rmse)
            heading = np.median([flight.heading for flight in some])
            failed = sum(each > FAILED for each in rmse)
            shown = [f"{each:.4f}" for each in figures]
            lines.append([family, row, *shown, f"{heading:.2f}", f"{failed}/{len(some)}"])
    return lines


def parsed(given: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the arguments of a command line."""
    parser = published_table.parser(__doc__, name="adaptive_quad_bench", rows=ROWS)
    parser.add_argument("--families", nargs="*", choices=FAMILIES, default=[*FAMILIES])
    parser.add_argument("--trials", type=int, default=TRIALS, choices=range(1, TRIALS + 1))
    return parser.parse_args(given)


def main() -> None:
    """Fly and write."""
    arguments = parsed()
    done = published_table.all_flown(flown, [*jobs(arguments)], arguments.workers)
    published_table.write(arguments.out, done, table(done))


if __name__ == "__main__":
    main()
