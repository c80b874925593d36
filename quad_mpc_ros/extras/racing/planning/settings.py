"""The settings of a plan as text in its file, to replan the rest of the race."""

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
    """The vehicle, model and margins of a plan, see :func:`.plan_race`."""

    vehicle: PlannedVehicle
    model: str
    gate_margin: float
    radius: float
    step: float

    def text(self) -> str:
        """Return the settings as a line of text."""
        return json.dumps(dataclasses.asdict(self), default=lambda numbers: numbers.tolist())

    @staticmethod
    def of(text: str) -> PlanSettings:
        """Return the settings in a line of text. Raises :class:`UserError` if invalid."""
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
