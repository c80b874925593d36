# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Flights with the default formulation: accuracy, robustness, and recovery.

Each flight is that of ``quad_mpc simulate`` with the arguments given here.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fixtures.presets import agile, ideal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.commands.run_configuration import run_configuration
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS

AT_ONCE = [
    f"--set={name}=0"
    for node, delay in (("mpc", "input_delay"), ("simulator", "command_delay"))
    for name in (f"{node}.rate_time_constant", f"{node}.thrust_time_constant", f"{node}.{delay}")
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Flown:
    """A flight: ``time`` (n,) [s], ``distance`` (n,) [m] to the reference, ``commands`` (n, 4).

    The distance is that of the true position. ``saturated`` (n,) is true where a body
    rate is at its bound.
    """

    time: Array
    distance: Array
    commands: Array
    saturated: np.ndarray
    failures: int

    @property
    def rmse(self) -> float:
        """Root mean square of the distance [m]."""
        return float(np.sqrt(np.mean(self.distance**2)))

    def mean_from(self, start: float) -> float:
        """Return the mean distance from a time on."""
        return float(np.mean(self.distance[self.time >= start]))


def flown(out: Path, *arguments: str) -> Flown:
    """Fly ``quad_mpc simulate --config agile`` with an ideal vehicle."""
    parser = argparse.ArgumentParser()
    add_run_options(parser)
    run = run_configuration(
        parser.parse_args(["--config", "agile", *AT_ONCE, *arguments, "--out", str(out)]),
        lockstep=True,
    )
    steps = list(
        fly(
            mpc=run.mpc,
            simulator=run.simulator,
            reference=run.reference,
            trajectory=run.trajectory,
        )
    )
    commands = np.array([given(step) for step in steps])
    times_ns = [step.truth.stamp_ns - SIMULATION_START_NS for step in steps]
    wanted = run.trajectory.at(times_ns).p_WB
    bound = np.array(run.mpc.omega_max) - 1e-3
    return Flown(
        time=1e-9 * np.array(times_ns),
        distance=np.linalg.norm([step.truth.p_WB for step in steps] - wanted, axis=1),
        commands=commands,
        saturated=np.any(np.abs(commands[:, 1:]) >= bound, axis=1),
        failures=failures(steps),
    )


def given(step: LoopStep) -> list[float]:
    assert step.tick is not None
    assert step.tick.command is not None
    return [step.tick.command.throttle, *step.tick.command.w_WB_B]


def failures(steps: list[LoopStep]) -> int:
    """Return the number of failed solves and of fallbacks."""
    last = steps[-1].tick
    assert last is not None
    return last.stats.solver_failures + last.stats.fallbacks


def settings(node: str, **values: object) -> list[str]:
    return [part for name, value in values.items() for part in ("--set", f"{node}.{name}={value}")]


def lagging(lag: float) -> list[str]:
    """Return a plant with a lag [s] of rates and thrust, and with 20 ms of delay."""
    return settings(
        "simulator",
        rate_time_constant=lag,
        torque_time_constant=0.0,
        thrust_time_constant=lag,
        command_delay=0.02,
    )


MODELLED = settings(
    "mpc",
    rate_time_constant=0.03,
    torque_time_constant=0.0,
    thrust_time_constant=0.03,
    input_delay=0.02,
)
LEMNISCATE = ["--reference", "lemniscate", "--duration", "8"]
FAST = [*LEMNISCATE, *settings("reference", angular_frequency=2.6), "--duration", "5"]
WIND = settings("simulator", wind=[5.0, 0.0, 0.0])
HEAVY = settings("simulator", mass_scale=1.2)
ANISOTROPIC_DRAG = [
    part
    for node in ("mpc", "simulator", "reference")
    for part in settings(node, drag=[0.35, 0.2, 0.55], translational_lift=0.015)
]
SLOW_YAW = settings("simulator", rate_time_constant=[0.03, 0.035, 0.1], command_delay=0.02)
MODELLED_YAW = settings("mpc", rate_time_constant=[0.03, 0.035, 0.1], input_delay=0.02)
NOISE = settings("simulator", position_noise=0.01, attitude_noise=0.00873, velocity_noise=0.05)


@pytest.mark.parametrize(
    ("arguments", "rmse"),
    [
        (FAST, 0.012),
        ([*FAST, *MODELLED, *lagging(0.045)], 0.015),
        ([*LEMNISCATE, *ANISOTROPIC_DRAG, *MODELLED_YAW, *SLOW_YAW], 0.001),
    ],
    ids=[
        "fast",
        "fast with larger lags than modelled",
        "anisotropic drag and a lag of each axis",
    ],
)
def test_flies_the_lemniscate(arguments: list[str], rmse: float, tmp_path: Path) -> None:
    run = flown(tmp_path, *arguments)
    assert run.failures == 0
    assert run.rmse <= rmse


@pytest.mark.parametrize(
    ("arguments", "settled"),
    [([*WIND, *MODELLED, *lagging(0.03)], 0.002), (HEAVY, 0.005)],
    ids=["wind with lags", "heavy"],
)
def test_estimates_a_steady_disturbance(
    arguments: list[str], settled: float, tmp_path: Path
) -> None:
    run = flown(tmp_path, *LEMNISCATE, *arguments)
    assert run.failures == 0
    assert run.mean_from(4.0) <= settled
    assert run.distance.max() > 5.0 * run.mean_from(4.0)  # not estimated at first


def test_estimates_a_disturbance_despite_noise(tmp_path: Path) -> None:
    run = flown(tmp_path, *LEMNISCATE, *HEAVY, *MODELLED, *lagging(0.03), *NOISE)
    assert run.failures == 0
    assert run.rmse <= 0.05
    assert run.distance.max() <= 0.06


def test_unknown_commands_before_the_first_one_teach_nothing() -> None:
    """They hold the vehicle on the lemniscate until the delayed first command acts."""
    lags = {"rate_time_constant": 0.05, "torque_time_constant": 0.02, "thrust_time_constant": 0.05}
    steps = list(
        fly(
            mpc=MpcConfig().updated({**lags, "input_delay": 0.08}),
            simulator=ideal(lags, command_delay=0.08, duration=2.0),
            reference=ReferenceConfig(trajectory="lemniscate", angular_frequency=1.2),
            on_reference=True,
        )
    )
    lag = [step.tick.stats.rate_time_constant_ms for step in steps if step.tick]
    assert min(lag) > 0.9 * 50.0
    assert max(lag) < 1.1 * 50.0
    errors = [np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]) for step in steps]
    assert max(errors) < 0.02


def test_square_with_lags_settles_without_limit_cycle(tmp_path: Path) -> None:
    run = flown(tmp_path, *MODELLED, *lagging(0.03))
    assert run.failures == 0
    assert before_switches(run).max() <= 0.005
    assert np.mean(run.saturated) < 0.05
    # The motion decreases from each 0.2 s to the next.
    phase, unrest = run.time % 2.0, []
    for start in (1.2, 1.4, 1.6, 1.8):
        while_there = (phase >= start) & (phase < start + 0.2)
        unrest.append(np.abs(run.commands[while_there, 1:]).max())
    assert np.all(np.diff(unrest) < -0.3 * np.array(unrest[:-1]))
    assert unrest[-1] <= 0.05


def before_switches(run: Flown) -> Array:
    """Return the distances just before the corners change, every 2 s."""
    return run.distance[99::100]


# Recovery: the reference is a hover 5 m above the ground.
HEIGHT = 5.0
TIME_TO_RECOVER, TIME_TO_STAY = 2.5, 0.5
ACTUATORS = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03}
IDEAL = (agile(), {})
LAGGING = (agile(**ACTUATORS, input_delay=0.02), {**ACTUATORS, "command_delay": 0.02})


def direction(random: np.random.Generator) -> Array:
    v = random.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def thrown(seed: int, **plant: float) -> SimulatorConfig:
    """Return a start 5 m from the reference, at 10 m/s and 6 rad/s in random directions.

    The attitude is random; every fourth start is exactly upside down.
    """
    random = np.random.default_rng(seed)
    bearing, axis = random.uniform(0.0, 2.0 * math.pi, size=2)
    inverted = Rotation.from_rotvec([math.pi * math.cos(axis), math.pi * math.sin(axis), 0.0])
    attitude = inverted if seed % 4 == 0 else Rotation.from_quat(random.normal(size=4))
    return ideal(
        duration=TIME_TO_RECOVER + TIME_TO_STAY,
        initial_position=(5.0 * math.cos(bearing), 5.0 * math.sin(bearing), HEIGHT),
        initial_velocity=tuple((10.0 * direction(random)).tolist()),
        initial_attitude=tuple(attitude.as_quat().tolist()),
        initial_body_rates=tuple((6.0 * direction(random)).tolist()),
        initial_throttle=ideal().vehicle().hover_throttle,
        **plant,
    )


def recovered(seed: int, mpc: MpcConfig, plant: dict[str, float]) -> tuple[float, float]:
    """Return the time until it stays within 10 cm of the reference, and the minimum height."""
    reference = ReferenceConfig(trajectory="hover", height=HEIGHT)
    steps = list(fly(mpc=mpc, simulator=thrown(seed, **plant), reference=reference))
    assert failures(steps) == 0
    p_WB = np.array([step.truth.p_WB for step in steps])
    away = np.linalg.norm(p_WB - [0.0, 0.0, HEIGHT], axis=1) > 0.1
    return 0.02 * float(np.flatnonzero(away)[-1] + 1), float(p_WB[:, 2].min())


QUICK = [(range(4), *IDEAL), (range(4, 8), *LAGGING)]
ALL = [
    *((range(start, start + 40), *IDEAL) for start in range(0, 200, 40)),
    (range(200, 240), *LAGGING),
]


@pytest.mark.parametrize(
    ("seeds", "mpc", "plant"),
    [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in ALL)],
    ids=lambda value: f"{value.start}-{value.stop - 1}" if isinstance(value, range) else "",
)
def test_recovers_from_random_initial_states(
    seeds: range, mpc: MpcConfig, plant: dict[str, float]
) -> None:
    outcomes = {seed: recovered(seed, mpc, plant) for seed in seeds}
    times, heights = np.array(list(outcomes.values())).T
    assert times.max() <= TIME_TO_RECOVER, outcomes
    assert heights.min() > 0.0, outcomes
