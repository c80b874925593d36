# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of trajectories and plants of other packages.

A package registers a trajectory or plant with an entry point ``name = module:OBJECT`` in a group
of this package. The entry point is looked up if a name does not belong to this package.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, ClassVar, Self, cast

from quad_mpc_ros.configuration.errors import ConfigurationError, UserError
from quad_mpc_ros.configuration.fields import Configuration, parameter

BRIDGES = "quad_mpc_ros.bridges"
"""Group of the entry points of bridges to flight stacks."""
EXTRAS = "quad_mpc_ros.extras"
"""Group of the entry points of this package's optional parts."""


def registered_names(group: str) -> set[str]:
    """Return the names registered in a group, without loading anything."""
    from importlib.metadata import entry_points

    return set(entry_points(group=group).names)


@functools.cache
def registered(group: str, name: str) -> Any:
    """Return the object registered under a name, or None.

    Raises :class:`UserError` if loading fails.
    """
    from importlib.metadata import entry_points  # slow to import

    for entry in entry_points(group=group, name=name):
        try:
            return entry.load()
        except (ImportError, AttributeError) as error:
            raise UserError(
                f"{group}: {name} = {entry.value} cannot be loaded: {error}"
            ) from error
    return None


def optional_part(name: str, *, needed_by: str) -> Any:
    """Return the object registered under a name in the group :data:`EXTRAS`.

    If the part is not installed, raises :class:`UserError` with the parameter ``needed_by``.
    """
    try:
        found, cause = registered(EXTRAS, name), f"{EXTRAS} has no entry point of this name"
    except UserError as error:
        found, cause = None, str(error.__cause__)
    if found is None:
        raise UserError(f"{needed_by}: needs the optional part {name}, not installed: {cause}")
    return found


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExtensibleConfiguration(Configuration):
    """A parameter set with one parameter whose choices other packages can extend.

    :meth:`build` adds the parameters of the chosen entry as a further base class.
    """

    choice: ClassVar[str]
    """Name of the parameter."""
    group: ClassVar[str]
    """Group of the entry points. The entry points are objects with an attribute ``parameters``."""

    @classmethod
    def build(cls, values: Mapping[str, object]) -> Self:
        """Return the parameter set with ``values`` (dotted names) over the defaults.

        Raises :class:`ConfigurationError` for an unknown name or an unusable value.
        """
        kind = cls.chosen_by(values)
        return super().build(values) if kind is cls else kind.build(values)

    @classmethod
    def chosen_by(cls, values: Mapping[str, object]) -> type[Self]:
        """Return the parameter set with the parameters of the entries that ``values`` choose."""
        chosen = values.get(cls.choice)
        kind: Any = _extended(cast(Any, cls), chosen) if isinstance(chosen, str) else cls
        extended: type[Self] = kind
        return extended


@functools.cache
def _extended(kind: type[ExtensibleConfiguration], name: str) -> type[ExtensibleConfiguration]:
    """Return the class with the parameters of the entry registered under a name, if any."""
    (spec,) = (spec for spec in kind.specs() if spec.name == kind.choice)
    choices = spec.choices or ()
    if name in choices:
        return kind
    found = registered(kind.group, name)
    if found is None:
        return kind
    if not hasattr(found, "parameters"):
        raise UserError(f"{kind.group}: {name} is {found!r}, expected an entry")
    added: type[Configuration] | None = found.parameters
    for field in dataclasses.fields(added) if added else ():
        known = kind.__dataclass_fields__.get(field.name)
        if known is not None and known is not field:
            raise ConfigurationError(
                f"{kind.owner}.{field.name}", field.default, f"a name that is not in {name}"
            )
    chosen = parameter(spec.default, doc=spec.doc, choices=(*choices, name))
    return dataclasses.make_dataclass(
        kind.__name__,
        [(kind.choice, str, chosen)],
        bases=(kind,) if added is None else (added, kind),
        namespace={"__module__": kind.__module__, "__doc__": kind.__doc__},
        frozen=True,
        kw_only=True,
    )
