# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Variations of a parameter from flight to flight, as listed below ``vary`` in a campaign file."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import Array, so3


class Variation(ABC):
    """The values of one parameter: numbers, vectors, or any listed values."""

    kind: ClassVar[str]
    """Key in a file; the value has the fields in order."""

    expected: ClassVar[str]
    """The value in a file, as a phrase."""

    @classmethod
    def read(cls, arguments: list[Any]) -> Self | None:
        """Return the variation for the value in a file; None for an invalid value."""
        return None

    @abstractmethod
    def drawn(self, random: np.random.Generator) -> Any:
        """Return a random value."""

    def described(self) -> dict[str, Any]:
        """Return the entry of a file."""
        return {self.kind: list(vars(self).values())}

    def extremes(self) -> list[Any]:
        """Return extreme values: if the parameter allows these, it allows all values."""
        return list(vars(self).values())


@dataclass(frozen=True)
class Uniform(Variation):
    """``uniform: [low, high]``, numbers, or vectors with independent elements."""

    kind = "uniform"
    expected = "[low, high], two numbers or two lists of equal length, low <= high"
    low: Any
    high: Any

    @classmethod
    def read(cls, arguments: list[Any]) -> Self | None:
        if len(arguments) != 2 or not all(map(_are_numbers, arguments)):
            return None
        low, high = (np.asarray(each, dtype=float) for each in arguments)
        if low.shape != high.shape or not np.all(low <= high):
            return None
        return cls(_plain(low), _plain(high))

    def drawn(self, random: np.random.Generator) -> Any:
        low, high = np.asarray(self.low, dtype=float), np.asarray(self.high, dtype=float)
        return _plain(low + (high - low) * random.random(low.shape))


@dataclass(frozen=True)
class LogUniform(Uniform):
    """``log_uniform: [low, high]``, uniform in the logarithm; bounds above zero."""

    kind = "log_uniform"
    expected = f"{Uniform.expected}, all > 0"

    @classmethod
    def read(cls, arguments: list[Any]) -> Self | None:
        found = super().read(arguments)
        return found if found is not None and np.all(np.asarray(found.low) > 0.0) else None

    def drawn(self, random: np.random.Generator) -> Any:
        low, high = np.log(self.low), np.log(self.high)
        # Rounding must not exceed the range.
        drawn = np.exp(low + (high - low) * random.random(low.shape))
        return _plain(np.clip(drawn, self.low, self.high))


@dataclass(frozen=True)
class Integers(Variation):
    """``integers: [low, high]``, both ends included."""

    kind = "integers"
    expected = "[low, high], two whole numbers, low <= high"
    low: int
    high: int

    @classmethod
    def read(cls, arguments: list[Any]) -> Self | None:
        fits = len(arguments) == 2 and all(type(each) is int for each in arguments)
        return cls(*arguments) if fits and arguments[0] <= arguments[1] else None

    def drawn(self, random: np.random.Generator) -> Any:
        return int(random.integers(self.low, self.high, endpoint=True))


@dataclass(frozen=True)
class Choice(Variation):
    """``choice: [a, b, …]``, each with equal probability."""

    kind = "choice"
    expected = "a list of at least one value"
    values: tuple[Any, ...]

    @classmethod
    def read(cls, arguments: list[Any]) -> Self | None:
        return cls(tuple(arguments)) if arguments else None

    def drawn(self, random: np.random.Generator) -> Any:
        return self.values[int(random.integers(len(self.values)))]

    def extremes(self) -> list[Any]:
        return list(self.values)

    def described(self) -> dict[str, Any]:
        return {self.kind: [*self.values]}


@dataclass(frozen=True)
class Attitude(Variation):
    """``attitude: [tilt, yaw]`` [rad]: a quaternion xyzw, tilted by up to ``tilt``, yaw ± ``yaw``.

    Directions of the thrust axis are uniform in the cone.
    """

    kind = "attitude"
    expected = "[tilt, yaw] in rad, each from 0 to pi"
    tilt: float
    yaw: float

    @classmethod
    def read(cls, arguments: list[Any]) -> Self | None:
        fits = len(arguments) == 2 and all(map(_is_number, arguments))
        fits = fits and all(0.0 <= each <= math.pi for each in arguments)
        return cls(*map(float, arguments)) if fits else None

    def drawn(self, random: np.random.Generator) -> Any:
        share, direction, turn = random.random(3)
        height = 1.0 - share * (1.0 - math.cos(self.tilt))  # uniform on the sphere's cap
        direction *= 2.0 * math.pi
        axis = np.array([math.cos(direction), math.sin(direction), 0.0])
        tilted = so3.exp(math.acos(height) * axis)
        turned = so3.exp([0.0, 0.0, (2.0 * turn - 1.0) * self.yaw])
        return _plain(so3.quaternion_xyzw_from_rotation(tilted @ turned))

    def extremes(self) -> list[Any]:
        return [[0.0, 0.0, 0.0, 1.0]]


_KINDS: dict[str, type[Variation]] = {
    each.kind: each for each in (Uniform, LogUniform, Integers, Choice, Attitude)
}


@dataclass(frozen=True)
class SameAs(Variation):
    """``same_as: NAME``: the value of another parameter, with optional ``times`` and ``plus``."""

    kind = "same_as"
    name: str
    times: float = 1.0
    plus: float = 0.0

    def drawn(self, random: np.random.Generator) -> Any:
        raise NotImplementedError("the value follows another parameter")

    def of(self, value: Any) -> Any:
        """Return the value if the other parameter has ``value``."""
        if self.times == 1.0 and self.plus == 0.0:
            return value
        return _plain(self.times * np.asarray(value, dtype=float) + self.plus)

    def described(self) -> dict[str, Any]:
        return {self.kind: self.name, "times": self.times, "plus": self.plus}

    def extremes(self) -> list[Any]:
        return []


def variation_of(name: str, given: Any) -> Variation:
    """Return the variation in a file's entry for a parameter.

    Raises :class:`ConfigurationError` for an invalid entry.
    """
    if isinstance(given, Mapping) and "same_as" in given:
        return _same_as(name, given)
    if not isinstance(given, Mapping) or len(given) != 1:
        raise ConfigurationError(name, given, f"one of {{{', '.join([*_KINDS, 'same_as'])}: …}}")
    ((kind, arguments),) = given.items()
    if kind not in _KINDS:
        raise ConfigurationError(name, kind, f"one of {', '.join([*_KINDS, 'same_as'])}")
    found = _KINDS[kind].read(arguments) if isinstance(arguments, list) else None
    if found is None:
        raise ConfigurationError(f"{name}: {kind}", arguments, _KINDS[kind].expected)
    return found


def _same_as(name: str, given: Mapping[Any, Any]) -> SameAs:
    known = {"same_as", "times", "plus"}
    source, times, plus = given["same_as"], given.get("times", 1.0), given.get("plus", 0.0)
    if not set(given) <= known or not isinstance(source, str):
        raise ConfigurationError(name, dict(given), "{same_as: NAME, times: NUMBER, plus: NUMBER}")
    if not (_is_number(times) and _is_number(plus)):
        raise ConfigurationError(name, dict(given), "numbers for times and plus")
    return SameAs(source, float(times), float(plus))


def _are_numbers(given: Any) -> bool:
    if isinstance(given, list):
        return len(given) > 0 and all(map(_is_number, given))
    return _is_number(given)


def _is_number(given: Any) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool) and math.isfinite(given)


def _plain(value: Array | np.float64) -> Any:
    """Return a float, or a list of floats."""
    return np.asarray(value).tolist()
