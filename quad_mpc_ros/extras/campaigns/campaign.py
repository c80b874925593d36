# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The flights of a campaign: parameters that all flights share, and parameters that vary.

Each varied parameter has its own random numbers, from the seed, the flight's number and the
parameter's name. So campaigns with the same seed fly the same vehicles, even if one campaign
varies more parameters.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import Configuration, UserError
from quad_mpc_ros.configuration.fields import ParameterSpec
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.extras.campaigns.variation import SameAs, Variation
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.simulation.closed_loop import start_on
from quad_mpc_ros.simulation.config import SimulatorConfig

SCHEMA: dict[str, type[Configuration]] = {
    "mpc": MpcConfig,
    "simulator": SimulatorConfig,
    "reference": ReferenceConfig,
}

Parameters = Mapping[str, Mapping[str, Any]]
"""Parameters by node and dotted name."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """A varied parameter, or one element of a vector."""

    node: str
    parameter: str
    element: int | None
    spec: ParameterSpec

    def validated(self, value: Any) -> Any:
        """Return the value in its canonical type, or raise :class:`ConfigurationError`."""
        if self.element is None:
            return self.spec.validated(value, owner=self.node)
        path = f"{self.spec.path}.{self.element}"
        kind = self.spec.kind.removesuffix("_array")
        scalar = dataclasses.replace(self.spec, path=path, kind=kind, length=None, per_axis=False)
        return scalar.validated(value, owner=self.node)


@dataclass(frozen=True, kw_only=True)
class FlightPlan:
    """One flight of a campaign.

    Attributes:
        number: Number of the flight.
        drawn: Values of the varied parameters, by name.
        config: Configuration of all nodes.
        trajectory: The reference.
    """

    number: int
    drawn: Mapping[str, Any]
    config: FlightConfig
    trajectory: Trajectory


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Flights with the same parameters, except for those in ``vary``.

    Attributes:
        flights: Number of flights.
        seed: Seed of the varied values.
        given: Parameters that differ from the defaults, by node.
        vary: Variations by the names ``node.parameter`` or ``node.parameter.element``.
        settle_time: Start of the "settled" figures [s].
        start: ``auto``, ``ground`` or ``reference``, as ``--start`` of ``quad_mpc simulate``.
    """

    flights: int
    seed: int
    given: Parameters
    vary: Mapping[str, Variation]
    settle_time: float
    start: str

    @functools.cached_property
    def base(self) -> dict[str, Configuration]:
        """The configuration of every node without variations."""
        return {node: kind.build(self.given[node]) for node, kind in SCHEMA.items()}

    @functools.cached_property
    def targets(self) -> dict[str, Target]:
        """The parameters of the varied names."""
        return {name: target_of(name, self.base) for name in self.vary}

    @functools.cached_property
    def columns(self) -> tuple[str, ...]:
        """The columns of the varied parameters in the table, one for each vector element."""
        first = self.drawn(0)
        return tuple(column for name in self.vary for column in _cells(name, first[name]))

    def drawn(self, number: int) -> dict[str, Any]:
        """Return the varied values of a flight, keyed by name."""
        values = {}
        for name, variation in self.vary.items():
            if not isinstance(variation, SameAs):
                random = np.random.default_rng([self.seed, number, *name.encode()])
                values[name] = variation.drawn(random)
        return self.completed(values)

    def completed(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of all variations, given the values of independent parameters."""
        return {name: self._followed(name, values) for name in self.vary}

    def cells(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Return the cells of the table for drawn values."""
        cells: dict[str, Any] = {}
        for name, value in drawn.items():
            cells.update(_cells(name, value))
        return cells

    def plan(self, number: int) -> FlightPlan:
        """Return a flight.

        Raises :class:`UserError` for parameters that cannot be used together, and ``ValueError``
        if no initial throttle lifts the vehicle.
        """
        drawn = self.drawn(number)
        config = self.configured(drawn)
        trajectory = _trajectory(config.reference)
        if self._starts_on_reference(trajectory, config.reference):
            explicit = {**self.given["simulator"]}
            explicit |= {
                target.parameter: None
                for target in self.targets.values()
                if target.node == "simulator"
            }
            start = start_on(trajectory, config.simulator)
            missing = {name: value for name, value in start.items() if name not in explicit}
            config = config._replace(simulator=config.simulator.updated(missing))
        return FlightPlan(number=number, drawn=drawn, config=config, trajectory=trajectory)

    def configured(self, drawn: Mapping[str, Any]) -> FlightConfig:
        """Return the configuration with varied values. Raises :class:`ConfigurationError`."""
        changed: dict[str, dict[str, Any]] = {}
        for name, value in drawn.items():
            target = self.targets[name]
            changes = changed.setdefault(target.node, {})
            if target.element is None:
                changes[target.parameter] = target.validated(value)
                continue
            before = self.base[target.node].flattened()[target.parameter]
            vector = [*changes.get(target.parameter, before)]
            vector[target.element] = target.validated(value)
            changes[target.parameter] = tuple(vector)
        built = {
            node: kind.build({**self.given[node], **changed[node]})
            if node in changed
            else self.base[node]
            for node, kind in SCHEMA.items()
        }
        mpc, simulator, reference = (built[node] for node in SCHEMA)
        assert isinstance(mpc, MpcConfig)
        assert isinstance(simulator, SimulatorConfig)
        assert isinstance(reference, ReferenceConfig)
        return FlightConfig(mpc, simulator, reference)

    def _followed(self, name: str, values: Mapping[str, Any]) -> Any:
        """Return the value of a name, which may follow other names."""
        variation = self.vary[name]
        if not isinstance(variation, SameAs):
            return values[name]
        if variation.name in self.vary:
            return variation.of(self._followed(variation.name, values))
        return variation.of(value_in(target_of(variation.name, self.base), self.base))

    def _starts_on_reference(self, trajectory: Trajectory, reference: ReferenceConfig) -> bool:
        if self.start == "auto":
            return trajectory.smooth and reference.mode == "at_once"
        return self.start == "reference"


def target_of(name: str, base: Mapping[str, Configuration]) -> Target:
    """Return the parameter with a name. Raises :class:`UserError` if the parameter is unknown."""
    node, dot, parameter = name.partition(".")
    if not dot or node not in base:
        expected = ", ".join(f"{each}.PARAMETER" for each in base)
        raise UserError(f"{name}: expected one of {expected}")
    specs = {spec.name: spec for spec in type(base[node]).specs()}
    if parameter in specs:
        return Target(node=node, parameter=parameter, element=None, spec=specs[parameter])
    array, _, element = parameter.rpartition(".")
    spec = specs.get(array)
    value = base[node].flattened().get(array)
    if spec is not None and isinstance(value, tuple) and element.isdecimal():
        count = len(value)
        if int(element) < count:
            return Target(node=node, parameter=array, element=int(element), spec=spec)
        raise UserError(f"{name}: {node}.{array} has the elements 0 to {count - 1}")
    type(base[node]).build({parameter: None})  # raises with the known names
    raise AssertionError(name)


def value_in(target: Target, base: Mapping[str, Configuration]) -> Any:
    """Return the value of a parameter or element in a configuration."""
    value = base[target.node].flattened()[target.parameter]
    return value if target.element is None else value[target.element]


def number_text(number: int, flights: int) -> str:
    """Return a flight's number with the digits of the largest number, at least four."""
    digits = max(4, 1 + int(math.log10(max(flights - 1, 1))))
    return f"{number:0{digits}}"


@functools.lru_cache(maxsize=64)
def _trajectory(reference: ReferenceConfig) -> Trajectory:
    """Return a trajectory; preparing a smooth trajectory takes longer than a second of flight."""
    return configured_trajectory(reference)


def _cells(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, list | tuple):
        return {f"{name}.{element}": each for element, each in enumerate(value)}
    return {name: value}
