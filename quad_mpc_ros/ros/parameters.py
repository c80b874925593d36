# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between configuration dataclasses and rclpy parameters.

The dataclass is the single source of names, types, ranges and descriptions. The dataclass
validates rclpy's values as a whole before use.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from quad_mpc_ros.configuration import Configuration, ConfigurationError, ParameterSpec
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.configuration.vehicle import VEHICLE, describes_vehicle

C = TypeVar("C", bound=Configuration)

declared: dict[str, set[str]] = {}
"""The names of parameters that nodes of this process have declared, by full name of the node."""


def declare(node: Node, configuration: type[C], *, managed: bool = False) -> C:
    """Declare all parameters of a configuration on a node and return the configuration.

    rclpy would reject an integer for a double and an empty list, so values are checked here.
    Parameters that are not live are read-only, unless ``managed``: then :class:`ManagedParameters`
    decides when they may change. Raises :class:`ConfigurationError`.
    """
    given = _given(node, {*VEHICLE, *(spec.name for spec in configuration.specs())})
    specs = configuration.chosen_by(given).specs()  # the choice may add parameters
    given |= _given(node, {spec.name for spec in specs} - given.keys())
    declared[node.get_fully_qualified_name()] = {spec.name for spec in specs}
    common = {name: value for name, value in given.items() if describes_vehicle(name)}
    own = {name: value for name, value in given.items() if name not in common}
    config = configuration.build({**configuration.share(common, own), **own})
    values = config.flattened()
    for spec in specs:
        value = _plain(values[spec.name])
        node.declare_parameter(
            spec.name,
            Parameter(spec.name, _type_of(spec, value), value).value,  # [] has no type
            _descriptor(spec, managed=managed),
            ignore_override=True,
        )
    return config


def _given(node: Node, names: Iterable[str]) -> dict[str, Any]:
    """Return the values that rclpy has for parameters that are not declared, by name."""
    found = node.declare_parameters(
        "", [(name, None, ParameterDescriptor(dynamic_typing=True)) for name in names]
    )
    for each in found:
        node.undeclare_parameter(each.name)
    return {each.name: _plain(each.value) for each in found if each.value is not None}


class ManagedParameters(Generic[C]):
    """The parameters of a node with a lifecycle.

    While the node is unconfigured, parameters are validated alone. :meth:`finalize` validates them
    together. Then, until :meth:`release`, only live parameters may change. Parameters set with one
    ``set_parameters_atomically`` are a transaction, rejected or applied as a whole.
    """

    def __init__(self, node: Node, configuration: type[C], *, apply: Callable[[C], None]) -> None:
        """Declare the parameters. Raises :class:`ConfigurationError` for invalid values."""
        self._node = node
        self._kind = configuration
        self._apply = apply
        self._finalized: C | None = None
        self._accepted: C | None = None
        # The selected trajectory or plant may add parameters.
        self._specs = {
            spec.name: spec for spec in declare(node, configuration, managed=True).specs()
        }
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply_accepted)

    def finalize(self) -> C:
        """Return the configuration; from now on only live parameters may change.

        Raises :class:`ConfigurationError` if values contradict each other.
        """
        parameters = self._node.get_parameters(list(self._specs))
        self._finalized = self._kind.build({p.name: _plain(p.value) for p in parameters})
        self._accepted = None
        return self._finalized

    def release(self) -> None:
        """Allow changes of all parameters again."""
        self._finalized = None

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        changes = {p.name: _plain(p.value) for p in parameters if p.name in self._specs}
        try:
            if self._finalized is not None:
                self._accepted = self._updated(self._finalized, changes)
            else:
                for name, value in changes.items():
                    self._specs[name].validated(value, owner=self._kind.owner)
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_accepted(self, _: list[Parameter]) -> None:
        """Apply the accepted configuration."""
        if self._finalized is not None and self._accepted is not None:
            before, self._finalized, self._accepted = self._finalized, self._accepted, None
            self._apply(self._finalized)
            self._log_changes(before.flattened(), self._finalized.flattened())

    def _log_changes(self, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
        changes = ", ".join(
            f"{name} {text_of(before[name])} to {text_of(value)}"
            for name, value in after.items()
            if value != before[name]
        )
        if changes:
            self._node.get_logger().info(f"changed: {changes}")

    def _updated(self, config: C, changes: Mapping[str, object]) -> C:
        """Return a configuration with live parameters changed, validated as a whole.

        Other parameters may be set to their current value; switches stay on or off.
        """
        in_force = config.flattened()
        for name, value in changes.items():
            spec = self._specs[name]
            wanted = spec.validated(value, owner=self._kind.owner)
            if not spec.may_change(in_force[name], wanted):
                kept = text_of(in_force[name])
                if spec.live and in_force[name] != 0:
                    kept = "not 0"
                raise ConfigurationError(
                    f"{self._kind.owner}.{name}",
                    value,
                    f"{kept} as long as the node is configured; to change it, deactivate and "
                    "clean up the node first, or set it in the parameter file and restart",
                )
        return config.updated(changes) if changes else config


def _descriptor(spec: ParameterSpec, *, managed: bool) -> ParameterDescriptor:
    unit = f" [{spec.unit}]" if spec.unit else ""
    when = "at any time" if spec.live else "while the node is unconfigured"
    if spec.switch:
        when += ", from 0 or to 0 while the node is unconfigured"
    descriptor = ParameterDescriptor(
        name=spec.name,
        description=f"{spec.doc}{unit}",
        # Dynamic for real numbers, which may be given as integers, and for arrays: an empty array
        # is one of bytes for rclpy and one of bools for the command line.
        dynamic_typing=spec.kind.startswith("double") or spec.kind.endswith("_array"),
        additional_constraints=spec.allowed() + (f"; may be set {when}" if managed else ""),
        read_only=not (managed or spec.live),
    )
    if spec.minimum is not None and spec.maximum is not None:
        if spec.kind == "double":
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(spec.minimum), to_value=float(spec.maximum))
            ]
        elif spec.kind == "integer":
            descriptor.integer_range = [
                IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)
            ]
    return descriptor


def _type_of(spec: ParameterSpec, value: Any) -> Parameter.Type:
    """Return the type of a parameter with this value."""
    if spec.per_axis and isinstance(value, array.array | tuple | list):
        return Parameter.Type[f"{spec.kind}_array".upper()]
    return Parameter.Type[spec.kind.upper()]


def _plain(value: Any) -> Any:
    """Return a value with arrays (``array.array`` in rclpy) as lists."""
    return list(value) if isinstance(value, array.array | tuple | list) else value
