# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The searched parameters of the controller, and the starting point."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.extras.campaigns.campaign import Campaign, Target, target_of, value_in
from quad_mpc_ros.extras.campaigns.variation import (
    Choice,
    Integers,
    SameAs,
    Uniform,
    Variation,
)


class SearchSpace:
    """Parameters with a range of one or more dimensions.

    A *point* has a value for each dimension: one for each element of a vector, a label for a
    choice, none for a parameter that follows another parameter. *Values* are keyed by name as in a
    file, *parameters* belong to the controller, with whole vectors.
    """

    def __init__(self, search: Mapping[str, Variation], campaign: Campaign) -> None:
        """Initialise with variations, and a campaign with all other parameters."""
        self._search = search
        self._frame = dataclasses.replace(campaign, vary=search)
        self.dimensions: dict[str, Variation] = {}
        for name, variation in search.items():
            self.dimensions |= _dimensions(name, variation)

    @property
    def targets(self) -> tuple[Target, ...]:
        """The parameters, or their elements."""
        return tuple(self._frame.targets.values())

    def values_at(self, point: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values at a point."""
        drawn: dict[str, Any] = {}
        for name, variation in self._search.items():
            if isinstance(variation, Choice):
                drawn[name] = variation.values[labels(variation).index(point[name])]
            elif name in point:
                drawn[name] = point[name]
            elif not isinstance(variation, SameAs):
                drawn[name] = [point[each] for each in _dimensions(name, variation)]
        return self._frame.completed(drawn)

    def cells(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values by column, elements of vectors as ``name.0`` and so on."""
        return self._frame.cells(values)

    def parameters(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the controller's parameters by name.

        Raises :class:`ConfigurationError` for values that cannot be used together.
        """
        every = self._frame.configured(values).mpc.flattened()
        names = dict.fromkeys(target.parameter for target in self.targets)
        return {name: _plain(every[name]) for name in names}

    def base_values(self) -> dict[str, Any]:
        """Return the values of the campaign itself."""
        base = self._frame.base
        return {name: _plain(value_in(target_of(name, base), base)) for name in self._search}

    def base_point(self) -> dict[str, Any]:
        """Return the point with the values of the campaign.

        Raises :class:`UserError` for a point outside of the space.
        """
        values = self.base_values()
        cells = self.cells(values)
        point = {}
        for name, dimension in self.dimensions.items():
            if isinstance(dimension, Choice):
                point[name] = _label(dimension, values[name], name)
            else:
                point[name] = _within(dimension, cells[name], name)
        for name, value in self.cells(self.values_at(point)).items():
            if value != cells[name]:
                raise UserError(
                    f"{name} is {cells[name]}, expected {value}, the value that it follows"
                )
        return point


def labels(choice: Choice) -> list[Any]:
    """Return a label for each value: the value, or text for a list."""
    return [
        value if isinstance(value, bool | int | float | str) else files.value_text(value)
        for value in choice.values
    ]


def _dimensions(name: str, variation: Variation) -> dict[str, Variation]:
    match variation:
        case SameAs():
            return {}
        case Uniform(low=list() as low, high=high):
            kind = type(variation)
            ends = enumerate(zip(low, high, strict=True))
            return {f"{name}.{place}": kind(*each) for place, each in ends}
        case Uniform() | Integers() | Choice():
            return {name: variation}
    expected = "uniform, log_uniform, integers, choice or same_as"
    raise UserError(f"search: {name}: expected {expected}")


def _label(choice: Choice, value: Any, name: str) -> Any:
    for label, each in zip(labels(choice), choice.values, strict=True):
        if each == value:
            return label
    raise UserError(f"{name} is {value}, not one of {list(choice.values)}")


def _within(dimension: Variation, value: Any, name: str) -> Any:
    low, high = dimension.extremes()
    if not low <= value <= high:
        raise UserError(f"{name} is {value}, not from {low} to {high}")
    return value


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
