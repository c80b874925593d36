"""The settings of a plan as a text in its file: enough to replan the rest of the race."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.racing.planning.limits import MODELS, PlannedVehicle, RotorLimits


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanSettings:
    """The vehicle of a plan, its model, and what is kept from the edges; as :func:`.plan_race`."""

    vehicle: PlannedVehicle
    model: str
    gate_margin: float
    radius: float
    step: float

    def text(self) -> str:
        """Return it as a line."""
        return json.dumps(dataclasses.asdict(self), default=lambda numbers: numbers.tolist())

    @staticmethod
    def of(text: str) -> PlanSettings:
        """Return what a line says. Raises :class:`UserError` for one that does not."""
        try:
            given = json.loads(text)
            vehicle = _arrays(given["vehicle"])
            if vehicle["rotors"] is not None:
                vehicle["rotors"] = RotorLimits(**_arrays(vehicle["rotors"]))
            if given["model"] not in MODELS:
                raise ValueError(given["model"])
            return PlanSettings(**{**given, "vehicle": PlannedVehicle(**vehicle)})
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(
                f"the settings of the plan cannot be read ({error!r}): plan it again"
            ) from error


def _arrays(given: dict[str, Any]) -> dict[str, Any]:
    return {
        name: np.array(value, dtype=np.float64) if isinstance(value, list) else value
        for name, value in given.items()
    }
