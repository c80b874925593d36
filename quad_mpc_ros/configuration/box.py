"""A box in the world, as parameters of nodes that ask for it or show it."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration.errors import ConfigurationError
from quad_mpc_ros.configuration.fields import Configuration, parameter

_FAR = 1e4  # m


@dataclass(frozen=True, kw_only=True)
class BoxParameters(Configuration):
    """The corners of a box; by default it has no walls."""

    minimum: tuple[float, ...] = parameter(
        (-_FAR,) * 3,
        doc="Lowest position inside the fence, usually that of the mpc.",
        unit="m",
        length=3,
        minimum=-_FAR,
        maximum=_FAR,
    )
    maximum: tuple[float, ...] = parameter(
        (_FAR,) * 3,
        doc="Highest position inside the fence.",
        unit="m",
        length=3,
        minimum=-_FAR,
        maximum=_FAR,
    )

    def check(self) -> None:
        """Refuse a box with no inside."""
        if not all(low < high for low, high in zip(self.minimum, self.maximum, strict=True)):
            raise ConfigurationError(
                f"{self.owner}.minimum",
                self.minimum,
                f"3 numbers below fence.maximum {list(self.maximum)}",
            )

    @property
    def is_closed(self) -> bool:
        """Whether it has all six walls."""
        return max(map(abs, (*self.minimum, *self.maximum))) < _FAR
