# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Validation of the entries of course and obstacle files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.box import FARTHEST
from quad_mpc_ros.configuration.errors import text_of
from quad_mpc_ros.configuration.spelling import did_you_mean
from quad_mpc_ros.control.lie import Array


class Entry:
    """A value in a file; errors begin with the file and the name of the value."""

    def __init__(self, value: Any, *, source: str, name: str = "") -> None:
        self.value = value
        self._source, self.name = source, name

    def error(self, expected: str, *, key: str = "") -> UserError:
        """Return the error for the value, or for a key of it."""
        entry = self.get(key) if key else self
        given = f"{entry.name}: given {text_of(entry.value)}"
        return UserError(f"{self._source}: {given}, expected {expected}")

    def get(self, key: str, default: Any = None) -> Entry:
        """Return the value of a key of a mapping, or the default."""
        name = f"{self.name}.{key}" if self.name else key
        return Entry(self.value.get(key, default), source=self._source, name=name)

    def items(self, expected: str) -> list[Entry]:
        """Return the elements of a list that is not empty, with numbers from 1 in errors."""
        given = self.value
        if not isinstance(given, Sequence) or isinstance(given, str) or not given:
            raise self.error(expected)
        names = (f"{self.name}[{number}]" for number in range(1, len(given) + 1))
        return [
            Entry(each, source=self._source, name=name)
            for each, name in zip(given, names, strict=True)
        ]

    def check_keys(self, known: Sequence[str]) -> None:
        """Reject other types than a mapping, and unknown keys."""
        if not isinstance(self.value, Mapping):
            raise self.error(", ".join(known))
        for key in self.value:
            if key not in known:
                name = f"{self.name}.{key}" if self.name else str(key)
                raise UserError(
                    f"{self._source}: {name}: unknown{did_you_mean(str(key), known)}, "
                    f"expected {', '.join(known)}"
                )

    def number(
        self, *, least: float = -FARTHEST, above: float = -math.inf, most: float = FARTHEST
    ) -> float:
        """Return a number >= ``least``, > ``above`` and <= ``most``."""
        given = self.value
        fits = isinstance(given, int | float) and not isinstance(given, bool)
        if not (fits and above < given <= most and given >= least):  # false for NaN
            lower = f">= {least:g}" if above < least else f"> {above:g}"
            raise self.error(f"a number {lower} and <= {most:g}")
        return float(given)

    def whole(self, *, least: int, most: int) -> int:
        """Return an integer within limits."""
        given = self.value
        if not isinstance(given, int) or isinstance(given, bool) or not least <= given <= most:
            raise self.error(f"a whole number from {least} to {most}")
        return given

    def vector(self, *, size: int = 3) -> Array:
        """Return finite numbers (size,)."""
        numbers = self.value if isinstance(self.value, list | tuple) else ()
        fits = len(numbers) == size and all(
            isinstance(each, int | float) and not isinstance(each, bool) and abs(each) <= FARTHEST
            for each in numbers
        )
        if not fits:
            raise self.error(f"{size} numbers from -{FARTHEST:g} to {FARTHEST:g}")
        return np.array(numbers, dtype=np.float64)
