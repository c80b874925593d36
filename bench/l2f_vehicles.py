# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly vehicles drawn by the rules of l2f in l2f, an independent plant, under three rate loops.

    python -P bench/l2f_vehicles.py --flights 64
    python -P bench/l2f_vehicles.py --flights 8 --only "gain alone"

l2f is the simulator of RAPTOR (J. Eschmann et al., arXiv 2509.11481): rotors that speed up and
slow down with different lags, a rigid body, no drag and no ground. Its vehicles have 0.02 to 5 kg,
a thrust over weight of 1.5 to 5, a torque over inertia of 40 to 1200 rad/s^2 and rotor lags of 30
to 100 ms up and 30 to 300 ms down. Only mass and thrust curve are configured; odometry is exact,
and commands are delayed by the 20 ms of the preset ``default``, which the MPC models.

The rate loop and mixer run here at 500 Hz, in front of l2f's rotors. The rate loops: ``tuned``
(gain of 25/s and a gain on the acceleration, for a damping of 0.7), ``gain alone`` (25/s: it
rings), and ``slow`` (half of one over the rotors' lag). A hover starts up to 0.4 m off and 20
degrees tilted, ``tumbling`` in any attitude and turning with up to 6 rad/s, a lemniscate in motion
on the reference. A flight counts as crashed if it comes below the ground, or if its mean error
from 10 s on is above 1 m.

l2f is not a dependency of the package. ``pip install l2f`` compiles for about ten minutes with
5.6 GB; without ``#define L2F_VECTOR`` in its ``interface.cpp`` (and ``vector_factory`` within
``#ifdef L2F_VECTOR``) it compiles in 16 s, which is enough here.
docs/measurements/robustness.md.
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import json
import math
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from step_times import median_step_us

from quad_mpc_ros import load_config
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, State, odometry_from_state
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.simulation.closed_loop import fly, start_on
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.plant import DelayedPlant

STEP_NS = 2_000_000
GAIN = 25.0  # 1/s
DAMPING = 0.7
SETTLED = 10.0  # s
LOOPS = ("tuned", "gain alone", "slow")
TASKS = ("hover", "tumbling", "lemniscate 1.0 rad/s", "lemniscate 1.5 rad/s")
_MASS = (0.02, 5.0)  # kg
_THRUST_TO_WEIGHT = (1.5, 5.0)
_TORQUE_TO_INERTIA = (40.0, 1200.0)  # rad/s^2
_SIZE_DEVIATION = 0.1
_TORQUE_CONSTANT = (0.005, 0.05)  # m
_LAG_UP = (0.03, 0.1)  # s
_LAG_DOWN = (0.03, 0.3)  # s


class Result(NamedTuple):
    """Result of a flight: whether the vehicle crashed, and the mean error once settled [m].

    ``step_us`` is the median time of a step of the controller [us].
    """

    crashed: bool
    mean: float
    step_us: float


@dataclass(frozen=True, kw_only=True)
class Flight:
    """A vehicle (its number), a rate loop, a task, and parameters that differ from the preset."""

    vehicle: int
    loop: str
    task: str
    assignments: tuple[str, ...] = ()


def vehicle_of(number: int, nominal: dict[str, Any]) -> dict[str, Any]:
    """Return l2f's parameters of a vehicle, drawn as ``sample_initial_parameters`` of l2f draws.

    Args:
        number: Number of the vehicle, the seed of its draws.
        nominal: Parameters of l2f's default vehicle, the Crazyflie.
    """
    draw = np.random.default_rng([2509, number])
    parameters: dict[str, Any] = json.loads(json.dumps(nominal))
    dynamics = parameters["dynamics"]
    curve = np.array(dynamics["rotor_thrust_coefficients"])
    weight = 9.81 * dynamics["mass"]
    thrust_to_weight = draw.uniform(*_THRUST_TO_WEIGHT)
    mass = draw.uniform(*np.cbrt(_MASS)) ** 3
    scale = np.cbrt(mass / dynamics["mass"])
    curve *= thrust_to_weight / (curve.sum() / weight) * mass / dynamics["mass"]
    arm = abs(dynamics["rotor_positions"][0][0])
    max_torque = arm * math.sqrt(2.0) * thrust_to_weight * mass * 9.81 / 4
    factor = draw.uniform(*_TORQUE_TO_INERTIA) / (max_torque / dynamics["J"][0][0])
    deviation = draw.normal(0.0, _SIZE_DEVIATION)
    scale *= 1.0 / (1.0 - deviation) if deviation < 0.0 else 1.0 + deviation
    inertia = np.array(dynamics["J"]) * scale / factor
    dynamics |= {
        "mass": mass,
        "rotor_thrust_coefficients": curve.tolist(),
        "rotor_positions": (scale * np.array(dynamics["rotor_positions"])).tolist(),
        "J": inertia.tolist(),
        "J_inv": np.linalg.inv(inertia).tolist(),
        "rotor_torque_constants": [draw.uniform(*_TORQUE_CONSTANT)] * 4,
        "rotor_time_constants_rising": [draw.uniform(*_LAG_UP)] * 4,
        "rotor_time_constants_falling": [draw.uniform(*_LAG_DOWN)] * 4,
    }
    parameters["integration"]["dt"] = 1e-9 * STEP_NS
    return parameters


class L2fPlant(DelayedPlant):
    """A vehicle of l2f under a rate loop and a mixer that gives torque precedence over thrust.

    With ``rotor_throttles`` the rotors are commanded directly.
    """

    follows_rotors = True

    def __init__(self, config: SimulatorConfig, vehicle: int, loop: str) -> None:
        super().__init__(config)
        l2f = self._l2f = importlib.import_module("l2f")
        self._device, self._env, self._rng = l2f.Device(), l2f.Environment(), l2f.Rng()
        self._parameters, self._now, self._next = l2f.Parameters(), l2f.State(), l2f.State()
        l2f.initialize_environment(self._device, self._env)
        l2f.initialize_rng(self._device, self._rng, vehicle)
        l2f.initial_parameters(self._device, self._env, self._parameters)
        nominal = json.loads(l2f.parameters_to_json(self._device, self._env, self._parameters))
        parameters = vehicle_of(vehicle, nominal)
        l2f.parameters_from_json(self._device, self._env, json.dumps(parameters), self._parameters)
        dynamics = parameters["dynamics"]
        self.mass = float(dynamics["mass"])
        self.thrust_curve = [*reversed(dynamics["rotor_thrust_coefficients"][0])]
        self._inertia = np.diag(np.array(dynamics["J"]))
        self._mixer = _thrusts_of(dynamics)
        x, y, _ = np.transpose(dynamics["rotor_positions"])
        self._order = np.argsort(np.arctan2(y, x) % math.tau)
        lag = 0.5 * (
            dynamics["rotor_time_constants_rising"][0]
            + dynamics["rotor_time_constants_falling"][0]
        )
        self._gain = 0.5 / lag if loop == "slow" else GAIN
        self._damping = (
            max(2.0 * DAMPING * math.sqrt(GAIN * lag) - 1.0, 0.0) if loop == "tuned" else 0.0
        )
        l2f.initial_state(self._device, self._env, self._parameters, self._now)
        q_WB_xyzw = np.array(config.initial_attitude)
        self._now.position = config.initial_position
        self._now.orientation = np.roll(q_WB_xyzw / np.linalg.norm(q_WB_xyzw), 1).tolist()
        self._now.linear_velocity = config.initial_velocity
        self._now.angular_velocity = config.initial_body_rates
        hover = self._speed(np.full(4, 9.81 * self.mass / 4))
        self._now.rpm = hover.tolist()
        self._u = Input(throttle=float(hover[0]), w_WB_B=np.zeros(3))
        self._acceleration = np.zeros(3)

    @property
    def v_WB_W(self) -> Array:
        """True velocity (3,) [m/s]."""
        return np.array(self._now.linear_velocity, dtype=float)

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry with the given stamp."""
        q_WB_xyzw = np.roll(np.array(self._now.orientation, dtype=float), -1)
        R_WB = so3.rotation_from_quaternion_xyzw(q_WB_xyzw / np.linalg.norm(q_WB_xyzw))
        state = State(
            p_WB=np.array(self._now.position, dtype=float),
            v_WB_B=R_WB.T @ self.v_WB_W,
            R_WB=R_WB,
        )
        return odometry_from_state(
            state,
            w_WB_B=np.array(self._now.angular_velocity, dtype=float),
            stamp_ns=stamp_ns,
            frame_id="odom",
            child_frame_id="base_link",
        )

    def _follow(self, command: Input) -> None:
        self._u = command

    def _integrate(self, duration_ns: int) -> None:
        if duration_ns % STEP_NS:
            raise ValueError(f"duration_ns: given {duration_ns}, expected multiples of {STEP_NS}")
        for _ in range(duration_ns // STEP_NS):
            before = np.array(self._now.angular_velocity, dtype=float)
            speeds = self._rotor_speeds(before)
            if self._rotor_throttles is not None:
                speeds[self._order] = self._rotor_throttles.clip(0.0, 1.0)
            action = 2.0 * speeds - 1.0
            self._l2f.step(
                self._device,
                self._env,
                self._parameters,
                self._now,
                action.tolist(),
                self._next,
                self._rng,
            )
            self._now, self._next = self._next, self._now
            after = np.array(self._now.angular_velocity, dtype=float)
            self._acceleration = (after - before) / (1e-9 * STEP_NS)

    def _rotor_speeds(self, w_WB_B: Array) -> Array:
        """Return the rotors' speeds (4,) in [0, 1] for the command in effect."""
        gyroscopic = np.cross(w_WB_B, self._inertia * w_WB_B)
        wanted = self._gain * (self._u.w_WB_B - w_WB_B) - self._damping * self._acceleration
        torque = self._inertia * wanted + gyroscopic
        least, most = _polynomial(self.thrust_curve, 0.0), _polynomial(self.thrust_curve, 1.0)
        room = most - least
        level = self._mixer[:, 1:3] @ torque[:2]
        level *= min(1.0, room / max(np.ptp(level), 1e-9))
        yaw = self._mixer[:, 3] * torque[2]
        yaw *= min(1.0, max(room - np.ptp(level), 0.0) / max(np.ptp(yaw), 1e-9))
        turn = level + yaw
        thrust = _polynomial(self.thrust_curve, self._u.throttle)
        thrust = min(max(thrust, least - turn.min()), most - turn.max())
        return self._speed(np.clip(thrust + turn, least, most))

    def _speed(self, thrusts: Array) -> Array:
        a, b, c = self.thrust_curve
        return (-b + np.sqrt(b * b - 4.0 * a * (c - thrusts))) / (2.0 * a)


def _polynomial(curve: list[float], throttle: float) -> float:
    a, b, c = curve
    return (a * throttle + b) * throttle + c


def _thrusts_of(dynamics: dict[str, Any]) -> Array:
    """Return the matrix (4, 4) from thrust [N] and torque [Nm] to the rotors' thrusts [N]."""
    position = np.array(dynamics["rotor_positions"])
    turn = np.array(dynamics["rotor_torque_directions"])[:, 2]
    yaw = turn * np.array(dynamics["rotor_torque_constants"])
    return np.linalg.inv(np.stack([np.ones(4), position[:, 1], -position[:, 0], yaw]))


def result_of(flight: Flight, duration: float = 20.0) -> Result:
    """Fly and return the result."""
    tumbling = flight.task == "tumbling"
    height = 20.0 if tumbling else 2.0
    draw = np.random.default_rng([17, flight.vehicle])
    start: dict[str, Any] = {"initial_position": [0.0, 0.0, height]}
    if tumbling:
        q_WB_xyzw = draw.normal(size=4)
        start |= {
            "initial_attitude": (q_WB_xyzw / np.linalg.norm(q_WB_xyzw)).tolist(),
            "initial_body_rates": draw.uniform([-6, -6, -3], [6, 6, 3]).tolist(),
        }
    elif flight.task == "hover":
        tilt = so3.exp(np.radians(draw.uniform([-20, -20, 0], [20, 20, 0])))
        start = {
            "initial_position": draw.uniform([-0.4, -0.4, 1.6], [0.4, 0.4, 2.4]).tolist(),
            "initial_attitude": so3.quaternion_xyzw_from_rotation(tilt).tolist(),
        }
    base = load_config("default", assignments=flight.assignments)
    simulator = base.simulator.updated({"duration": duration, **start})
    shape: dict[str, Any] = {"trajectory": "hover", "height": height}
    if flight.task.startswith("lemniscate"):
        shape |= {
            "trajectory": "lemniscate",
            "amplitude_x": 2.0,
            "amplitude_y": 1.0,
            "angular_frequency": float(flight.task.split()[1]),
        }
    plant = L2fPlant(simulator, flight.vehicle, flight.loop)
    own = {"mass": plant.mass, "thrust_curve": plant.thrust_curve, "drag": 0.0}
    mpc = base.mpc.updated({**own, "drag": base.mpc.drag})
    reference = base.reference.updated({**shape, **own})
    if flight.task.startswith("lemniscate"):
        flown = configured_trajectory(reference)
        simulator = simulator.updated(start_on(flown, simulator.updated(own)))
        plant = L2fPlant(simulator, flight.vehicle, flight.loop)
    errors: list[float] = []
    ticks: list[Tick | None] = []
    first_ns = None
    for step in fly(mpc=mpc, simulator=simulator, reference=reference, plant=plant):
        first_ns = step.sent_ns if first_ns is None else first_ns
        ticks.append(step.tick)
        if step.truth.p_WB[2] < 0.0:
            errors = [math.nan]
            break
        if step.sent_ns - first_ns >= 1e9 * SETTLED:
            errors.append(float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0])))
    mean = float(np.mean(errors))
    step_us = median_step_us(ticks, mpc.controller)
    return Result(crashed=not mean <= 1.0, mean=mean, step_us=step_us)


def flights(count: int, only: str) -> Iterator[tuple[str, list[Flight]]]:
    """Yield each row's name and flights."""
    for loop in LOOPS:
        for task in TASKS:
            if only in (name := f"{loop}, {task}"):
                yield name, [Flight(vehicle=i, loop=loop, task=task) for i in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--flights", type=int, default=64, help="vehicles per row (default: 64)")
    parser.add_argument("--duration", type=float, default=20.0, help="of a flight [s]")
    parser.add_argument("--only", default="", help="rows with this text in their name")
    parser.add_argument("--workers", type=int, help="processes (default: one per core)")
    options = parser.parse_args()
    if importlib.util.find_spec("l2f") is None:
        sys.exit("l2f cannot be imported; install it with: pip install l2f")
    print(f"{'rate loop, flight':36} crashed  mean error p50, p95 [cm]")
    with ProcessPoolExecutor(options.workers) as pool:
        for name, row in flights(options.flights, options.only):
            fly_one = functools.partial(result_of, duration=options.duration)
            results = list(pool.map(fly_one, row))
            means = [100.0 * each.mean for each in results if not each.crashed]
            figures = np.percentile(means, [50, 95]) if means else (math.nan, math.nan)
            lost = [i for i, each in enumerate(results) if each.crashed]
            print(
                f"{name:36} {len(lost):3d} of {len(results)}  {figures[0]:.1f}, {figures[1]:.1f}"
                f"  {lost if lost else ''}",
                flush=True,
            )


if __name__ == "__main__":
    main()
