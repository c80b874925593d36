"""What a campaign flies: the parameters that all flights share, and those that vary.

Flight NUMBER of a campaign is the same wherever and whenever it is flown. Each varied parameter
has its own random numbers, from the seed, the flight's number and the parameter's name, so
that varying one more changes nothing of the others: two campaigns with the same seed fly the same
vehicles.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import Configuration, ConfigurationError, UserError
from quad_mpc_ros.configuration.fields import ParameterSpec
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.extras.campaigns.variation import SameAs, Variation, drawn_within, values_of
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.recordings.recording import flown_points
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
    """A parameter that varies, or one element of it."""

    node: str
    parameter: str
    element: int | None
    spec: ParameterSpec

    def allows(self, value: Any) -> bool:
        """Whether the parameter can have a value."""
        try:
            self.validated(value)
        except ConfigurationError:
            return False
        return True

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
        number: Its number.
        drawn: The value of each varied parameter by its name.
        config: What flies.
        trajectory: What is flown.
    """

    number: int
    drawn: Mapping[str, Any]
    config: FlightConfig
    trajectory: Trajectory


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Flights that share what is ``given`` and vary in what ``vary`` names.

    Attributes:
        flights: How many; of a grid, all combinations of what can be listed.
        seed: From which the varied values are drawn.
        given: The parameters that are not at their defaults.
        vary: How parameters vary, by their names ``node.parameter`` or ``node.parameter.element``.
        grid: Whether combinations are flown in order instead of drawn.
        settle_time: From when on "settled" figures count [s].
        start: ``auto``, ``ground`` or ``reference``, as ``--start`` of ``quad_mpc simulate``.
    """

    flights: int
    seed: int
    given: Parameters
    vary: Mapping[str, Variation]
    grid: bool
    settle_time: float
    start: str

    @functools.cached_property
    def base(self) -> dict[str, Configuration]:
        """The configuration of every node with nothing varied."""
        return {node: kind.build(self.given[node]) for node, kind in SCHEMA.items()}

    @functools.cached_property
    def targets(self) -> dict[str, Target]:
        """The parameter of each varied name."""
        return {name: target_of(name, self.base) for name in self.vary}

    @functools.cached_property
    def columns(self) -> tuple[str, ...]:
        """The names of the varied parameters in the table, those of vectors one by one."""
        first = self.drawn(0)
        return tuple(column for name in self.vary for column in _cells(name, first[name]))

    def drawn(self, number: int) -> dict[str, Any]:
        """Return the values of a flight by the names of what varies.

        Raises ``ValueError`` where a draw gives nothing that is allowed.
        """
        values = self._combination(number) if self.grid else {}
        for name, variation in self.vary.items():
            if name not in values and not isinstance(variation, SameAs):
                random = np.random.default_rng([self.seed, number, *name.encode()])
                values[name] = drawn_within(variation, random, self.targets[name].allows)
        return self.completed(values)

    def completed(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values of all that varies, given those of what follows no other."""
        return {name: self._followed(name, values) for name in self.vary}

    def cells(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Return the cells of the table for drawn values."""
        cells: dict[str, Any] = {}
        for name, value in drawn.items():
            cells.update(_cells(name, value))
        return cells

    def plan(self, number: int) -> FlightPlan:
        """Return a flight.

        Raises :class:`UserError` where its parameters cannot be used together, and ``ValueError``
        where the vehicle has no throttle to begin with.
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
        """Return what flies with varied values. Raises :class:`ConfigurationError`."""
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

    def _combination(self, number: int) -> dict[str, Any]:
        """Return the values of a flight of the grid, of what can be listed."""
        listed = {name: each.listed() for name, each in self.vary.items() if each.listed()}
        return dict(zip(listed, values_of([*listed.values()], number), strict=True))

    def _followed(self, name: str, values: Mapping[str, Any]) -> Any:
        """Return the value of a name, through all that it follows."""
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
    """Return the parameter that a name stands for. Raises :class:`UserError` for none."""
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
    type(base[node]).build({parameter: None})  # says which names there are
    raise AssertionError(name)


def value_in(target: Target, base: Mapping[str, Configuration]) -> Any:
    """Return the value of a parameter, or of an element, in a configuration."""
    value = base[target.node].flattened()[target.parameter]
    return value if target.element is None else value[target.element]


def number_text(number: int, flights: int) -> str:
    """Return a flight's number with as many digits as the largest one has, four at least."""
    digits = max(4, 1 + int(math.log10(max(flights - 1, 1))))
    return f"{number:0{digits}}"


@functools.lru_cache(maxsize=64)
def _trajectory(reference: ReferenceConfig) -> Trajectory:
    """Return a trajectory; to prepare a smooth one takes longer than a second of flight."""
    return configured_trajectory(reference, read_bag=flown_points)


def _cells(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, list | tuple):
        return {f"{name}.{element}": each for element, each in enumerate(value)}
    return {name: value}
