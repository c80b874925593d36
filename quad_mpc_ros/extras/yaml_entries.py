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


class Entries:
    """Reads the entries of a file; errors begin with its name and the entry."""

    def __init__(self, source: str) -> None:
        self._source = source

    def error(self, entry: str, given: object, expected: str) -> UserError:
        """Return the error for an entry."""
        return UserError(f"{self._source}: {entry}: given {text_of(given)}, expected {expected}")

    def check_keys(self, entry: str, given: Any, known: Sequence[str]) -> None:
        """Reject other types than a mapping, and unknown keys."""
        if not isinstance(given, Mapping):
            raise self.error(entry, given, f"{', '.join(known)}")
        for key in given:
            if key not in known:
                name = f"{entry}.{key}" if entry else str(key)
                raise UserError(
                    f"{self._source}: {name}: unknown{did_you_mean(str(key), known)}, "
                    f"expected {', '.join(known)}"
                )

    def number(
        self,
        entry: str,
        given: Any,
        *,
        least: float = -FARTHEST,
        above: float = -math.inf,
        most: float = FARTHEST,
    ) -> float:
        """Return a number >= ``least``, > ``above`` and <= ``most``."""
        fits = isinstance(given, int | float) and not isinstance(given, bool)
        if not (fits and above < given <= most and given >= least):  # false for NaN
            lower = f">= {least:g}" if above < least else f"> {above:g}"
            raise self.error(entry, given, f"a number {lower} and <= {most:g}")
        return float(given)

    def whole(self, entry: str, given: Any, *, least: int, most: int) -> int:
        """Return an integer within limits."""
        if not isinstance(given, int) or isinstance(given, bool) or not least <= given <= most:
            raise self.error(entry, given, f"a whole number from {least} to {most}")
        return given

    def vector(self, entry: str, given: Any, *, size: int = 3) -> Array:
        """Return finite numbers (size,)."""
        numbers = given if isinstance(given, list | tuple) else ()
        fits = len(numbers) == size and all(
            isinstance(each, int | float) and not isinstance(each, bool) and abs(each) <= FARTHEST
            for each in numbers
        )
        if not fits:
            raise self.error(entry, given, f"{size} numbers from -{FARTHEST:g} to {FARTHEST:g}")
        return np.array(numbers, dtype=np.float64)
