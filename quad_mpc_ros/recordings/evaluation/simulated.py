# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A simulated flight as arrays, like a recorded flight: the closed loop without ROS and files."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

from quad_mpc_ros.configuration import ArgumentError, files
from quad_mpc_ros.configuration.arguments import instance, number
from quad_mpc_ros.control.config import MPC, MpcConfig
from quad_mpc_ros.control.control_law import ControlLaw
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.recordings.flight import (
    STATES,
    Flight,
    ReferenceSampler,
    first_by_stamp,
    flown_arrays,
)
from quad_mpc_ros.recordings.logs import Log, Received, T
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.path import Path
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.simulation.closed_loop import CommandFunction, LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.plant import Plant
from quad_mpc_ros.simulation.shapes import Scene
from quad_mpc_ros.simulation.surroundings import configured_scene

_LOG = logging.getLogger(__name__)
_MAX_DURATION = 1e6  # s, of a flight
_METHODS = {
    "plant": ("apply", "advance_to", "odometry"),
    "trajectory": ("at",),
    "controller": ("reset", "step"),
}


class FlightConfig(NamedTuple):
    """The configuration of a simulated flight, in the argument order of :func:`simulate`."""

    mpc: MpcConfig
    simulator: SimulatorConfig
    reference: ReferenceConfig


def load_config(*sources: str, assignments: Sequence[str] = ()) -> FlightConfig:
    """Return the parameters of ROS parameter files and shipped presets; later sources win.

    Args:
        sources: Paths of files, or names of presets: ``default``, ``paper``,
            ``paper_rigid_body``, ``agile``, ``rotorpy``, ``vehicles/racer`` and so on.
        assignments: Single parameters, like ``mpc.horizon_steps=20``, with precedence.

    Returns:
        The parameters of MPC, simulator and reference: ``simulate(*load_config("paper"))``.

    Raises:
        UserError: A file cannot be read.
        ArgumentError: A source or an assignment is not a text.
        ConfigurationError: A value is not allowed; the error names the allowed values.

    Example:
        >>> load_config("paper").mpc.formulation
        'paper'
    """
    if isinstance(assignments, str) or not isinstance(assignments, Sequence):
        raise ArgumentError("assignments", assignments, 'a list like ["mpc.horizon_steps=20"]')
    for name, texts in (("sources", sources), ("assignments", assignments)):
        for text in texts:
            instance(text, name, str)
    schema: files.Schema = {
        kind.owner: kind for kind in (MpcConfig, SimulatorConfig, ReferenceConfig, RecorderConfig)
    }
    loaded = files.load(sources, assignments, schema=schema)
    return FlightConfig(
        mpc=cast(MpcConfig, loaded["mpc"]),
        simulator=cast(SimulatorConfig, loaded["simulator"]),
        reference=cast(ReferenceConfig, loaded["reference"]),
    )


def simulate(
    mpc: MpcConfig | None = None,
    simulator: SimulatorConfig | None = None,
    reference: ReferenceConfig | None = None,
    *,
    duration: float = 10.0,
    plant: Plant | None = None,
    trajectory: Trajectory | Path | None = None,
    controller: Controller | ControlLaw | CommandFunction | None = None,
    scene: Scene | None = None,
    on_reference: bool = False,
    observe: Callable[[LoopStep], None] | None = None,
) -> Flight:
    """Fly the closed loop in simulated time, like ``quad_mpc simulate``.

    The commands equal those of a lockstep flight over DDS with these parameters, bit for bit.

    Args:
        mpc: The MPC; the paper's vehicle by default.
        simulator: Plant and sensors; by default the true rigid body, at rest on the ground, and
            odometry without errors.
        reference: The reference; by default the paper's square.
        duration: Duration [s]; a nonzero ``simulator.duration`` has precedence.
        plant: A plant that replaces the simulator's plant.
        trajectory: Replaces the trajectory of ``reference``: a path (position and its derivatives
            over time; attitude follows from flatness), or a trajectory.
        controller: Controller that replaces ``mpc.controller``: an object with ``reset`` and
            ``step`` (:class:`.ControlLaw`), or a function of odometry and reference window, with
            the checks, limits and failsafe of the MPC. The first error is logged.
        scene: Obstacles that replace the simulator's file; the flight ends at a collision.
        on_reference: Start in motion on the reference, not at the initial state of ``simulator``.
        observe: Called with each step.

    Returns:
        The flight as arrays; :func:`summarise` has its figures of merit.

    Raises:
        UserError: The vehicle cannot fly the reference, or a requirement of the plant is missing.
        ArgumentError: An argument has another type, or the duration is not positive.
        ValueError: With ``on_reference``, no initial throttle is feasible.

    Example:
        >>> flight = simulate(reference=ReferenceConfig(trajectory="hover"), duration=0.5)
        >>> flight.p_WB.shape
        (25, 3)
    """
    mpc = MpcConfig() if mpc is None else instance(mpc, "mpc", MpcConfig)
    if simulator is None:
        simulator = SimulatorConfig()
    if reference is None:
        reference = ReferenceConfig()
    instance(simulator, "simulator", SimulatorConfig)
    instance(reference, "reference", ReferenceConfig)
    instance(on_reference, "on_reference", bool)
    duration = number(duration, "duration", above=0.0, below=_MAX_DURATION)
    mpc = dataclasses.replace(mpc, lockstep=True)
    kind: Any = controller if hasattr(controller, "__qualname__") else type(controller)
    if callable(controller) and not isinstance(controller, ControlLaw | type):
        controller = cast(ControlLaw, SimpleNamespace(step=controller, reset=lambda: None))
    _check_parts(plant=plant, trajectory=trajectory, controller=controller)
    if isinstance(controller, ControlLaw):
        mpc = dataclasses.replace(mpc, controller=f"{kind.__module__}:{kind.__qualname__}")
    if simulator.duration == 0.0:
        simulator = dataclasses.replace(simulator, duration=duration)
    if scene is not None:
        instance(scene, "scene", Scene)
    log = FlightLog(mpc, scene)
    for step in fly(
        mpc=mpc,
        simulator=simulator,
        reference=reference,
        plant=plant,
        trajectory=trajectory,
        controller=controller,
        scene=scene,
        on_reference=on_reference,
    ):
        log.take(step)
        if observe is not None:
            observe(step)
    flight = log.flight(FlightConfig(mpc, simulator, reference))
    errors = flight.stats["solver_failures"] + flight.stats["deadline_misses"] > 0
    if mpc.controller != MPC and errors.any():
        _LOG.warning("%s: %s", mpc.controller, flight.stats["reason"][errors.argmax()])
    return flight


def _check_parts(**given: object) -> None:
    """Reject parts of a flight that lack required methods."""
    for name, part in given.items():
        if part is None or isinstance(part, Controller):
            continue
        methods = _METHODS[name]
        has_all = all(callable(getattr(part, method, None)) for method in methods)
        if isinstance(part, type) or not has_all:
            raise ArgumentError(name, part, f"an object with {', '.join(methods)}")


class FlightLog:
    """Collects the steps of a closed loop into a flight."""

    def __init__(self, mpc: MpcConfig, scene: Scene | None = None) -> None:
        """Take the controller, and obstacles that replace the simulator's file."""
        self._vehicle, self._scene = mpc.vehicle(), scene
        self._odometry, self._truth = Log(OdometrySample), Log(OdometrySample)
        self._commands, self._stats = Log(CommandSample), Log(TickStats)
        self._windows: list[ReferenceWindow] = []

    def take(self, step: LoopStep) -> None:
        """Take the next step."""
        stamp_ns = step.odometry.stamp_ns
        self._odometry.append(_at(stamp_ns, step.odometry))
        self._truth.append(_at(stamp_ns, step.truth))
        self._windows.append(step.window)
        if step.command is not None:
            self._commands.append(_at(stamp_ns, step.command))
        if step.tick is not None:
            self._stats.append(_at(stamp_ns, step.tick.stats))

    def flight(self, config: FlightConfig) -> Flight:
        """Return the flight of the collected steps, at least one, with its configuration."""
        arrays = flown_arrays(self._odometry, self._commands, self._stats)
        sampler = ReferenceSampler(arrays["stamp_ns"], self._vehicle)
        for window in self._windows:
            sampler.take(window)
        return Flight(
            **arrays,
            reference=sampler.track(),
            parameters={each.owner: each.flattened() for each in config},
            mpc=config.mpc,
            scene=self._scene or configured_scene(config.simulator.obstacles),
        )

    def with_truth(self, flight: Flight) -> Flight:
        """Return the flight of these steps with the true states in place of the measured ones."""
        _, first = first_by_stamp(self._odometry.stamp_ns)
        states: dict[str, Any] = {name: self._truth.column(name)[first] for name in STATES}
        return dataclasses.replace(flight, **states)


def _at(stamp_ns: int, value: T) -> Received[T]:
    return Received(value=value, log_time_ns=stamp_ns, publish_time_ns=stamp_ns)
