"""rclpy parameters from the configuration dataclasses, and back.

The dataclass is the single source: names, types, ranges and descriptions are declared from it,
and what rclpy received is validated by it as a whole before anything is used.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from quad_mpc_ros.configuration import Configuration, ConfigurationError, ParameterSpec

C = TypeVar("C", bound=Configuration)

_TYPES = {
    "double": Parameter.Type.DOUBLE,
    "integer": Parameter.Type.INTEGER,
    "bool": Parameter.Type.BOOL,
    "string": Parameter.Type.STRING,
    "double_array": Parameter.Type.DOUBLE_ARRAY,
    "integer_array": Parameter.Type.INTEGER_ARRAY,
    "string_array": Parameter.Type.STRING_ARRAY,
}

# rclpy's own, which a parameter file may set as well.
_FOREIGN_NAMES = ("use_sim_time", "start_type_description_service")
_FOREIGN_PREFIXES = ("qos_overrides.",)


def declare(node: Node, configuration: type[C]) -> C:
    """Declare every parameter of a configuration on a node and return what the user has set.

    The node must have been made with ``automatically_declare_parameters_from_overrides=True``:
    that is how a name nobody knows is seen, which rclpy otherwise ignores, and how a whole number
    given for a real one is accepted, which rclpy otherwise refuses. Raises
    :class:`ConfigurationError`.
    """
    given = {
        name: _plain(parameter.value)
        for name, parameter in node.get_parameters_by_prefix("").items()
        if name not in _FOREIGN_NAMES and not name.startswith(_FOREIGN_PREFIXES)
    }
    for name in given:
        node.undeclare_parameter(name)
    config = configuration.build(given)
    values = config.flattened()
    for spec in configuration.specs():
        value = values[spec.name]
        node.declare_parameter(
            spec.name,
            # An empty array has no type of its own, so the type is given apart.
            Parameter(spec.name, _TYPES[spec.kind], _listed(value)).value,
            _descriptor(spec),
            ignore_override=True,
        )
    return config


def follow_changes(node: Node, initial: C, apply: Callable[[C], None]) -> None:
    """Let live parameters change in flight: validated together, then applied together.

    ``apply`` gets the whole new configuration, after rclpy has stored it. Changes that belong
    together go through ``set_parameters_atomically``.
    """
    current = initial

    def changed(parameters: list[Parameter]) -> C:
        known = current.flattened()
        changes = {p.name: _plain(p.value) for p in parameters if p.name in known}
        return current.updated(changes) if changes else current

    def validate(parameters: list[Parameter]) -> SetParametersResult:
        try:
            changed(parameters)
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def take_over(parameters: list[Parameter]) -> None:
        nonlocal current
        updated = changed(parameters)
        if updated is not current:
            current = updated
            apply(updated)

    node.add_on_set_parameters_callback(validate)
    node.add_post_set_parameters_callback(take_over)


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    unit = f" [{spec.unit}]" if spec.unit else ""
    descriptor = ParameterDescriptor(
        name=spec.name,
        description=f"{spec.doc}{unit}",
        additional_constraints=spec.allowed(),
        read_only=not spec.live,
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


def _plain(value: Any) -> Any:
    """Return rclpy's value as plain Python: arrays arrive as ``array.array``."""
    return list(value) if isinstance(value, array.array | tuple | list) else value


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
