# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Declaration of a parameter: name, type, default, unit, range and meaning in one place.

A node's parameters are the fields of a frozen dataclass derived from :class:`Configuration`.
YAML files, rclpy declarations and the documentation are derived from those fields. Validation
happens on construction; the only conversion is from integers to real numbers.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

from quad_mpc_ros.configuration.errors import ConfigurationError
from quad_mpc_ros.configuration.spelling import did_you_mean
from quad_mpc_ros.configuration.vehicle import VEHICLE

_METADATA_KEY = "quad_mpc_ros.parameter"
_ADVANCED = "advanced."

PerAxis = float | tuple[float, ...]
"""Type of a parameter that is one number for all body axes or three, one each for x, y and z."""
_AXES = 3


def per_axis(value: PerAxis) -> tuple[float, float, float]:
    """Return the numbers of the body axes x, y, z."""
    x, y, z = value if isinstance(value, tuple) else (value,) * _AXES
    return x, y, z


@dataclass(frozen=True, kw_only=True)
class ParameterSpec:
    """Specification of a parameter.

    ``above`` and ``below`` are exclusive bounds, ``minimum`` and ``maximum`` inclusive bounds;
    bounds of an array apply to every element. ``length`` is the required number of elements.
    ``per_axis`` also allows three numbers, one for each body axis. ``live`` allows a change in
    flight; ``switch`` forbids changes from or to zero, which change the structure of the problem.
    The name of an ``advanced`` parameter, which users do not need to set, begins with
    ``advanced.``. ``path`` is the path of the field.
    """

    path: str = ""
    kind: str = ""
    default: Any = None
    doc: str = ""
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    below: float | None = None
    length: int | None = None
    per_axis: bool = False
    choices: tuple[str, ...] | None = None
    live: bool = False
    switch: bool = False
    advanced: bool = False

    @property
    def name(self) -> str:
        """Name by which the parameter is set."""
        return f"{_ADVANCED}{self.path}" if self.advanced else self.path

    def may_change(self, before: Any, after: Any) -> bool:
        """Whether the value may change in flight between two validated values."""
        if not self.live:
            return bool(before == after)
        return not self.switch or (before == 0) == (after == 0)

    def allowed(self) -> str:
        """Return the allowed values as a phrase: ``'9 numbers >= 0'``."""
        if self.choices is not None:
            return "one of " + ", ".join(self.choices)
        singular, plural = _NOUNS[self.kind.removesuffix("_array")]
        if self.kind.endswith("_array"):
            noun = f"{self.length or 'a list of'} {plural}"
        else:
            noun = singular
        bounds = [f"{symbol} {bound:g}" for symbol, bound in self._bounds()]
        phrase = " ".join([noun, " and ".join(bounds)]).strip()
        return f"{phrase}, or {_AXES} numbers (body x, y, z)" if self.per_axis else phrase

    def validated(self, value: object, *, owner: str = "") -> Any:
        """Return ``value`` in its canonical type, or raise :class:`ConfigurationError`."""
        try:
            listed = isinstance(value, Sequence) and not isinstance(value, str | bytes)
            if self.per_axis and listed:
                return self._elements(value, _AXES)
            if not self.kind.endswith("_array"):
                return self._canonical(value)
            return self._elements(value if listed else None, self.length)
        except ValueError:
            node, _, group = owner.partition(".")
            path = f"{group}.{self.path}" if group else self.path
            name = dataclasses.replace(self, path=path).name
            name = f"{node}.{name}" if node else name
            raise ConfigurationError(name, value, self.allowed()) from None

    def _elements(self, value: Any, length: int | None) -> tuple[Any, ...]:
        """Return an array in its canonical type; ``ValueError`` if it is not allowed."""
        if value is None or length not in (None, len(value)):
            raise ValueError
        return tuple(self._canonical(element) for element in value)

    def _canonical(self, value: object) -> Any:
        """Return a scalar in its canonical type; ``ValueError`` if it is not allowed."""
        kind = self.kind.removesuffix("_array")
        expected = (int, float) if kind == "double" else _TYPES[kind]
        if not isinstance(value, expected) or isinstance(value, bool) != (kind == "bool"):
            raise ValueError
        if self.choices is not None and value not in self.choices:
            raise ValueError
        if isinstance(value, bool | str):
            return value
        assert isinstance(value, int | float)
        if not abs(value) <= sys.float_info.max:  # nan and inf too
            raise ValueError
        if not all(_COMPARISONS[symbol](value, bound) for symbol, bound in self._bounds()):
            raise ValueError
        return float(value) if kind == "double" else value

    def _bounds(self) -> list[tuple[str, float]]:
        """Return the bounds with their symbols."""
        bounds = (self.minimum, self.above, self.maximum, self.below)
        return [
            (symbol, bound)
            for symbol, bound in zip(_COMPARISONS, bounds, strict=True)
            if bound is not None
        ]


def parameter(default: Any, *, doc: str, **constraints: Any) -> Any:
    """Declare a parameter as a dataclass field.

    ``constraints`` are the fields of :class:`ParameterSpec`: unit, minimum, maximum, above,
    below, length, choices, live, switch, advanced. The name comes from the field and the type
    from its annotation.
    """
    spec = ParameterSpec(default=default, doc=doc, **constraints)
    return dataclasses.field(default=default, metadata={_METADATA_KEY: spec})


def unknown_parameter(
    owner: str, name: str, value: object, known: Iterable[str]
) -> ConfigurationError:
    """Return the error for a parameter that a node does not have, with a suggestion."""
    near = did_you_mean(name, known) or f" (one of {', '.join(sorted(known))})"
    return ConfigurationError(f"{owner}.{name}", value, f"a known parameter{near}")


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """Base of every parameter set: validates on construction, flattens to dotted names.

    A field whose type is itself a :class:`Configuration` is a group; its parameters are named
    ``group.parameter``. Subclasses override :meth:`check` for rules that couple parameters.
    """

    owner: ClassVar[str] = ""
    pins: ClassVar[str] = ""
    """Parameter by which a section also sets the node's share of the vehicle file."""

    def __post_init__(self) -> None:
        for name, field in _fields(type(self)).items():
            value = getattr(self, name)
            if isinstance(field, ParameterSpec):
                object.__setattr__(self, name, field.validated(value, owner=self.owner))
            elif not isinstance(value, field):
                expected = f"parameters of {field.__name__}"
                raise ConfigurationError(f"{self.owner}.{name}", value, expected)
        self.check()

    def check(self) -> None:
        """Raise :class:`ConfigurationError` if parameters contradict each other."""

    @classmethod
    def specs(cls) -> tuple[ParameterSpec, ...]:
        """Return all specifications, groups flattened, advanced parameters last."""
        return _specs(cls)

    @classmethod
    def build(cls, values: Mapping[str, object]) -> Self:
        """Return the parameter set with ``values`` (dotted names) over the defaults.

        Raises :class:`ConfigurationError` for an unknown name or an unusable value.
        """
        if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
            raise ConfigurationError(cls.owner, values, "values keyed by parameter name")
        paths = {spec.name: spec.path for spec in cls.specs()}
        for name, value in values.items():
            if name not in paths:
                raise unknown_parameter(cls.owner, name, value, paths)
        return cls.built({paths[name]: value for name, value in values.items()})

    @classmethod
    def chosen_by(cls, values: Mapping[str, object]) -> type[Self]:
        """Return the class that :meth:`build` instantiates for these values."""
        return cls

    @classmethod
    def built(cls, values: Mapping[str, object]) -> Self:
        """Return the parameter set with values, keyed by the path of their field."""
        arguments: dict[str, Any] = {}
        for name, field in _fields(cls).items():
            if isinstance(field, ParameterSpec):
                arguments |= {name: values[name]} if name in values else {}
            else:
                prefix = f"{name}."
                inner = {each: value for each, value in values.items() if each.startswith(prefix)}
                arguments[name] = field.built({k.removeprefix(prefix): inner[k] for k in inner})
        return cls(**arguments)

    @classmethod
    def share(cls, common: Mapping[str, object], own: Mapping[str, object]) -> dict[str, object]:
        """Return the parameters for every node (``/**``) that apply to this node.

        ``own`` are the parameters for this node.
        """
        known = {spec.name for spec in cls.specs()}
        return {name: value for name, value in common.items() if name in known}

    def flattened(self) -> dict[str, Any]:
        """Return all parameters, keyed by dotted name; arrays as tuples."""
        return {spec.name: operator.attrgetter(spec.path)(self) for spec in self.specs()}

    def vehicle_values(self) -> dict[str, Any]:
        """Return the node's vehicle parameters, with the names of a vehicle file."""
        return {name: value for name, value in self.flattened().items() if name in VEHICLE}

    def updated(self, changes: Mapping[str, object]) -> Self:
        """Return a copy with ``changes`` (dotted names) applied, validated as a whole."""
        if not isinstance(changes, Mapping):
            raise ConfigurationError(self.owner, changes, "values keyed by parameter name")
        return self.build({**self.flattened(), **changes})


@dataclass(frozen=True, kw_only=True)
class ManagedConfiguration(Configuration):
    """Parameters of a node that can be configured, activated, deactivated and cleaned up."""

    autostart: bool = parameter(
        True,
        doc="Configure and activate the node automatically at the start, as soon as its inputs "
        "are available; false waits for lifecycle transitions.",
    )


_NOUNS = {
    "double": ("a number", "numbers"),
    "integer": ("a whole number", "whole numbers"),
    "bool": ("true or false", "values true or false"),
    "string": ("text", "texts"),
}

_COMPARISONS = {">=": operator.ge, ">": operator.gt, "<=": operator.le, "<": operator.lt}

_TYPES: dict[str, type] = {"double": float, "integer": int, "bool": bool, "string": str}
_KINDS: dict[Any, str] = {kind: name for name, kind in _TYPES.items()}


def _kind_of(annotation: Any) -> str:
    if annotation == PerAxis:
        return "double"
    if get_origin(annotation) is tuple:
        return f"{_KINDS[get_args(annotation)[0]]}_array"
    return _KINDS[annotation]


def _find_fields(cls: Any) -> dict[str, ParameterSpec | type[Configuration]]:
    """Return the specification of each parameter and the type of each group, by field."""
    hints, found = get_type_hints(cls), dict[str, ParameterSpec | type[Configuration]]()
    for field in dataclasses.fields(cls):
        name, hint = field.name, hints[field.name]
        if (spec := field.metadata.get(_METADATA_KEY)) is not None:
            found[name] = dataclasses.replace(
                spec, path=name, kind=_kind_of(hint), per_axis=hint == PerAxis
            )
        elif isinstance(hint, type) and issubclass(hint, Configuration):
            found[name] = hint
        else:
            raise TypeError(f"{cls.__name__}.{name} is neither a parameter nor a group")
    return found


def _find_specs(cls: Any) -> tuple[ParameterSpec, ...]:
    found: list[ParameterSpec] = []
    for name, field in _fields(cls).items():
        if isinstance(field, ParameterSpec):
            found.append(field)
        else:
            found += [
                dataclasses.replace(inner, path=f"{name}.{inner.path}") for inner in field.specs()
            ]
    return tuple(sorted(found, key=lambda spec: spec.advanced))


# Cached for each class, as the computation takes milliseconds.
_fields: Callable[[Any], dict[str, ParameterSpec | type[Configuration]]] = functools.cache(
    _find_fields
)
_specs: Callable[[Any], tuple[ParameterSpec, ...]] = functools.cache(_find_specs)
